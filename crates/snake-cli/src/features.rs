//! Features that a build of the program may lack.

use anyhow::Error;

/// How to get the feature that a work needs and this build lacks.
pub fn advice(feature: &str) -> String {
    format!("install the program with it: cargo install --path crates/snake-cli --features {feature}")
}

/// The feature for want of which a file is not read or written.
pub fn missing(error: &Error) -> Option<&'static str> {
    error.chain().find_map(|cause| match cause.downcast_ref() {
        Some(snake_io::Error::Feature { feature, .. }) => Some(*feature),
        _ => None,
    })
}

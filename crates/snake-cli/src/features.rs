//! Features that a build of the program may lack.

use anyhow::Error;

/// The command that installs a feature that this build lacks.
pub fn advice(feature: &str) -> String {
    format!("install the program with it: cargo install --path crates/snake-cli --features {feature}")
}

/// The missing feature that keeps a file from being read or written.
pub fn missing(error: &Error) -> Option<&'static str> {
    error.chain().find_map(|cause| match cause.downcast_ref() {
        Some(snake_io::Error::Feature { feature, .. }) => Some(*feature),
        _ => None,
    })
}

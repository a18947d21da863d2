//! Features that a build of the program may lack.

use std::path::Path;

use anyhow::Error;
use snake_io::KeypointFormat;

use crate::setup::named;

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

/// The format of keypoints of a name.
pub fn keypoint_format(name: &str) -> Result<KeypointFormat, Error> {
    named(name).map_err(|error| match KeypointFormat::from_path(&Path::new("keypoints").with_extension(name)) {
        Err(snake_io::Error::Feature { feature, .. }) => {
            Error::msg(format!("this build lacks the feature `{feature}`; {}", advice(feature)))
        }
        _ => error.into(),
    })
}

//! SNAKE keypoints from point clouds.

pub mod io;

mod detect;
mod error;
mod points;

pub use detect::Keypoint;
pub use error::{Error, Result};
pub use points::{Normalization, NormalizationMethod, Point};

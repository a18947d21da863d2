//! The voxel size of a scene, where none is given.

use crate::Result;
use crate::length::{Length, resolution};
use crate::points::Point;

/// The voxel size in cloud units: the given one, or one chosen from the finite points of a cloud.
pub(crate) fn voxel_size(given: Option<Length>, points: &[Point]) -> Result<f32> {
    match given {
        Some(size) => Ok(size.in_units("voxel_size", points)? as f32),
        None => Ok(3.0 * resolution("points", points)? as f32),
    }
}

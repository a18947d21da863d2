//! The sensor's position.

use crate::cloud::depth_image::{COARSE, DepthImage};
use crate::options::RegisterOptions;
use crate::result::ViewpointUsed;
use snake_geometry::Vector;

/// The frame's origin is taken for the sensor's position if this share of the cloud is visible from there. Unit: share
/// of the voxels. Scans have 0.7 and more even if the sensor moved, whole objects about half.
const MIN_VISIBLE: f64 = 0.65;

/// The viewpoint of a cloud and its origin; `None` if it is not known.
pub(super) fn viewpoint(
    voxels: &[Vector],
    given: Option<[f64; 3]>,
    options: &RegisterOptions,
    inlier_distance: f64,
) -> Option<(Vector, ViewpointUsed)> {
    if !options.use_viewpoints {
        return None;
    }
    if let Some(given) = given {
        return Some((given.into(), ViewpointUsed::Given));
    }
    is_visible(voxels, Vector::zeros(), inlier_distance).then_some((Vector::zeros(), ViewpointUsed::Origin))
}

/// Whether most of a cloud is visible from a place, as far as its voxels can show.
pub(super) fn is_visible(voxels: &[Vector], place: Vector, inlier_distance: f64) -> bool {
    DepthImage::new(voxels, place, inlier_distance, COARSE).visible_share(voxels) >= MIN_VISIBLE
}

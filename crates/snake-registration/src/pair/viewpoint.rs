//! Where the sensor was.

use crate::options::RegisterOptions;
use crate::parts::depth_image::{COARSE, DepthImage};
use crate::result::ViewpointUsed;
use snake_geometry::Vector;

/// The origin is taken for the viewpoint if at least this share of a cloud is visible from there. Of scans it is 0.7 and
/// more even if the sensor moved; of whole objects it is about half.
const LEAST_VISIBLE: f64 = 0.65;

/// The viewpoint of a cloud and where it is from; `None` if it is not known.
pub(crate) fn viewpoint(
    voxels: &[Vector],
    given: Option<[f64; 3]>,
    options: &RegisterOptions,
    margin: f64,
) -> Option<(Vector, ViewpointUsed)> {
    if !options.use_viewpoints {
        return None;
    }
    if let Some(given) = given {
        return Some((given.into(), ViewpointUsed::Given));
    }
    let image = DepthImage::new(voxels, Vector::zeros(), margin, COARSE);
    (image.visible_share(voxels) >= LEAST_VISIBLE).then_some((Vector::zeros(), ViewpointUsed::Origin))
}

//! Where the sensor was.

use super::depth_image::DepthImage;
use super::options::RegisterOptions;
use super::result::ViewpointUsed;
use snake_core::space::{Neighbors, Vector};

/// The origin is taken for the viewpoint if at least this share of a cloud is visible from there. Of scans it is 0.7 and
/// more even if the sensor moved; of whole objects it is about half.
const LEAST_VISIBLE: f64 = 0.65;

/// The viewpoints of source and target, and where they are from; `None` unless both are known, because the descriptors
/// of the two clouds are then compared without signs.
pub(super) fn viewpoints(
    voxels: &[Neighbors; 2],
    options: &RegisterOptions,
    margin: f64,
) -> (Option<[Vector; 2]>, [ViewpointUsed; 2]) {
    let none = (None, [ViewpointUsed::None; 2]);
    if !options.use_viewpoints {
        return none;
    }
    let of = |points: &[Vector], given: Option<[f64; 3]>| match given {
        Some(viewpoint) => Some((Vector::from(viewpoint), ViewpointUsed::Given)),
        None => {
            let image = DepthImage::new(points, Vector::zeros(), margin);
            (image.visible_share(points) >= LEAST_VISIBLE).then_some((Vector::zeros(), ViewpointUsed::Origin))
        }
    };
    let [source, target] = voxels;
    match (of(&source.points, options.source_viewpoint), of(&target.points, options.target_viewpoint)) {
        (Some((source, source_used)), Some((target, target_used))) => {
            (Some([source, target]), [source_used, target_used])
        }
        _ => none,
    }
}

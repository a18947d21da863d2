//! Scans whose sensors a transform puts at one place, where the pattern of rays alone makes them coincide.

use nalgebra::{IsometryMatrix3, Point3};

use crate::cloud::depth_image::{DepthImage, SHARP};
use crate::cloud::patches::FineCloud;
use crate::steps::pair::Pair;
use snake_core::Result;
use snake_geometry::Vector;

/// A cloud was seen from one place if this much of it is visible from there. Unit: share of the
/// fine voxels. Synthetic scans have 0.99 and more, fused fragments of rooms about 0.9.
const MIN_ONE_VIEW: f64 = 0.98;
/// Two sensors are at one place if they are at most this far apart. Unit: inlier distances. Of 19
/// synthetic facades and fences that were wrong and reliable, 18 have less; the last has 1.6.
const STANDING: f64 = 1.0;

/// Whether a transform puts both sensors at one place: not if one is unknown, or its cloud was not seen from there alone.
pub(super) fn are_at_one_place(pair: &Pair, transform: &IsometryMatrix3<f64>) -> Result<bool> {
    let distance = pair.criteria().inlier_distance;
    let places = pair.viewpoints().map(|viewpoint| viewpoint.map(|viewpoint| viewpoint.place()));
    let [Some(source), Some(target)] = places else { return Ok(false) };
    if (transform * Point3::from(source) - Point3::from(target)).norm() > STANDING * distance {
        return Ok(false);
    }
    let is_one_view = |(cloud, place): (&FineCloud, Vector)| {
        DepthImage::new(cloud.points(), place, distance, SHARP).visible_share(cloud.points()) >= MIN_ONE_VIEW
    };
    Ok(pair.fine()?.into_iter().zip([source, target]).all(is_one_view))
}

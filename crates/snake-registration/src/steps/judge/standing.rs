//! Scans whose sensors a transform puts at one place, where the pattern of rays alone makes them coincide.
//!
//! Ground and guard rails then coincide whatever the sensor did. Only surfaces that face along its path tell, and vehicles that keep pace
//! with it do not keep it to the centimetre.

use nalgebra::{IsometryMatrix3, Point3};

use super::open_motions::axis_name;
use super::repeats::axes;

use crate::cloud::depth_image::{DepthImage, SHARP};
use crate::cloud::patches::{FineCloud, overlap};
use crate::steps::pair::Pair;
use snake_core::Result;
use snake_geometry::Vector;

/// A cloud was seen from one place if this much of it is visible from there. Unit: share of the
/// fine voxels. Synthetic scans have 0.99 and more, fused fragments of rooms about 0.9.
const MIN_ONE_VIEW: f64 = 0.98;
/// Two sensors are at one place if they are at most this far apart. Unit: inlier distances. Of 19
/// synthetic facades and fences that were wrong and reliable, 18 have less; the last has 1.6.
const STANDING: f64 = 1.0;

/// Most of the surfaces that face along an axis lie apart if more than this share does. Vehicles that drift have 0.6 to 1, scenes at rest 0.
const MOST: f64 = 0.5;

/// A note if most of the surfaces that face along one axis lie apart, although the sensors would stand at one place.
pub(super) fn apart_note(pair: &Pair, transform: &IsometryMatrix3<f64>) -> Result<Option<String>> {
    let overlap = overlap(pair.fine()?, transform, pair.criteria().inlier_distance);
    let axis = axes(&overlap.patches).into_iter().flatten().find(|axis| overlap.apart_along(axis) > MOST);
    let note = |axis| {
        let axis = axis_name(&axis);
        format!(
            "ambiguous: most surfaces that face along {axis} lie apart, as if they moved: either they did, or the sensor"
        )
    };
    Ok(axis.map(note))
}

/// Whether a transform puts the sensors of both scans at one place. Not if they are unknown, or if a cloud was not seen
/// from one place.
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

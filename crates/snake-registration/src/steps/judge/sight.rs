//! What the sensor of one cloud saw through of the other, as sharply as the surfaces coincide.

use nalgebra::IsometryMatrix3;

use super::repeats::axes;
use crate::cloud::depth_image::{DepthImage, SHARP};
use crate::cloud::patches::{AGREEING_COSINE, Overlap, Place};
use crate::steps::pair::Pair;
use snake_core::Result;
use snake_geometry::some_in_parallel;

/// A place is on a cloud up to this distance. Unit: inlier distances.
const ON: f64 = 1.0 / 3.0;
/// It is off the cloud beyond this many. Drift in real rooms leaves a share of 0.01 with 25, and of 0.0007 with this.
/// Unit: median distances of the patches.
const RESIDUALS: f64 = 50.0;
/// Number of places of each cloud, at most. Set for time.
const PLACES: usize = 2000;
/// Fewer places count as this many, because one of a few may be a stray.
const MIN_PLACES: usize = 200;

/// The share of the places on the other cloud or seen through by its sensor that are seen through. Places that face the
/// overlap's most frequent direction do not count: a floor lies on itself after any slide and turn along it.
pub(super) fn seen_through(pair: &Pair, transform: &IsometryMatrix3<f64>, overlap: &Overlap) -> Result<f64> {
    let Some([axis, ..]) = axes(&overlap.patches) else { return Ok(0.0) };
    let (fine, on) = (pair.fine()?, ON * pair.criteria().inlier_distance);
    let off = on.max(RESIDUALS * overlap.residual());
    let mut through = Vec::new();
    for (from, transform) in [(0, *transform), (1, transform.inverse())] {
        let Some(viewpoint) = pair.viewpoints()[1 - from] else { continue };
        let other = fine[1 - from];
        let image = DepthImage::new(other.points(), viewpoint.place(), off, SHARP);
        let axis = if from == 0 { axis } else { transform.rotation * axis };
        let tell = |place: &Place| {
            let place = place.moved(&transform);
            let normal = place.normal.filter(|normal| normal.dot(&axis).abs() < AGREEING_COSINE)?;
            let distance = other.distance(&place.point);
            if distance <= on {
                Some(false)
            } else {
                (distance > off && image.is_ahead(&place.point, &normal)).then_some(true)
            }
        };
        through.extend(some_in_parallel(fine[from].thinned(on, PLACES).iter(), tell));
    }
    Ok(through.iter().filter(|through| **through).count() as f64 / through.len().max(MIN_PLACES) as f64)
}

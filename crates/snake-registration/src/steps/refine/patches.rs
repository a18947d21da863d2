//! The last refinement, on the planar patches of clouds that are much finer than their voxels.

use nalgebra::IsometryMatrix3;

use super::icp::iterate;
use crate::cloud::patches::{self, FineCloud, overlap};
use crate::cloud::planes::PlanePair;
use snake_core::{Counter, Result};
use snake_geometry::Vector;

/// Distance between pairs of planar patches and number of steps, round by round. Unit: fine voxels, steps. Set for time
/// (0.08 instead of 0.11 s of CPU for a pair of made streets).
const PATCH_ROUNDS: [(f64, usize); 2] = [(4.0, 4), (2.0, 8)];
/// Pairs of patches farther apart than this are left out. Unit: medians of all pairs. Half and twice change no outcome.
const MAX_MEDIANS: f64 = 4.0;

/// Refines a transform on the planar patches of both clouds; clouds that are hardly finer than
/// their voxels keep it.
pub(crate) fn refine_on_patches(
    clouds: [&FineCloud; 2],
    rough: IsometryMatrix3<f64>,
    gravity: Option<Vector>,
    counter: &Counter,
) -> Result<IsometryMatrix3<f64>> {
    if !clouds.iter().all(|cloud| cloud.is_finer) {
        return Ok(rough);
    }
    let mut transform = rough;
    for (factor, steps) in PATCH_ROUNDS {
        let distance = factor * clouds[0].side.max(clouds[1].side);
        let pairs = |transform: &IsometryMatrix3<f64>| without_far(overlap(clouds, transform, distance).patches);
        transform = iterate(pairs, transform, gravity, (steps, distance), counter)?;
    }
    Ok(transform)
}

/// The pairs whose planes are not much farther than the median; none if there are too few pairs.
fn without_far(mut pairs: Vec<PlanePair>) -> Vec<PlanePair> {
    if pairs.len() < patches::MIN_PAIRS {
        return Vec::new();
    }
    let mut distances: Vec<f64> = pairs.iter().map(|pair| pair.distance.abs()).collect();
    let middle = distances.len() / 2;
    let (_, median, _) = distances.select_nth_unstable_by(middle, f64::total_cmp);
    let limit = MAX_MEDIANS * *median;
    pairs.retain(|pair| pair.distance.abs() <= limit);
    pairs
}

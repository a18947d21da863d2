//! The last refinement, on the planar patches of clouds that are much finer than their voxels.

use nalgebra::IsometryMatrix3;

use super::icp::iterate;
use crate::cloud::patches::{self, FineCloud, overlap};
use crate::cloud::planes::PlanePair;
use snake_core::{Counter, Result};
use snake_geometry::Vector;

/// Largest distance between paired patches, and number of steps, for each round. Unit: fine voxels,
/// steps. Set for time (0.08 instead of 0.11 s of CPU for a pair of synthetic streets).
const PATCH_ROUNDS: [(f64, usize); 2] = [(4.0, 4), (2.0, 8)];
/// Pairs of patches farther apart than this are left out. Unit: medians of all pairs. Half and twice change no outcome.
const MAX_MEDIANS: f64 = 4.0;

/// Refines a transform on the planar patches of both clouds. Each patch is weighted by its noise: a far wall is
/// measured less precisely than a near one. Clouds that are hardly finer than their voxels keep the rough transform.
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
        let pairs = |transform: &IsometryMatrix3<f64>| without_far(overlap(clouds, transform, distance).weighed);
        transform = iterate(pairs, transform, gravity, (steps, distance), counter)?;
    }
    Ok(transform)
}

/// Drops pairs whose planes are much farther than the median, and scales the mean weight to 1; none if there are too few.
fn without_far(mut pairs: Vec<PlanePair>) -> Vec<PlanePair> {
    if pairs.len() < patches::MIN_PAIRS {
        return Vec::new();
    }
    let mut distances: Vec<f64> = pairs.iter().map(|pair| pair.distance.abs()).collect();
    let middle = distances.len() / 2;
    let (_, median, _) = distances.select_nth_unstable_by(middle, f64::total_cmp);
    let limit = MAX_MEDIANS * *median;
    pairs.retain(|pair| pair.distance.abs() <= limit);
    let mean = pairs.iter().map(|pair| pair.normal.norm_squared()).sum::<f64>() / pairs.len() as f64;
    for PlanePair { normal, distance, .. } in &mut pairs {
        *normal /= mean.sqrt();
        *distance /= mean.sqrt();
    }
    pairs
}

#[cfg(test)]
mod tests {
    use chacha20::ChaCha8Rng;
    use rand::SeedableRng;

    use super::*;
    use crate::rigid::tests::random_points;
    use snake_geometry::Point;

    /// Three walls of the cube ±1, whose noise grows with the square of x.
    fn walls(seed: u64) -> FineCloud {
        let noisy = |(i, p): (usize, Point)| {
            let mut point = p;
            point[i % 3] = 1.0;
            point[i % 3] += 0.04 * (0.5 + 0.5 * point[0]).powi(2) * p[i % 3];
            point
        };
        let points = random_points(&mut ChaCha8Rng::seed_from_u64(seed), 20_000).into_iter().enumerate();
        FineCloud::new(&points.map(noisy).collect::<Vec<_>>(), 0.4, 1).unwrap()
    }

    #[test]
    fn the_noise_of_far_walls_matters_less_than_with_equal_weights() {
        let rough = IsometryMatrix3::new(Vector::new(0.02, -0.01, 0.02), Vector::new(0.01, 0.01, -0.01));
        let counter = Counter::default();
        let [mut weighed, mut equal] = [0.0; 2];
        for seed in 0..5 {
            let clouds = [walls(seed), walls(seed + 100)];
            let [source, target] = &clouds;
            let pairs = |transform: &_| overlap([source, target], transform, 0.1).patches;
            let plain = iterate(pairs, rough, None, (12, 0.1), &counter).unwrap();
            let refined = refine_on_patches([source, target], rough, None, &counter).unwrap();
            weighed += refined.translation.vector.norm() + refined.rotation.angle();
            equal += plain.translation.vector.norm() + plain.rotation.angle();
        }
        assert!(weighed < 0.5 * equal, "{weighed} {equal}");
    }
}

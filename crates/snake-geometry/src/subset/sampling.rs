//! Random samples of clouds.

use chacha20::ChaCha8Rng;
use rand::SeedableRng;
use rand::seq::index;

use crate::Point;

/// `number` points, drawn at random without replacement, in the order of the cloud. `number` is at most their count.
pub fn sample(points: &[Point], number: usize, seed: u64) -> Vec<Point> {
    let mut drawn = index::sample(&mut ChaCha8Rng::seed_from_u64(seed), points.len(), number).into_vec();
    drawn.sort_unstable();
    drawn.into_iter().map(|index| points[index]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Keypoints of a cloud with `max_points` depend on these.
    #[test]
    fn the_draws_of_a_seed_stay() {
        let points: Vec<Point> = (0..1000).map(|i| [i as f32, 0.0, 0.0]).collect();
        let drawn = |number| sample(&points, number, 7).iter().map(|point| point[0] as usize).collect::<Vec<_>>();
        assert_eq!(drawn(200)[..12], [7, 17, 19, 23, 30, 41, 46, 50, 62, 66, 67, 69]);
        for number in [0, 1, 200, 1000] {
            let sample_indices = drawn(number);
            assert!(sample_indices.len() == number && sample_indices.is_sorted_by(|a, b| a < b));
        }
    }
}

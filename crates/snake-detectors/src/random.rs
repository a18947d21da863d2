//! Random points, the baseline for every detector.

use rand::{RngExt, SeedableRng};

use super::{Response, among_finite, by_falling_score, index_cloud};
use snake_core::Result;
use snake_geometry::Point;

/// `count` points of the cloud, or all points if it has fewer, drawn without replacement. Every point
/// gets a random score in [0, 1), and the points with the highest scores are taken.
///
/// # Errors
/// [`Error::Input`](snake_core::Error::Input) when the cloud has no finite points or is one point repeated.
pub fn random_points(points: &[Point], count: usize, seed: u64) -> Result<Vec<Response>> {
    among_finite(points, |points| find(points, count, seed))
}

/// [`random_points`] for finite points.
fn find(points: &[Point], count: usize, seed: u64) -> Result<Vec<Response>> {
    index_cloud(points)?;
    let mut rng = chacha20::ChaCha8Rng::seed_from_u64(seed);
    let mut drawn = by_falling_score((0..points.len()).map(|index| Response { index, score: rng.random() }).collect());
    drawn.truncate(count);
    Ok(drawn)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn draws_are_uniform_seeded_and_without_replacement() {
        let points: Vec<Point> = (0..50).map(|i| [i as f32, 0.0, 0.0]).collect();
        let mut hits = [0; 50];
        for seed in 0..2000 {
            let drawn = random_points(&points, 10, seed).unwrap();
            drawn.iter().for_each(|response| hits[response.index] += 1);
            assert_eq!(drawn, random_points(&points, 10, seed).unwrap());
        }
        // 400 hits each, with a standard deviation of 18.
        assert!(hits.iter().all(|hits| (310..490).contains(hits)), "{hits:?}");
        let mut all: Vec<usize> = random_points(&points, 999, 0).unwrap().iter().map(|r| r.index).collect();
        assert_ne!(all, (0..50).collect::<Vec<_>>());
        all.sort_unstable();
        assert_eq!(all, (0..50).collect::<Vec<_>>());
    }
}

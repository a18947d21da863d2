//! A hint where keypoints cluster in a part of the cloud.

use rand::SeedableRng;
use rand::seq::index::sample;
use rand_chacha::ChaCha8Rng;

use snake_geometry::{Keypoint, Neighbors, Point, vector};

/// Minimum number of keypoints for a hint.
const MIN_KEYPOINTS: usize = 8;
/// Maximum number of points whose distances are measured.
const MAX_POINTS: usize = 1000;
/// Keypoints are clustered if the mean distance from a point to its nearest keypoint is at least this multiple of that to as
/// many random points.
const CLUSTERED: f64 = 2.0;

/// One sentence for the user if keypoints cluster in a part of their cloud `(N, 3)`: the mean distance from its points to the
/// nearest keypoint is at least twice that to as many random points. The points are those that are used
/// ([`Field::points`](crate::Field::points)). `None` if keypoints do not cluster, if there are fewer than eight, or if a point
/// is not finite. The sentence is always the same.
///
/// ```
/// use snake_core::{Covariance, Keypoint, cluster_hint};
/// let points: Vec<[f32; 3]> = (0..900).map(|i| [(i % 30) as f32, (i / 30) as f32, 0.0]).collect();
/// let (confidence, covariance) = (None, Covariance::UNKNOWN);
/// let keypoint = |position| Keypoint { position, saliency: 0.9, occupancy: 0.9, nearest_index: 0, confidence, covariance };
/// let clump: Vec<Keypoint> = (0..16).map(|i| keypoint([(i % 4) as f32, (i / 4) as f32, 0.0])).collect();
/// assert!(cluster_hint(&points, &clump).is_some());
/// ```
pub fn cluster_hint(points: &[Point], keypoints: &[Keypoint]) -> Option<String> {
    let is_usable = points.iter().flatten().all(|value| value.is_finite());
    if !is_usable || keypoints.len() < MIN_KEYPOINTS || points.len() < keypoints.len() {
        return None;
    }
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let mut draw = |number| sample(&mut rng, points.len(), number).iter().map(|i| points[i]).collect::<Vec<_>>();
    let (random, measured) = (draw(keypoints.len()), draw(MAX_POINTS.min(points.len())));
    let distance_to = |places: Vec<Point>| {
        let neighbors = Neighbors::new(places.into_iter().map(vector).collect()).ok()?;
        Some(measured.iter().map(|&p| neighbors.distance(&vector(p))).sum::<f64>() / measured.len() as f64)
    };
    let to_keypoints = distance_to(keypoints.iter().map(|keypoint| keypoint.position).collect())?;
    let to_random = distance_to(random)?;
    (to_keypoints >= CLUSTERED * to_random && to_random > 0.0).then(|| {
        format!(
            "the keypoints cluster: a point is on average at least {CLUSTERED} times as far from the nearest as from as many \
             random points; a larger `nms_radius` spreads them"
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use snake_geometry::Covariance;

    fn keypoints(positions: impl Iterator<Item = Point>) -> Vec<Keypoint> {
        let (confidence, covariance) = (None, Covariance::UNKNOWN);
        let keypoint =
            |position| Keypoint { position, saliency: 1.0, occupancy: 1.0, nearest_index: 0, confidence, covariance };
        positions.map(keypoint).collect()
    }

    fn square() -> Vec<Point> {
        (0..2500).map(|i| [(i % 50) as f32, (i / 50) as f32, 0.0]).collect()
    }

    #[test]
    fn only_keypoints_in_a_part_of_the_cloud_have_a_hint() {
        let points = square();
        let spread = keypoints((0..64).map(|i| [(i % 8) as f32 * 7.0, (i / 8) as f32 * 7.0, 0.0]));
        let clump = keypoints((0..64).map(|i| [(i % 8) as f32, (i / 8) as f32, 0.0]));
        assert_eq!(cluster_hint(&points, &spread), None);
        assert!(cluster_hint(&points, &clump).unwrap().starts_with("the keypoints cluster"));
        assert_eq!(cluster_hint(&points, &clump[..7]), None);
    }

    #[test]
    fn clouds_that_cannot_be_used_have_no_hint() {
        let some = keypoints((0..9).map(|i| [i as f32, 0.0, 0.0]));
        for points in [vec![], vec![[f32::NAN; 3]; 20], vec![[1.0; 3]; 20], vec![[0.0; 3]; 3]] {
            assert_eq!(cluster_hint(&points, &some), None);
        }
    }
}

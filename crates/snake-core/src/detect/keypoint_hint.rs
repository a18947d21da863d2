//! A hint where keypoints are few, or cluster in a part of the cloud.

use rand::SeedableRng;
use rand::seq::index::sample;
use rand_chacha::ChaCha8Rng;

use super::{Counts, Detection};
use crate::DetectOptions;
use snake_geometry::{Neighbors, Point, vector};

/// Fewer keypoints are few; the others may cluster.
const MIN_KEYPOINTS: usize = 8;
/// Maximum number of points whose distances are measured.
const MAX_POINTS: usize = 1000;
/// Keypoints are clustered if the mean distance from a point to its nearest keypoint is at least this multiple of that to as
/// many random points.
const CLUSTERED: f64 = 2.0;

/// One sentence for the user if there are fewer than eight keypoints though more were allowed, why and what gives more; or if keypoints cluster in a part of
/// their cloud `(N, 3)`: the mean distance from its points to the nearest keypoint is at least twice that to as many random points.
/// The points are those that are used ([`Field::points`](crate::Field::points)). `None` if neither is so, or if a point is not
/// finite. The sentence is always the same.
///
/// ```
/// use snake_core::{Covariance, DetectOptions, Detection, Keypoint, keypoint_hint};
/// let points: Vec<[f32; 3]> = (0..900).map(|i| [(i % 30) as f32, (i / 30) as f32, 0.0]).collect();
/// let (confidence, covariance) = (None, Covariance::UNKNOWN);
/// let keypoint = |position| Keypoint { position, saliency: 0.9, occupancy: 0.9, nearest_index: 0, confidence, covariance };
/// let mut clump = Detection::default();
/// clump.keypoints = (0..16).map(|i| keypoint([(i % 4) as f32, (i / 4) as f32, 0.0])).collect();
/// assert!(keypoint_hint(&points, &clump, &DetectOptions::default()).is_some());
/// ```
pub fn keypoint_hint(points: &[Point], detection: &Detection, options: &DetectOptions) -> Option<String> {
    let keypoints = &detection.keypoints;
    if keypoints.len() < MIN_KEYPOINTS {
        return (keypoints.len() < options.max_keypoints).then(|| few(keypoints.len(), &detection.counts));
    }
    let is_usable = points.iter().flatten().all(|value| value.is_finite());
    if !is_usable || points.len() < keypoints.len() {
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

/// Why there are few keypoints, and what gives more.
fn few(number: usize, counts: &Counts) -> String {
    let (why, more) = match counts {
        Counts { occupied: 0, .. } => ("the field has no surface", "a lower `occupancy_threshold`, such as 0.3, gives"),
        Counts { above_threshold: 0, .. } => ("no place is salient enough", "a lower `saliency_threshold` gives"),
        _ => {
            let why = "another view of these points would find few places again";
            (why, "`min_confidence` 0 gives all, and a smaller `nms_radius`")
        }
    };
    format!("{number} keypoints: {why}; {more} more")
}

#[cfg(test)]
mod tests {
    use super::*;
    use snake_geometry::{Covariance, Keypoint};

    fn keypoints(positions: impl Iterator<Item = Point>) -> Detection {
        let (confidence, covariance) = (None, Covariance::UNKNOWN);
        let keypoint =
            |position| Keypoint { position, saliency: 1.0, occupancy: 1.0, nearest_index: 0, confidence, covariance };
        Detection { keypoints: positions.map(keypoint).collect(), ..Detection::default() }
    }

    fn square() -> Vec<Point> {
        (0..2500).map(|i| [(i % 50) as f32, (i / 50) as f32, 0.0]).collect()
    }

    #[test]
    fn only_keypoints_in_a_part_of_the_cloud_have_a_hint() {
        let points = square();
        let spread = keypoints((0..64).map(|i| [(i % 8) as f32 * 7.0, (i / 8) as f32 * 7.0, 0.0]));
        let clump = keypoints((0..64).map(|i| [(i % 8) as f32, (i / 8) as f32, 0.0]));
        assert_eq!(keypoint_hint(&points, &spread, &DetectOptions::default()), None);
        assert!(
            keypoint_hint(&points, &clump, &DetectOptions::default()).unwrap().starts_with("the keypoints cluster")
        );
    }

    #[test]
    fn few_keypoints_have_a_reason_and_a_remedy() {
        let mut detection = keypoints((0..7).map(|i| [i as f32 * 7.0, 0.0, 0.0]));
        for (occupied, above_threshold, remedy) in
            [(0, 0, "`occupancy_threshold`"), (9, 0, "`saliency_threshold`"), (9, 9, "`min_confidence`")]
        {
            detection.counts = Counts { occupied, above_threshold, ..Counts::default() };
            let hint = keypoint_hint(&square(), &detection, &DetectOptions::default()).unwrap();
            let few = DetectOptions { max_keypoints: 7, ..Default::default() };
            assert_eq!(keypoint_hint(&square(), &detection, &few), None);
            assert!(hint.starts_with("7 keypoints: ") && hint.contains(remedy), "{hint}");
        }
    }

    #[test]
    fn clouds_that_cannot_be_used_have_no_hint() {
        let some = keypoints((0..9).map(|i| [i as f32, 0.0, 0.0]));
        for points in [vec![], vec![[f32::NAN; 3]; 20], vec![[1.0; 3]; 20], vec![[0.0; 3]; 3]] {
            assert_eq!(keypoint_hint(&points, &some, &DetectOptions::default()), None);
        }
    }
}

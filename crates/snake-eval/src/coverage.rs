//! The suppression radius for a given coverage, so that detectors are compared at equal coverage.

use rayon::prelude::*;
use snake_core::{Error, Result};
use snake_geometry::{Point, check_points, suppress_ranked};

use crate::mean_distance_to_keypoints;

/// The ratio of a radius to the one before it.
const STEP: f64 = 1.2;
/// The number of steps from a hundredth of the coverage to a hundred times the coverage.
const STEPS: i32 = 50;
/// Halvings of the last step: the radius is right to a part in 1000.
const HALVINGS: usize = 7;

/// A cloud with the keypoints of a detector.
#[derive(Debug, Clone, PartialEq)]
pub struct RankedKeypoints {
    /// The cloud `(N, 3)`.
    pub points: Vec<Point>,
    /// Positions of keypoints `(K, 3)`, best first, without suppression.
    pub keypoints: Vec<Point>,
}

/// The suppression radius at which a detector's keypoints reach a given coverage, in cloud units. One radius serves all
/// clouds.
///
/// The coverage of a cloud is the mean distance from its points to the nearest of its best `count` keypoints. The returned
/// radius is the smallest at which its mean over the clouds is at most `coverage`; 0 if no suppression is needed. If no radius
/// reaches that coverage, the radius with the best coverage is returned. Clouds without keypoints do not count.
///
/// # Errors
/// [`Error::Input`] for an empty cloud or coordinates that are not finite, [`Error::Option`] for a coverage that is not
/// positive.
pub fn radius_of_coverage(clouds: &[RankedKeypoints], count: usize, coverage: f64) -> Result<f64> {
    if !(coverage > 0.0 && coverage.is_finite()) {
        return Err(Error::Option { name: "coverage", value: coverage.to_string(), allowed: "a length above 0" });
    }
    let with_keypoints = clouds.iter().filter(|cloud| !cloud.keypoints.is_empty());
    with_keypoints.clone().try_for_each(|cloud| check_points("keypoints", &cloud.keypoints))?;
    if with_keypoints.count() == 0 {
        return Ok(0.0);
    }
    let reached = |radius: f64| mean_coverage(clouds, count, radius);
    if reached(0.0)? <= coverage {
        return Ok(0.0);
    }
    let radii = (0..STEPS).map(|step| 0.01 * coverage * STEP.powi(step));
    let (mut best, mut least) = (0.0, f64::INFINITY);
    for radius in radii {
        let covered = reached(radius)?;
        if covered < least {
            (best, least) = (radius, covered);
        }
        if covered <= coverage {
            break;
        }
        // With growing radius the keypoints spread, until so few are left that they cover less again.
        if covered > 1.5 * least {
            return Ok(best);
        }
    }
    if least > coverage {
        return Ok(best);
    }
    let (mut too_small, mut enough) = (best / STEP, best);
    for _ in 0..HALVINGS {
        let middle = f64::midpoint(too_small, enough);
        if reached(middle)? <= coverage { enough = middle } else { too_small = middle }
    }
    Ok(enough)
}

fn mean_coverage(clouds: &[RankedKeypoints], count: usize, radius: f64) -> Result<f64> {
    let of = |RankedKeypoints { points, keypoints }: &RankedKeypoints| -> Result<f64> {
        let kept = suppress_ranked(keypoints, radius as f32, count)?;
        let kept: Vec<Point> = kept.into_iter().map(|index| keypoints[index]).collect();
        mean_distance_to_keypoints(points, &kept)
    };
    let covered =
        clouds.par_iter().filter(|cloud| !cloud.keypoints.is_empty()).map(of).collect::<Result<Vec<f64>>>()?;
    Ok(covered.iter().sum::<f64>() / covered.len() as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A line of points at 0, 1, .., 99, all of which are keypoints.
    fn line() -> RankedKeypoints {
        let points: Vec<Point> = (0..100).map(|i| [i as f32, 0.0, 0.0]).collect();
        RankedKeypoints { keypoints: points.clone(), points }
    }

    #[test]
    fn the_keypoints_cover_as_asked_and_hardly_further() {
        let clouds = [line(), line()];
        // The coverage changes where the radius passes a distance of two points, which are whole numbers here.
        for asked in [3.0, 5.0, 10.0] {
            let radius = radius_of_coverage(&clouds, 10, asked).unwrap();
            assert!(mean_coverage(&clouds, 10, radius).unwrap() <= asked);
            assert!(mean_coverage(&clouds, 10, radius * 0.98).unwrap() > asked, "{asked} {radius}");
        }
        // The best ten cover to 40.95 on average, without any suppression.
        assert_eq!(radius_of_coverage(&clouds, 10, 41.0).unwrap(), 0.0);
    }

    #[test]
    fn where_nothing_covers_as_far_the_best_radius_is_taken() {
        let radius = radius_of_coverage(&[line()], 10, 0.5).unwrap();
        let reached = mean_coverage(&[line()], 10, radius).unwrap();
        assert!((2.0..3.0).contains(&reached), "{radius} {reached}");
        let none = RankedKeypoints { keypoints: Vec::new(), ..line() };
        assert_eq!(radius_of_coverage(std::slice::from_ref(&none), 10, 0.5).unwrap(), 0.0);
        assert!(radius_of_coverage(&[line()], 10, 0.0).is_err());
    }
}

//! Surface variation (Pauly, Gross and Kobbelt 2002): how far a neighbourhood is from being flat.

use serde::{Deserialize, Serialize};

use super::{Response, among_distinct, each_point, index_cloud, local_maxima};
use snake_core::{Control, Result};
use snake_geometry::{Length, Point, Vector, eigen, options};

options! {
    /// Options of [`surface_variation`].
    pub struct SurfaceVariationOptions {
        /// Radius of the neighbourhood for the eigenvalues.
        radius, with_radius: Length = Length::Percent(30.0);
        /// Radius of non-maximum suppression: a keypoint's surface variation is the largest within this radius.
        non_max_radius, with_non_max_radius: Length = Length::Resolutions(4.0);
    }
}

/// Keypoints of the largest surface variation, by falling score.
///
/// The score is the smallest eigenvalue of the covariance of the points closer than `radius`, divided by the sum of
/// all three: 0 on a plane, at most 1/3. An exactly flat neighbourhood has no keypoint.
///
/// # Errors
/// [`Error::Input`](snake_core::Error::Input) when the cloud has no finite points or is one point
/// repeated; [`Error::Option`](snake_core::Error::Option) when an option is outside its range.
pub fn surface_variation(points: &[Point], options: &SurfaceVariationOptions) -> Result<Vec<Response>> {
    surface_variation_with(points, options, &Control::default())
}

/// [`surface_variation`] with cancellation and a deadline.
///
/// # Errors
/// The errors of [`surface_variation`]; [`Error::Cancelled`](snake_core::Error::Cancelled) and
/// [`Error::DeadlineExceeded`](snake_core::Error::DeadlineExceeded).
pub fn surface_variation_with(
    points: &[Point],
    options: &SurfaceVariationOptions,
    control: &Control,
) -> Result<Vec<Response>> {
    among_distinct(points, |points| find(points, options, control))
}

/// [`surface_variation`] for finite, distinct points.
fn find(points: &[Point], options: &SurfaceVariationOptions, control: &Control) -> Result<Vec<Response>> {
    options.check_ranges()?;
    let cloud = index_cloud(points)?;
    let radius = options.radius.in_units("radius", points)?;
    let non_max_radius = options.non_max_radius.in_units("non_max_radius", points)?;
    cloud.check_density("radius", radius)?;
    cloud.check_density("non_max_radius", non_max_radius)?;
    let variation = |point: &Vector| {
        let ([third, second, first], _) = eigen(cloud.covariance(&cloud.within(point, radius)));
        // A neighbourhood that is flat up to rounding has no variation.
        if third > first * f64::EPSILON * 8.0 { third / (first + second + third) } else { 0.0 }
    };
    let variations = each_point(&cloud, control, variation)?;
    local_maxima(&cloud, &variations, non_max_radius, 0, control, |variation| variation > 0.0)
}

#[cfg(test)]
mod tests {
    use super::super::tests::{corner, cube};
    use super::*;
    use nalgebra::Matrix3;
    use snake_geometry::vector;

    #[test]
    fn the_corners_of_a_cube_are_the_strongest() {
        let options = SurfaceVariationOptions::default().with_non_max_radius(Length::Units(0.3));
        let points = cube(11);
        let keypoints = surface_variation(&points, &options).unwrap();
        let mut corners: Vec<_> = keypoints[..8].iter().filter_map(|response| corner(points[response.index])).collect();
        corners.sort_unstable();
        assert_eq!(corners, [0, 1, 2, 3, 4, 5, 6, 7]);
    }

    #[test]
    fn every_maximum_has_the_variation_of_the_definition() {
        let points = cube(7);
        let radius = 0.36;
        let variation = |a: Point| {
            let near: Vec<Vector> =
                points.iter().map(|&b| vector(b)).filter(|b| (vector(a) - b).norm() < radius).collect();
            let mean = near.iter().sum::<Vector>() / near.len() as f64;
            let covariance: Matrix3<f64> = near.iter().map(|b| (b - mean) * (b - mean).transpose()).sum();
            let values = covariance.symmetric_eigenvalues();
            values.min() / values.sum()
        };
        let options = SurfaceVariationOptions::default()
            .with_radius(Length::Units(radius))
            .with_non_max_radius(Length::Units(0.2));
        let keypoints = surface_variation(&points, &options).unwrap();
        for response in &keypoints {
            assert!((response.score - variation(points[response.index])).abs() < 1e-9, "{}", response.score);
        }
        let highest = points.iter().map(|&point| variation(point)).fold(0.0, f64::max);
        assert!((keypoints[0].score - highest).abs() < 1e-9);
    }

    #[test]
    fn radii_may_be_per_cent_of_the_clouds() {
        // The distance from the mean to the farthest corner of a unit cube is half its diagonal.
        let points = cube(9);
        let radius = Length::Units(0.3 * 0.75_f64.sqrt());
        let options = SurfaceVariationOptions::default();
        let scores = |options| surface_variation(&points, &options).unwrap();
        assert_eq!(scores(options), scores(options.with_radius(radius)));
        assert!(surface_variation(&points, &options.with_radius(Length::Percent(0.0))).is_err());
    }

    #[test]
    fn flat_clouds_have_no_keypoints() {
        let plane = |i: u32| [(i % 30) as f32 * 0.1, (i / 30) as f32 * 0.13, 7.7];
        let points: Vec<Point> = (0..900).map(plane).collect();
        assert_eq!(surface_variation(&points, &SurfaceVariationOptions::default()).unwrap(), []);
    }
}

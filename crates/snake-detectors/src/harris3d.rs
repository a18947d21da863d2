//! Harris 3D (Sipiran and Bustos 2011), as PCL computes it.

use nalgebra::Matrix3;
use serde::{Deserialize, Serialize};

use super::{Response, among_distinct, each_point, index_cloud, local_maxima};
use snake_core::{Control, Error, Result};
use snake_geometry::{Length, Point, Vector, options};

options! {
    /// Options of [`harris3d`].
    pub struct Harris3dOptions {
        /// Radius of the neighbourhood for normals, responses and local maxima.
        radius, with_radius: Length = Length::Resolutions(6.0);
        /// Responses below this are dropped; responses lie between 0 and 1/27.
        threshold, with_threshold: f64 = 0.0;
        /// Keep only local maxima; a flat neighbourhood has none. If false, every point is a
        /// keypoint, as in the wrapper behind the paper's tables.
        non_max, with_non_max: bool = true;
    }
}

/// Local maxima have a response above this. A flat neighbourhood has a response of 0 up to rounding.
const FLAT: f64 = 1e-12;

/// Harris 3D keypoints, by falling score.
///
/// The score is PCL's response `0.04 + det C - 0.04 (tr C)²`, where `C` is the mean of `n nᵀ` over the neighbours'
/// normals n. As `tr C` is 1, the response is the determinant, which is large where normals point in all directions.
/// Keypoints are input points: PCL's refinement of positions is omitted.
///
/// # Errors
/// [`Error::Input`] when the cloud has no finite points or is one point repeated; [`Error::Option`]
/// when an option is outside its range.
pub fn harris3d(points: &[Point], options: &Harris3dOptions) -> Result<Vec<Response>> {
    harris3d_with(points, options, &Control::default())
}

/// [`harris3d`] with cancellation and a deadline.
///
/// # Errors
/// The errors of [`harris3d`]; [`Error::Cancelled`](snake_core::Error::Cancelled) and
/// [`Error::DeadlineExceeded`](snake_core::Error::DeadlineExceeded).
pub fn harris3d_with(points: &[Point], options: &Harris3dOptions, control: &Control) -> Result<Vec<Response>> {
    among_distinct(points, |points| find(points, options, control))
}

/// [`harris3d`] for finite, distinct points.
fn find(points: &[Point], options: &Harris3dOptions, control: &Control) -> Result<Vec<Response>> {
    if !options.threshold.is_finite() {
        let value = options.threshold.to_string();
        return Err(Error::Option { name: "threshold", value, allowed: "a finite number" });
    }
    options.check_ranges()?;
    let cloud = index_cloud(points)?;
    let radius = options.radius.resolve("radius", || cloud.resolution())?;
    cloud.check_density("radius", radius)?;
    let neighbors = |point: &Vector| cloud.within(point, radius);
    let normals = each_point(&cloud, control, |point| cloud.normal(&neighbors(point)))?;
    let response = |point: &Vector| {
        let around: Vec<&Vector> = neighbors(point).into_iter().filter_map(|i| normals[i].as_ref()).collect();
        let sum: Matrix3<f64> = around.iter().map(|n| *n * n.transpose()).sum();
        (sum / around.len().max(1) as f64).determinant().max(0.0)
    };
    let responses = each_point(&cloud, control, response)?;
    if options.non_max {
        let is_corner = |response| response > FLAT && response >= options.threshold;
        return local_maxima(&cloud, &responses, radius, 0, control, is_corner);
    }
    // No point is closer than 0, so the radius 0 suppresses nothing.
    local_maxima(&cloud, &responses, 0.0, 0, control, |response| response >= options.threshold)
}

#[cfg(test)]
mod tests {
    use super::super::tests::{corner, cube};
    use super::*;
    use snake_geometry::vector;

    #[test]
    fn the_corners_of_a_cube_are_the_keypoints() {
        let points = cube(11);
        let options = Harris3dOptions { radius: Length::Units(0.45), ..Default::default() };
        let keypoints = harris3d(&points, &options).unwrap();
        let mut corners: Vec<_> = keypoints.iter().filter_map(|response| corner(points[response.index])).collect();
        corners.sort_unstable();
        assert_eq!((keypoints.len(), corners), (8, vec![0, 1, 2, 3, 4, 5, 6, 7]));
        // The threshold keeps equal responses and drops smaller ones.
        let above = |threshold| harris3d(&points, &Harris3dOptions { threshold, ..options }).unwrap().len();
        assert_eq!((above(keypoints[7].score), above(keypoints[0].score), above(keypoints[0].score * 1.01)), (8, 1, 0));
    }

    #[test]
    fn without_suppression_every_point_has_the_response_of_the_definition() {
        let points = cube(6);
        let options = Harris3dOptions { radius: Length::Units(0.41), threshold: 0.0, non_max: false };
        let keypoints = harris3d(&points, &options).unwrap();
        assert_eq!(keypoints.len(), points.len());
        let near = |a: Point| points.iter().copied().filter(move |&b| (vector(a) - vector(b)).norm() < 0.41);
        let normal = |a: Point| {
            let mean = near(a).map(vector).sum::<Vector>() / near(a).count() as f64;
            let sum: Matrix3<f64> = near(a).map(|b| (vector(b) - mean) * (vector(b) - mean).transpose()).sum();
            let eigen = sum.symmetric_eigen();
            eigen.eigenvectors.column(eigen.eigenvalues.imin()).into_owned()
        };
        for response in keypoints {
            let normals: Vec<Vector> = near(points[response.index]).map(normal).collect();
            let mean = normals.iter().map(|n| n * n.transpose()).sum::<Matrix3<f64>>() / normals.len() as f64;
            let expected = 0.04 + mean.determinant() - 0.04 * mean.trace().powi(2);
            assert!((response.score - expected).abs() < 1e-9, "{} {expected}", response.score);
        }
    }
}

//! Intrinsic shape signatures (Zhong 2009), as Open3D and PCL compute them.

use serde::{Deserialize, Serialize};

use super::{Response, among_distinct, each_point, index_cloud, local_maxima};
use snake_core::{Control, Error, Result};
use snake_geometry::{Length, Point, Vector, eigen, options};

/// The matrix whose eigenvalues are used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Covariance {
    /// The covariance about the neighbourhood's mean, as in Open3D; it does not depend on density.
    #[default]
    AboutMean,
    /// The sum about the point itself, as in PCL; it favours dense regions.
    AboutPoint,
}

options! {
    /// Options of [`iss`]; the defaults are Open3D's.
    pub struct IssOptions {
        /// Radius of the neighbourhood for the eigenvalues.
        salient_radius, with_salient_radius: Length = Length::Resolutions(6.0);
        /// Radius of non-maximum suppression: a keypoint's saliency is the largest within this radius.
        non_max_radius, with_non_max_radius: Length = Length::Resolutions(4.0);
        /// Upper limit of the ratio of the second to the first eigenvalue, above 0.
        gamma_21, with_gamma_21: f64 = 0.975;
        /// Upper limit of the ratio of the third to the second eigenvalue, above 0.
        gamma_32, with_gamma_32: f64 = 0.975;
        /// Minimum number of points in each of the two neighbourhoods, the point itself included.
        min_neighbors, with_min_neighbors: usize = 5;
        /// Matrix whose eigenvalues are used: about-mean (the covariance, as in Open3D) or
        /// about-point (the sum, as in PCL).
        covariance, with_covariance: Covariance = Covariance::AboutMean;
    }
}

/// ISS keypoints, by falling score. The score is the smallest eigenvalue, in squared cloud units:
/// the variance in the direction of least variance.
///
/// The default options give the keypoints of Open3D's `compute_iss_keypoints`, except if rounding
/// decides. Points with the same neighbours have equal saliency: all of them are kept here, but one
/// in Open3D. An exactly flat neighbourhood has no keypoint here and may have one in Open3D.
///
/// # Errors
/// [`Error::Input`] when the cloud has no finite points or is one point repeated; [`Error::Option`]
/// when an option is outside its range.
pub fn iss(points: &[Point], options: &IssOptions) -> Result<Vec<Response>> {
    iss_with(points, options, &Control::default())
}

/// [`iss`] with cancellation and a deadline.
///
/// # Errors
/// The errors of [`iss`]; [`Error::Cancelled`](snake_core::Error::Cancelled) and
/// [`Error::DeadlineExceeded`](snake_core::Error::DeadlineExceeded).
pub fn iss_with(points: &[Point], options: &IssOptions, control: &Control) -> Result<Vec<Response>> {
    among_distinct(points, |points| find(points, options, control))
}

/// [`iss`] for finite, distinct points.
fn find(points: &[Point], options: &IssOptions, control: &Control) -> Result<Vec<Response>> {
    for (name, gamma) in [("gamma_21", options.gamma_21), ("gamma_32", options.gamma_32)] {
        if gamma.is_nan() || gamma <= 0.0 {
            return Err(Error::Option { name, value: gamma.to_string(), allowed: "above 0" });
        }
    }
    options.check_ranges()?;
    let cloud = index_cloud(points)?;
    let salient_radius = options.salient_radius.resolve("salient_radius", || cloud.resolution())?;
    let non_max_radius = options.non_max_radius.resolve("non_max_radius", || cloud.resolution())?;
    cloud.check_density("salient_radius", salient_radius)?;
    cloud.check_density("non_max_radius", non_max_radius)?;
    let saliency = |point: &Vector| {
        let neighbors = cloud.within(point, salient_radius);
        if neighbors.len() < options.min_neighbors {
            return 0.0;
        }
        let matrix = match options.covariance {
            Covariance::AboutMean => cloud.covariance(&neighbors),
            Covariance::AboutPoint => cloud.scatter(&neighbors, point),
        };
        let ([third, second, first], _) = eigen(matrix);
        // A neighbourhood that is flat up to rounding has no saliency.
        let distinct = third > first * f64::EPSILON * 8.0;
        if distinct && second / first < options.gamma_21 && third / second < options.gamma_32 { third } else { 0.0 }
    };
    let saliencies = each_point(&cloud, control, saliency)?;
    local_maxima(&cloud, &saliencies, non_max_radius, options.min_neighbors, control, |saliency| saliency > 0.0)
}

#[cfg(test)]
mod tests {
    use super::super::tests::{corner, cube};
    use super::*;

    #[test]
    fn the_corners_of_a_cube_are_the_strongest() {
        let points = cube(11);
        // At a corner, two eigenvalues are equal, so a limit of the ratio below 1 would drop it.
        for covariance in [Covariance::AboutMean, Covariance::AboutPoint] {
            let options = IssOptions {
                salient_radius: Length::Units(0.35),
                non_max_radius: Length::Units(0.3),
                gamma_21: 1.1,
                gamma_32: 1.1,
                covariance,
                ..Default::default()
            };
            let keypoints = iss(&points, &options).unwrap();
            let mut corners: Vec<_> =
                keypoints[..8].iter().filter_map(|response| corner(points[response.index])).collect();
            corners.sort_unstable();
            assert_eq!(corners, [0, 1, 2, 3, 4, 5, 6, 7], "{covariance:?}");
        }
    }

    #[test]
    fn saliencies_by_hand() {
        // Two points on each axis, at 1, 2 and 3: seven points with the point itself. Sums: 2, 8, 18;
        // means: a seventh.
        let mut points = vec![[0.0; 3]];
        for (axis, offset) in [1.0, 2.0, 3.0].into_iter().enumerate() {
            for sign in [-1.0, 1.0] {
                let mut point = [0.0; 3];
                point[axis] = sign * offset;
                points.push(point);
            }
        }
        let options = IssOptions {
            salient_radius: Length::Units(3.1),
            non_max_radius: Length::Units(0.5),
            min_neighbors: 1,
            ..Default::default()
        };
        let score = |options: &IssOptions| iss(&points, options).unwrap().into_iter().find(|r| r.index == 0);
        assert!((score(&options).unwrap().score - 2.0 / 7.0).abs() < 1e-12);
        let sum = IssOptions { covariance: Covariance::AboutPoint, ..options };
        assert!((score(&sum).unwrap().score - 2.0).abs() < 1e-12);
        // The shares are 8 / 18 and 2 / 8; limits are strict, and neighbours count the point itself.
        for (gamma_21, gamma_32, is_kept) in [(0.45, 0.26, true), (0.44, 0.26, false), (0.45, 0.25, false)] {
            assert_eq!(
                score(&IssOptions { gamma_21, gamma_32, ..options }).is_some(),
                is_kept,
                "{gamma_21} {gamma_32}"
            );
        }
        assert_eq!(score(&IssOptions { min_neighbors: 2, ..options }), None);
        let wide = IssOptions { non_max_radius: Length::Units(3.1), ..options };
        assert!(score(&IssOptions { min_neighbors: 7, ..wide }).is_some());
        assert_eq!(score(&IssOptions { min_neighbors: 8, ..wide }), None);
        // The boundary of the radius is outside: without the points at 3 the cloud is flat.
        assert_eq!(score(&IssOptions { salient_radius: Length::Units(3.0), ..options }), None);
    }
}

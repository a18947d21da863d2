//! The metrics of the 3DMatch benchmark: inlier ratio, feature matching recall, registration recall.

use nalgebra::{Matrix3, Matrix3x6, Matrix6, UnitQuaternion, Vector6};

use serde::{Deserialize, Serialize};

use super::{Coordinate, moved};
use snake_core::{Error, Result};
use snake_geometry::{Neighbors, Point, RigidTransform, check_points, vector};

/// Inlier ratio: the share of correspondences that `t_target_source` brings closer than `threshold`.
///
/// A correspondence is one row of `source` `(N, 3)` and the same row of `target`. The ratio is 0 without
/// correspondences. 3DMatch uses a threshold of 0.1 m.
///
/// # Errors
/// [`Error::Input`] when the arrays differ in length or have coordinates that are not finite.
pub fn inlier_ratio<T: Coordinate>(
    source: &[[T; 3]],
    target: &[[T; 3]],
    t_target_source: &RigidTransform,
    threshold: f64,
) -> Result<f64> {
    if source.len() != target.len() {
        let reason = format!("{} points, but the source has {}; row i matches row i", target.len(), source.len());
        return Err(Error::Input { what: "target", reason });
    }
    let source = moved("source", source, t_target_source)?;
    let target = moved("target", target, &RigidTransform::identity())?;
    let inliers = source.iter().zip(&target).filter(|(s, t)| (*s - *t).norm() < threshold).count();
    Ok(inliers as f64 / source.len().max(1) as f64)
}

/// Feature matching recall: the share of pairs whose inlier ratio is above `threshold` (3DMatch: 0.05).
///
/// The benchmark's pairs include consecutive fragments. Its figure is the unweighted mean over the scenes.
///
/// # Errors
/// [`Error::Input`] without pairs.
pub fn feature_matching_recall(inlier_ratios: &[f64], threshold: f64) -> Result<f64> {
    if inlier_ratios.is_empty() {
        return Err(Error::Input { what: "inlier_ratios", reason: "no pairs".into() });
    }
    Ok(inlier_ratios.iter().filter(|ratio| **ratio > threshold).count() as f64 / inlier_ratios.len() as f64)
}

/// The mean squared displacement of a pair's overlap by the error of an estimated transform, to first order, in squared
/// cloud units (3DMatch, after Choi, Zhou and Koltun 2015).
///
/// It is `eᵀ I e / I₁₁` with the information matrix I of `gt.info` and `e = (t, q_xyz)` of `t_gt⁻¹ t_estimate`. The
/// quaternion `(q_w, q_xyz)`, `q_w ≥ 0`, rotates points. The released code uses MATLAB's `dcm2quat`, which returns the
/// conjugate, and negates it.
///
/// # Errors
/// [`Error::Input`] for an information matrix without information.
pub fn squared_registration_error(
    t_gt: &RigidTransform,
    t_estimate: &RigidTransform,
    information: &[[f64; 6]; 6],
) -> Result<f64> {
    let (gt, estimate) = (t_gt.isometry(), t_estimate.isometry());
    if !(information.as_flattened().iter().all(|v| v.is_finite()) && information[0][0] > 0.0) {
        let reason = "expected finite numbers and a positive first entry, the number of points".into();
        return Err(Error::Input { what: "information", reason });
    }
    let between = UnitQuaternion::from_rotation_matrix(&(gt.rotation.inverse() * estimate.rotation));
    let t = gt.rotation.inverse() * (estimate.translation.vector - gt.translation.vector);
    let q = between.imag() * if between.w < 0.0 { -1.0 } else { 1.0 };
    let error = Vector6::new(t.x, t.y, t.z, q.x, q.y, q.z);
    let information = Matrix6::from_fn(|row, column| information[row][column]);
    Ok(error.dot(&(information * error)) / information[(0, 0)])
}

/// The information matrix of a pair's overlap, as in `gt.info`: the sum of `GᵀG` with `G = [I, -2 [p]ₓ]` over the
/// source points `(N, 3)` in the overlap.
///
/// # Errors
/// [`Error::Input`] without points or for coordinates that are not finite.
pub fn information_matrix<T: Coordinate>(points: &[[T; 3]]) -> Result<[[f64; 6]; 6]> {
    check_points("points", points)?;
    let mut sum = Matrix6::zeros();
    for &point in points {
        let mut g = Matrix3x6::zeros();
        g.fixed_columns_mut::<3>(0).copy_from(&Matrix3::identity());
        g.fixed_columns_mut::<3>(3).copy_from(&(vector(point).cross_matrix() * -2.0));
        sum += g.transpose() * g;
    }
    Ok(std::array::from_fn(|row| std::array::from_fn(|column| sum[(row, column)])))
}

/// The overlap of a pair: the source points that `t_target_source` brings closer than `distance` to a target point.
/// [`information_matrix`] takes these points.
///
/// # Errors
/// [`Error::Input`] for an empty cloud or coordinates that are not finite.
pub fn overlap(
    source: &[Point],
    target: &[Point],
    t_target_source: &RigidTransform,
    distance: f64,
) -> Result<Vec<Point>> {
    check_points("source", source)?;
    check_points("target", target)?;
    let placed = moved("source", source, t_target_source)?;
    let target = Neighbors::new(target.iter().copied().map(vector).collect())?;
    let near = placed.iter().map(|point| target.distance(point) < distance);
    Ok(source.iter().zip(near).filter_map(|(&point, near)| near.then_some(point)).collect())
}

/// The registration result of one pair of fragments.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct RegistrationOutcome {
    /// Number of the first fragment within its scene.
    pub first: usize,
    /// Number of the second fragment.
    pub second: usize,
    /// The [`squared_registration_error`]; `None` if no transform was found.
    pub squared_error: Option<f64>,
}

/// Registration recall of one scene: the share of its ground-truth pairs, without consecutive fragments, whose mean
/// squared error is at most `threshold` squared (3DMatch: 0.2 m).
///
/// The benchmark's figure is the unweighted mean over the scenes.
///
/// # Errors
/// [`Error::Input`] when no pair is left.
pub fn registration_recall(outcomes: &[RegistrationOutcome], threshold: f64) -> Result<f64> {
    let counted: Vec<_> = outcomes.iter().filter(|pair| pair.first.abs_diff(pair.second) > 1).collect();
    if counted.is_empty() {
        return Err(Error::Input { what: "outcomes", reason: "no pairs besides consecutive fragments".into() });
    }
    let good = |pair: &&&RegistrationOutcome| pair.squared_error.is_some_and(|error| error <= threshold * threshold);
    Ok(counted.iter().filter(good).count() as f64 / counted.len() as f64)
}

#[cfg(test)]
mod tests {
    use nalgebra::{IsometryMatrix3, Vector3};

    use super::*;

    fn transform(axis_angle: [f64; 3], translation: [f64; 3]) -> RigidTransform {
        IsometryMatrix3::new(Vector3::from(translation), Vector3::from(axis_angle)).into()
    }

    #[test]
    fn inliers_are_strictly_within_the_threshold() {
        let source = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0], [3.0, 0.0, 0.0]];
        let target = [[1.0, 0.0, 0.0], [2.0, 0.25, 0.0], [3.0, 0.5, 0.0], [9.0, 0.0, 0.0]];
        let t_target_source = transform([0.0; 3], [1.0, 0.0, 0.0]);
        assert_eq!(inlier_ratio(&source, &target, &t_target_source, 0.5).unwrap(), 0.5);
        assert_eq!(inlier_ratio(&source, &target, &RigidTransform::identity(), 0.5).unwrap(), 0.0);
        assert_eq!(inlier_ratio::<f32>(&[], &[], &RigidTransform::identity(), 0.5).unwrap(), 0.0);
        assert!(inlier_ratio(&source, &target[..3], &RigidTransform::identity(), 0.5).is_err());
    }

    #[test]
    fn the_overlap_is_strictly_within_the_distance() {
        let source = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]];
        let target = [[1.0, 0.25, 0.0], [9.0, 0.0, 0.0], [2.0, 0.0, 0.5]];
        let t_target_source = transform([0.0; 3], [1.0, 0.0, 0.0]);
        assert_eq!(overlap(&source, &target, &t_target_source, 0.5).unwrap(), source[..1]);
        assert_eq!(overlap(&source, &target, &t_target_source, 0.6).unwrap(), source[..2]);
        assert!(overlap(&source, &[], &t_target_source, 0.5).is_err());
    }

    #[test]
    fn a_pair_matches_above_the_threshold_only() {
        assert_eq!(feature_matching_recall(&[0.05, 0.051, 0.0, 1.0], 0.05).unwrap(), 0.5);
        assert!(feature_matching_recall(&[], 0.05).is_err());
    }

    #[test]
    fn the_error_of_a_pure_translation_is_its_squared_length() {
        let gt = transform([0.3, -0.2, 0.9], [1.0, 2.0, 3.0]);
        let estimate = transform([0.3, -0.2, 0.9], [1.3, 2.0, 2.6]);
        let information = information_matrix(&[[0.4, 0.1, 0.9], [1.0, -2.0, 0.3]]).unwrap();
        assert_eq!(information[0][0], 2.0);
        assert!((squared_registration_error(&gt, &estimate, &information).unwrap() - 0.25).abs() < 1e-12);
    }

    #[test]
    fn a_quarter_turn_by_hand() {
        // e = (0, 0, 0, 0, 0, sin 45°); I₆₆ = 10, I₁₁ = 5: p = 0.5 · 10 / 5.
        let mut information = [[0.0; 6]; 6];
        (information[0][0], information[5][5]) = (5.0, 10.0);
        let turn = transform([0.0, 0.0, std::f64::consts::FRAC_PI_2], [0.0; 3]);
        assert!(
            (squared_registration_error(&RigidTransform::identity(), &turn, &information).unwrap() - 1.0).abs() < 1e-12
        );
    }

    #[test]
    fn small_errors_are_the_mean_squared_displacement_of_the_overlap() {
        // Fails if the quaternion's sign or the order of the transforms is wrong.
        let points: Vec<Point> =
            (0..50).map(|i| [1.0 + (i % 7) as f32 * 0.3, (i % 5) as f32 * 0.2 - 2.0, (i % 11) as f32 * 0.1]).collect();
        let gt = transform([0.3, -0.2, 0.9], [1.0, 2.0, 3.0]);
        let error = transform([0.004, -0.002, 0.003], [0.01, 0.0, -0.02]);
        let estimate = gt * error;
        let displacement = |&p: &Point| {
            let p = vector(p);
            (estimate.apply_vector(&p) - gt.apply_vector(&p)).norm_squared()
        };
        let expected = points.iter().map(displacement).sum::<f64>() / points.len() as f64;
        let information = information_matrix(&points).unwrap();
        let error = squared_registration_error(&gt, &estimate, &information).unwrap();
        assert!((error / expected - 1.0).abs() < 0.01, "{error} {expected}");
    }

    #[test]
    fn recall_leaves_out_consecutive_fragments_and_counts_failures() {
        let pair = |first, second, squared_error| RegistrationOutcome { first, second, squared_error };
        let scene = [
            pair(0, 1, Some(0.0)),
            pair(3, 2, Some(0.0)),
            pair(0, 2, Some(0.04)),
            pair(5, 1, Some(0.041)),
            pair(0, 9, None),
            pair(2, 4, Some(0.001)),
        ];
        assert_eq!(registration_recall(&scene, 0.2).unwrap(), 0.5);
        assert!(registration_recall(&scene[..2], 0.2).is_err());
    }

    #[test]
    fn pairs_without_information_are_refused() {
        let identity = RigidTransform::identity();
        assert!(squared_registration_error(&identity, &identity, &[[0.0; 6]; 6]).is_err());
        assert!(information_matrix::<f32>(&[]).is_err());
    }
}

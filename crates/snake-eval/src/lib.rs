//! How good keypoints are: repeatability, semantic consistency and registration, by the rules of the papers that the
//! figures are compared with. Points and indices in, numbers out; no model is seen here.
//!
//! Lengths are in the points' own units and distances are computed in f64. A transform is a row-major 4×4 matrix that
//! acts on columns: `t_target_source` takes a point of the source to the target, `p_target = R p_source + t`.

#![forbid(unsafe_code)]

mod registration;
mod repeatability;
mod semantic;

use nalgebra::{Matrix4, Point3};

use snake_core::space::check_points;
use snake_core::space::{Vector, vector};
use snake_core::{Error, Result};
use snake_core::{Point, Transform};

pub use registration::{
    RegistrationOutcome, feature_matching_recall, information_matrix, inlier_ratio, overlap, registration_recall,
    squared_registration_error,
};
pub use repeatability::{
    mean_distance_to_keypoints, relative_repeatability, repeated_keypoints, symmetric_repeatability,
};
pub use semantic::{
    MatchCounts, SmplProtocol, Unreachable, geodesic_distances, semantic_counts, smpl_iou, smpl_pair_counts,
};

/// The transform as a matrix.
fn matrix(what: &'static str, transform: &Transform) -> Result<Matrix4<f64>> {
    if !transform.as_flattened().iter().all(|v| v.is_finite()) || transform[3] != [0.0, 0.0, 0.0, 1.0] {
        let reason = "expected a finite 4x4 transform whose last row is 0 0 0 1".into();
        return Err(Error::Input { what, reason });
    }
    Ok(Matrix4::from_fn(|row, column| transform[row][column]))
}

/// The points, moved; none is fine.
fn moved(what: &'static str, points: &[Point], transform: &Matrix4<f64>) -> Result<Vec<Vector>> {
    if !points.is_empty() {
        check_points(what, points)?;
    }
    Ok(points.iter().map(|&p| transform.transform_point(&Point3::from(vector(p))).coords).collect())
}

/// Refuses thresholds that are negative or not numbers.
fn check_thresholds(name: &'static str, thresholds: &[f64]) -> Result<()> {
    match thresholds.iter().find(|t| t.is_nan() || **t < 0.0) {
        Some(bad) => Err(Error::Option { name, value: bad.to_string(), allowed: "0 or more (units of the points)" }),
        None => Ok(()),
    }
}

#[cfg(test)]
pub(crate) const IDENTITY: Transform =
    [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];

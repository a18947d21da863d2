//! Evaluation of keypoints and of registrations, by the rules of the papers behind the published figures. No model is
//! run here.
//!
//! - The metrics take points, indices and transforms, and return numbers: repeatability, semantic consistency and
//!   3DMatch recall.
//! - `datasets` finds the clouds and the ground truth of a data set in its layout on disk. `smpl` reads and poses body
//!   models. `views` draws the disturbed views of repeatability. They need the feature `datasets`, which is on by
//!   default.
//! - [`tables`] turns figures into tables and curves, with the figures of the SNAKE paper beside them. `reports` (feature
//!   `datasets`) summarises the figures of many pairs.
//!
//! ```text
//! keypoints of two views + t_1_2 ─────────→ relative_repeatability
//! keypoints of a shape + annotations ─────→ semantic_counts → MatchCounts::iou
//! keypoints of a body in two poses ───────→ smpl_pair_counts → smpl_iou
//! correspondences + t_target_source ──────→ inlier_ratio → feature_matching_recall
//! correspondences ────────────────────────→ ransac → estimated transforms
//! estimated and true transforms ──────────→ squared_registration_error → registration_recall
//! ```
//!
//! ```
//! use snake_geometry::RigidTransform;
//! use snake_eval::{feature_matching_recall, inlier_ratio};
//! let rows = [[1.0, 0.0, 0.0, 5.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];
//! let t_target_source = RigidTransform::from_matrix(rows)?;
//! let (source, target) = ([[0.0; 3], [1.0, 0.0, 0.0]], [[5.0, 0.0, 0.0], [9.0, 0.0, 0.0]]);
//! let ratio = inlier_ratio(&source, &target, &t_target_source, 0.1)?;
//! assert_eq!(ratio, 0.5);
//! assert_eq!(feature_matching_recall(&[ratio, 0.0], 0.05)?, 0.5);
//! # Ok::<(), snake_core::Error>(())
//! ```
//!
//! Lengths are in the units of the points, and distances are computed in f64. Most metrics also take points in f64. `t_target_source` maps a source point
//! to the target frame: `p_target = R p_source + t`.

#![forbid(unsafe_code)]

mod coverage;
#[cfg(feature = "datasets")]
pub mod datasets;
#[cfg(feature = "datasets")]
mod error;
#[cfg(feature = "datasets")]
mod external;
mod meeting;
mod protocols;
mod registration;
mod repeatability;
#[cfg(feature = "datasets")]
pub mod reports;
mod semantic;
#[cfg(feature = "datasets")]
pub mod smpl;
pub mod tables;
#[cfg(feature = "datasets")]
pub mod views;

use snake_geometry::{RigidTransform, Vector, check_points, vector};

pub use coverage::{RankedKeypoints, radius_of_coverage};
#[cfg(feature = "datasets")]
pub use error::Error;
#[cfg(feature = "datasets")]
pub use external::ExternalKeypoints;
pub use meeting::{Meeting, meeting_note};
pub use protocols::{Consensus, RansacOptions, ransac};
pub use registration::{
    RegistrationOutcome, feature_matching_recall, information_matrix, inlier_ratio, overlap, registration_recall,
    squared_registration_error,
};
pub use repeatability::{
    mean_distance_to_keypoints, relative_repeatability, repeatability_beyond_chance, repeated_keypoints,
    share_on_flat_places, symmetric_repeatability,
};
pub use semantic::{
    MatchCounts, SmplProtocol, Unreachable, geodesic_distances, geodesic_distances_with, semantic_counts, smpl_iou,
    smpl_pair_counts,
};

/// `f32`, or `f64`, which also holds the coordinates of georeferenced points.
pub trait Coordinate: Copy + Into<f64> + Sync {}
impl Coordinate for f32 {}
impl Coordinate for f64 {}

/// Points under a transform; an empty array is accepted.
fn moved<T: Coordinate>(
    what: &'static str,
    points: &[[T; 3]],
    transform: &RigidTransform,
) -> snake_core::Result<Vec<Vector>> {
    if !points.is_empty() {
        check_points(what, points)?;
    }
    Ok(points.iter().map(|&p| transform.apply_vector(&vector(p))).collect())
}

/// Refuses thresholds that are negative or not numbers.
fn check_thresholds(name: &'static str, thresholds: &[f64]) -> snake_core::Result<()> {
    match thresholds.iter().find(|t| t.is_nan() || **t < 0.0) {
        Some(bad) => {
            Err(snake_core::Error::Option { name, value: bad.to_string(), allowed: "0 or more (units of the points)" })
        }
        None => Ok(()),
    }
}

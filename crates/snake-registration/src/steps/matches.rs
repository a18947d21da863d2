//! Matches: pairs of points that may correspond, and the test whether a transform agrees with them.

use nalgebra::{IsometryMatrix3, Rotation3};

use crate::cloud::surface;
use crate::rigid::moved;
use snake_geometry::{RigidTransform, Vector};

/// Largest angle between the up axes of both clouds, because no sensor is exactly level. Unit:
/// degrees. Set by hand: KITTI sweeps of one drive differ by up to 1.5.
pub(crate) const MAX_TILT: f64 = 5.0;

/// A match: a keypoint and unit normal of the source, with those of its partner in the target.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Match {
    /// The point in the source.
    pub source: Vector,
    /// The point in the target.
    pub target: Vector,
    /// The normal at the point in the source.
    pub source_normal: Vector,
    /// The normal at the point in the target.
    pub target_normal: Vector,
}

/// The criteria by which a match agrees with a transform, and two matches with each other.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Criteria {
    /// The transform brings the points closer than this, in cloud units.
    pub inlier_distance: f64,
    /// Whether the signs of normals are known; without, opposite normals agree.
    pub signed: bool,
    /// The axis of the rotation, a unit vector, if it is known. A sensor is not quite level: the
    /// rotation may tilt the axis by up to 5 degrees.
    pub gravity: Option<Vector>,
}

impl Criteria {
    /// Whether a rotation keeps the known up axis within the tolerance.
    pub(crate) fn is_level(&self, rotation: &Rotation3<f64>) -> bool {
        let is_near = |axis: Vector| (rotation * axis).dot(&axis) >= MAX_TILT.to_radians().cos();
        self.gravity.is_none_or(is_near)
    }
}

impl Match {
    /// Whether a transform brings the points together and aligns their normals.
    pub fn agrees(&self, t_target_source: &RigidTransform, criteria: &Criteria) -> bool {
        self.squared_residual(t_target_source.isometry(), criteria).is_some()
    }

    /// The squared distance under a transform if the match agrees with it.
    pub(crate) fn squared_residual(&self, transform: &IsometryMatrix3<f64>, criteria: &Criteria) -> Option<f64> {
        let squared = (moved(transform, &self.source) - self.target).norm_squared();
        if squared >= criteria.inlier_distance.powi(2) {
            return None;
        }
        let cosine = (transform.rotation * self.source_normal).dot(&self.target_normal);
        ((if criteria.signed { cosine } else { cosine.abs() }) > surface::AGREEING_COSINE).then_some(squared)
    }
}

/// Number and root mean square distance of the matches that agree with a transform.
pub(crate) fn inliers(matches: &[Match], transform: &IsometryMatrix3<f64>, criteria: &Criteria) -> (usize, f64) {
    let squared = matches.iter().filter_map(|matched| matched.squared_residual(transform, criteria));
    let (count, sum) = squared.fold((0, 0.0), |(count, sum), squared| (count + 1, sum + squared));
    (count, (sum / count.max(1) as f64).sqrt())
}

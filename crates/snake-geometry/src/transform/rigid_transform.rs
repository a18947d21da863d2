//! Rigid transforms: a rotation and a translation, checked once.

use std::fmt;
use std::ops::Mul;

use nalgebra::{IsometryMatrix3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

use crate::{Error, Point, Result};

/// A rotation and a translation, in f64. `t_target_source` maps a source point to the target frame:
/// `p_target = R p_source + t`.
///
/// Its matrix has 4×4 entries, row by row, and multiplies column vectors. Serde writes and reads that matrix.
///
/// ```
/// use snake_geometry::RigidTransform;
/// let t_target_source = RigidTransform::from_matrix([
///     [0.0, -1.0, 0.0, 3.0],
///     [1.0, 0.0, 0.0, 0.0],
///     [0.0, 0.0, 1.0, 0.0],
///     [0.0, 0.0, 0.0, 1.0],
/// ])?;
/// assert_eq!(t_target_source.apply([2.0, 1.0, 0.0]), [2.0, 2.0, 0.0]);
/// let t_source_target = t_target_source.inverse();
/// assert_eq!(t_source_target * t_target_source, RigidTransform::identity());
/// # Ok::<(), snake_geometry::Error>(())
/// ```
#[derive(Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "[[f64; 4]; 4]", into = "[[f64; 4]; 4]")]
pub struct RigidTransform(IsometryMatrix3<f64>);

impl RigidTransform {
    /// The largest absolute entry of `RᵀR - I`. Files round rotations to a few digits.
    pub const TOLERANCE: f64 = 1e-3;

    /// The identity.
    pub fn identity() -> Self {
        Self(IsometryMatrix3::identity())
    }

    /// The transform with this 4×4 matrix, given row by row. Its entries are kept as they are.
    ///
    /// # Errors
    /// [`Error::Input`] when an entry is not finite, the last row is not 0 0 0 1, or the upper left 3×3 block is not a
    /// rotation within [`RigidTransform::TOLERANCE`]; a reflection is not a rotation.
    pub fn from_matrix(rows: [[f64; 4]; 4]) -> Result<Self> {
        let rotation = Matrix3::from_fn(|row, column| rows[row][column]);
        let is_finite = rows.as_flattened().iter().all(|v| v.is_finite());
        let is_orthonormal = (rotation.transpose() * rotation - Matrix3::identity()).amax() <= Self::TOLERANCE;
        if !(is_finite && is_orthonormal && rotation.determinant() > 0.0 && rows[3] == [0.0, 0.0, 0.0, 1.0]) {
            let reason = "expected a finite 4x4 matrix of a rotation and a translation, with last row 0 0 0 1".into();
            return Err(Error::Input { what: "rigid transform", reason });
        }
        let translation = Translation3::new(rows[0][3], rows[1][3], rows[2][3]);
        Ok(Self(IsometryMatrix3::from_parts(translation, Rotation3::from_matrix_unchecked(rotation))))
    }

    /// The transform with the nearest exact rotation; a file may have rounded it. The translation stays.
    #[must_use]
    pub fn with_exact_rotation(&self) -> Self {
        let decomposed = self.0.rotation.matrix().svd(true, true);
        let (Some(u), Some(v_transposed)) = (decomposed.u, decomposed.v_t) else { return *self };
        Self(IsometryMatrix3::from_parts(self.0.translation, Rotation3::from_matrix_unchecked(u * v_transposed)))
    }

    /// The largest absolute entry of `RᵀR - I`, at most [`RigidTransform::TOLERANCE`].
    pub fn rotation_error(&self) -> f64 {
        let rotation = self.0.rotation.matrix();
        (rotation.transpose() * rotation - Matrix3::identity()).amax()
    }

    /// The 4×4 matrix, row by row.
    pub fn to_matrix(&self) -> [[f64; 4]; 4] {
        let matrix = self.0.to_homogeneous();
        std::array::from_fn(|row| std::array::from_fn(|column| matrix[(row, column)]))
    }

    /// The rotation and the translation as nalgebra's type.
    pub fn isometry(&self) -> &IsometryMatrix3<f64> {
        &self.0
    }

    /// The inverse transform.
    #[must_use]
    pub fn inverse(&self) -> Self {
        Self(self.0.inverse())
    }

    /// Transforms a point, computed in f64.
    pub fn apply(&self, point: Point) -> Point {
        self.apply_vector(&Vector3::from(point.map(f64::from))).map(|v| v as f32).into()
    }

    /// Transforms a vector as a position, by rotation and translation.
    pub fn apply_vector(&self, vector: &Vector3<f64>) -> Vector3<f64> {
        self.0.transform_point(&Point3::from(*vector)).coords
    }

    /// The angle between the two rotations, in radians, and the distance between the two translations.
    pub fn angle_and_distance_to(&self, other: &Self) -> (f64, f64) {
        let distance = (self.0.translation.vector - other.0.translation.vector).norm();
        // For tiny rotations, nalgebra's own angle is half of the time the arc cosine of a number above 1.
        let difference = self.0.rotation.rotation_to(&other.0.rotation);
        (UnitQuaternion::from_rotation_matrix(&difference).angle(), distance)
    }

    /// Converts `t_target_source` between points relative to their origins (see [`Cloud`](crate::Cloud)) to a transform
    /// between points with their origins added.
    #[must_use]
    pub fn add_origins(mut self, source: [f64; 3], target: [f64; 3]) -> Self {
        let rotation = self.0.rotation;
        for (row, target) in target.into_iter().enumerate() {
            self.0.translation.vector[row] +=
                target - (0..3).map(|axis| rotation[(row, axis)] * source[axis]).sum::<f64>();
        }
        self
    }

    /// Converts `t_target_source` between points with their origins added to a transform between points relative to
    /// their origins.
    #[must_use]
    pub fn subtract_origins(self, source: [f64; 3], target: [f64; 3]) -> Self {
        self.add_origins(source.map(|v| -v), target.map(|v| -v))
    }
}

impl Default for RigidTransform {
    fn default() -> Self {
        Self::identity()
    }
}

/// Composition: `t_a_b * t_b_c` is `t_a_c`.
impl Mul for RigidTransform {
    type Output = Self;

    fn mul(self, other: Self) -> Self {
        Self(self.0 * other.0)
    }
}

impl From<IsometryMatrix3<f64>> for RigidTransform {
    fn from(isometry: IsometryMatrix3<f64>) -> Self {
        Self(isometry)
    }
}

impl TryFrom<[[f64; 4]; 4]> for RigidTransform {
    type Error = Error;

    fn try_from(rows: [[f64; 4]; 4]) -> Result<Self> {
        Self::from_matrix(rows)
    }
}

impl From<RigidTransform> for [[f64; 4]; 4] {
    fn from(transform: RigidTransform) -> Self {
        transform.to_matrix()
    }
}

impl fmt::Debug for RigidTransform {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("RigidTransform").field(&self.to_matrix()).finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ROWS: [[f64; 4]; 4] =
        [[0.0, -1.0, 0.0, 3.5], [1.0, 0.0, 0.0, -1e6], [0.0, 0.0, 1.0, 0.25], [0.0, 0.0, 0.0, 1.0]];

    fn general() -> RigidTransform {
        IsometryMatrix3::new(Vector3::new(1.0, -2.0, 0.5), Vector3::new(0.3, 1.1, -0.4)).into()
    }

    #[test]
    fn entries_keep_their_bits() {
        let rounded = [[0.9998, -0.02, 0.0, 0.1], [0.02, 0.9998, 0.0, 0.2], [0.0, 0.0, 1.0, 0.3], [0.0, 0.0, 0.0, 1.0]];
        for rows in [ROWS, rounded, general().to_matrix()] {
            let transform = RigidTransform::from_matrix(rows).unwrap();
            assert_eq!(transform.to_matrix(), rows);
            let text = serde_json::to_string(&transform).unwrap();
            assert_eq!(text, serde_json::to_string(&rows).unwrap());
            assert_eq!(serde_json::from_str::<RigidTransform>(&text).unwrap(), transform);
        }
    }

    #[test]
    fn rounded_rotation_is_made_exact() {
        let rounded = general().to_matrix().map(|row| row.map(|v| (v * 1e4).round() / 1e4));
        let transform = RigidTransform::from_matrix(rounded).unwrap();
        assert!(transform.rotation_error() > 1e-6);
        let exact = transform.with_exact_rotation();
        assert!(exact.rotation_error() < 1e-14);
        let (angle, distance) = exact.angle_and_distance_to(&general());
        assert!(angle < 1e-3 && distance < 1e-9, "{angle} {distance}");
    }

    #[test]
    fn matrices_that_are_not_rigid_are_refused() {
        let with = |row: usize, column: usize, value: f64| {
            let mut rows = ROWS;
            rows[row][column] = value;
            rows
        };
        for bad in [
            with(2, 2, 1.001),
            with(2, 2, -1.0),
            with(0, 1, 1.0),
            with(0, 2, 0.01),
            with(0, 3, f64::NAN),
            with(1, 3, f64::INFINITY),
            with(3, 3, 2.0),
            with(3, 0, 1e-9),
            [[0.0; 4]; 4],
            [[f64::NAN; 4]; 4],
            [[1e300; 4]; 4],
        ] {
            let error = RigidTransform::from_matrix(bad).unwrap_err().to_string();
            assert!(error.starts_with("rigid transform: expected"), "{error}");
        }
        assert!(serde_json::from_str::<RigidTransform>("[[1,2],[3,4]]").is_err());
        assert!(serde_json::from_value::<RigidTransform>(serde_json::json!(vec![[0.0; 4]; 4])).is_err());
    }

    #[test]
    fn composition_applies_the_right_transform_first() {
        let (a, b, p) = (general(), RigidTransform::from_matrix(ROWS).unwrap(), [0.5, -1.5, 2.0]);
        assert_eq!(b.apply(p), [5.0, -999_999.5, 2.25]);
        let difference = |p: Point, q: Point| (0..3).map(|i| (p[i] - q[i]).abs()).fold(0.0, f32::max);
        assert!(difference((b * a).apply(p), b.apply(a.apply(p))) < 0.1);
        assert!(difference(a.inverse().apply(a.apply(p)), p) < 1e-6);
        let (angle, distance) = (a.inverse() * a).angle_and_distance_to(&RigidTransform::identity());
        assert!(angle < 1e-7 && distance < 1e-12);
    }

    #[test]
    fn angles_and_distances_by_hand() {
        let (angle, distance) = RigidTransform::from_matrix(ROWS).unwrap().angle_and_distance_to(&Default::default());
        assert!((angle - std::f64::consts::FRAC_PI_2).abs() < 1e-12);
        assert_eq!(distance, (3.5_f64.powi(2) + 1e12 + 0.0625).sqrt());
    }

    #[test]
    fn the_angle_between_equal_rotations_is_a_number() {
        for i in 0..200 {
            let rotation = |by: f64| Rotation3::from_euler_angles(0.1 + by, 0.7 * f64::from(i), -0.3 * f64::from(i));
            let transform = |by| RigidTransform(IsometryMatrix3::from_parts(Translation3::identity(), rotation(by)));
            let (angle, _) = transform(0.0).angle_and_distance_to(&transform(1e-12));
            assert!(angle < 1e-7, "{i}: {angle}");
        }
    }

    #[test]
    fn origins_are_added_to_both_clouds() {
        let (near, p) = (general(), [1.0_f32, 2.0, -3.0]);
        let (source, target) = ([10.0, -20.0, 30.0], [5.0, 6.0, -7.0]);
        let far = near.add_origins(source, target);
        let moved = near.apply(p);
        let moved_far = far.apply(std::array::from_fn(|axis| p[axis] + source[axis] as f32));
        for axis in 0..3 {
            assert!((moved[axis] + target[axis] as f32 - moved_far[axis]).abs() < 1e-4);
        }
        let (angle, distance) = far.subtract_origins(source, target).angle_and_distance_to(&near);
        assert!(angle < 1e-7 && distance < 1e-12);
    }
}

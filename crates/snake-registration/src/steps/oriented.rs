//! Points with normals, and the motions that lay one on another.

use std::f64::consts::TAU;

use nalgebra::{IsometryMatrix3, Matrix3, Rotation3, Translation3};

use snake_geometry::Vector;

/// A point with its unit normal.
#[derive(Debug, Clone, Copy)]
pub(super) struct Oriented {
    pub(super) point: Vector,
    pub(super) normal: Vector,
}

impl Oriented {
    /// Two unit vectors across the normal, the axes of its azimuth. The first is the same for the
    /// opposite normal.
    pub(super) fn across(&self) -> [Vector; 2] {
        let axis = Vector::ith(self.normal.iamin(), 1.0);
        let y = (axis - self.normal * self.normal.dot(&axis)).normalize();
        [y, self.normal.cross(&y)]
    }

    /// The motion that lays this point on another, with the normals alike, after a rotation about
    /// the normal by so many turns.
    pub(super) fn laid_on(&self, other: &Self, turns: f64) -> IsometryMatrix3<f64> {
        let frame = |oriented: &Self| {
            let [y, z] = oriented.across();
            Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[oriented.normal, y, z]))
        };
        let about = Rotation3::from_scaled_axis(turns * TAU * Vector::x());
        let rotation = frame(other) * about * frame(self).inverse();
        IsometryMatrix3::from_parts(Translation3::from(other.point - rotation * self.point), rotation)
    }
}

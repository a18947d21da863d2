//! How precisely a position is known.

use nalgebra::{Matrix3, SymmetricEigen};
use serde::{Deserialize, Serialize};

/// The covariance of a position in squared cloud units: a symmetric matrix, infinite along directions that are open.
///
/// An open direction `u` makes the entries `(i, j)` infinite where `u_i u_j` is not about 0. Serde writes the rows, with `null` for
/// infinite entries.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(from = "[[Option<f32>; 3]; 3]", into = "[[Option<f32>; 3]; 3]")]
pub struct Covariance {
    rows: [[f32; 3]; 3],
    deviation: f32,
}

impl Covariance {
    /// Every direction is open.
    pub const UNKNOWN: Self = Self {
        rows: [[f32::INFINITY, 0.0, 0.0], [0.0, f32::INFINITY, 0.0], [0.0, 0.0, f32::INFINITY]],
        deviation: f32::INFINITY,
    };

    /// The inverse of an information matrix in inverse squared cloud units. Directions with less than the share `open` of the
    /// total information are open.
    pub fn from_information(information: &Matrix3<f64>, open: f64) -> Self {
        let SymmetricEigen { eigenvalues, eigenvectors } = information.symmetric_eigen();
        let total = eigenvalues.sum();
        let is_open = |axis: &usize| eigenvalues[*axis].is_nan() || eigenvalues[*axis] <= open * total;
        if total.is_nan() || total <= 0.0 {
            return Self::UNKNOWN;
        }
        let (mut known, mut free) = (Matrix3::zeros(), Matrix3::zeros());
        for axis in 0..3 {
            let outer = eigenvectors.column(axis) * eigenvectors.column(axis).transpose();
            if is_open(&axis) { free += outer } else { known += outer / eigenvalues[axis] }
        }
        let entry = |row: usize, column: usize| {
            if free[(row, column)].abs() > MIN_SHARE { f32::INFINITY } else { known[(row, column)] as f32 }
        };
        [0, 1, 2].map(|row| [0, 1, 2].map(|column| entry(row, column))).into()
    }

    /// The rows of the matrix.
    pub fn rows(&self) -> [[f32; 3]; 3] {
        self.rows
    }

    /// The largest standard deviation of all directions, in cloud units.
    pub fn deviation(&self) -> f32 {
        self.deviation
    }
}

/// An open direction has a part along two axes if the product of its components is larger than this.
const MIN_SHARE: f64 = 0.03;

impl From<[[f32; 3]; 3]> for Covariance {
    fn from(rows: [[f32; 3]; 3]) -> Self {
        let matrix = Matrix3::from_fn(|row, column| f64::from(rows[row][column]));
        let is_finite = matrix.iter().all(|entry| entry.is_finite());
        let variance = if is_finite { matrix.symmetric_eigenvalues().max().max(0.0) } else { f64::INFINITY };
        Self { rows, deviation: variance.sqrt() as f32 }
    }
}

impl From<[[Option<f32>; 3]; 3]> for Covariance {
    fn from(rows: [[Option<f32>; 3]; 3]) -> Self {
        rows.map(|row| row.map(|entry| entry.unwrap_or(f32::INFINITY))).into()
    }
}

impl From<Covariance> for [[Option<f32>; 3]; 3] {
    fn from(covariance: Covariance) -> Self {
        covariance.rows.map(|row| row.map(|entry| entry.is_finite().then_some(entry)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Rotation3, Vector3};

    #[test]
    fn directions_with_little_information_are_infinite() {
        let turn = Rotation3::from_euler_angles(0.4, -0.9, 2.0).into_inner();
        let information = |values: [f64; 3]| turn * Matrix3::from_diagonal(&Vector3::from(values)) * turn.transpose();
        let corner = Covariance::from_information(&information([4.0, 25.0, 100.0]), 0.02);
        assert!((corner.deviation() - 0.5).abs() < 1e-6);
        let product = Matrix3::from_fn(|i, j| f64::from(corner.rows()[i][j])) * information([4.0, 25.0, 100.0]);
        assert!((product - Matrix3::identity()).norm() < 1e-5);
        let edge = Covariance::from_information(&Matrix3::from_diagonal(&Vector3::new(1e-4, 4.0, 4.0)), 0.02);
        assert_eq!(edge.rows(), [[f32::INFINITY, 0.0, 0.0], [0.0, 0.25, 0.0], [0.0, 0.0, 0.25]]);
        assert_eq!(edge.deviation(), f32::INFINITY);
        for broken in [Matrix3::zeros(), Matrix3::from_element(f64::NAN)] {
            assert_eq!(Covariance::from_information(&broken, 0.02), Covariance::UNKNOWN);
        }
    }

    #[test]
    fn covariances_are_read_as_they_are_written() {
        for values in [[4.0, 25.0, 100.0], [0.0, 4.0, 4.0], [0.0, 0.0, 9.0], [0.0; 3]] {
            let covariance = Covariance::from_information(&Matrix3::from_diagonal(&Vector3::from(values)), 0.02);
            let text = serde_json::to_string(&covariance).unwrap();
            assert_eq!(serde_json::from_str::<Covariance>(&text).unwrap(), covariance, "{text}");
        }
    }
}

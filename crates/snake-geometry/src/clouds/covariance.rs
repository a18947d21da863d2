//! How precisely a position is known.

use nalgebra::Matrix3;
use serde::{Deserialize, Serialize};

/// The covariance of a position in squared cloud units: a symmetric matrix, with infinite entries for open directions.
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
    /// The covariance of which every direction is open.
    pub const UNKNOWN: Self = Self {
        rows: [[f32::INFINITY, 0.0, 0.0], [0.0, f32::INFINITY, 0.0], [0.0, 0.0, f32::INFINITY]],
        deviation: f32::INFINITY,
    };

    /// The covariance with these variances along three orthonormal directions, the columns of a matrix; infinite ones are open.
    pub fn along(directions: &Matrix3<f64>, variances: [f64; 3]) -> Self {
        let (mut known, mut free) = (Matrix3::zeros(), Matrix3::zeros());
        for (direction, variance) in directions.column_iter().zip(variances) {
            let outer = direction * direction.transpose();
            if variance.is_finite() { known += outer * variance } else { free += outer }
        }
        let entry = |row: usize, column: usize| {
            // So no axis beside an infinite entry has a finite variance.
            let least = if row == column { MIN_SHARE.powi(2) } else { MIN_SHARE };
            if free[(row, column)].abs() > least { f32::INFINITY } else { known[(row, column)] as f32 }
        };
        [0, 1, 2].map(|row| [0, 1, 2].map(|column| entry(row, column))).into()
    }

    /// The rows of the matrix.
    pub fn rows(&self) -> [[f32; 3]; 3] {
        self.rows
    }

    /// The largest standard deviation over all directions, in cloud units.
    pub fn deviation(&self) -> f32 {
        self.deviation
    }
}

/// Open directions make the entry of two axes infinite if the product of their components along them is larger than this.
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
    use nalgebra::Rotation3;

    #[test]
    fn open_directions_are_infinite() {
        let turn = Rotation3::from_euler_angles(0.4, -0.9, 2.0).into_inner();
        let corner = Covariance::along(&turn, [0.25, 0.04, 0.01]);
        assert!((corner.deviation() - 0.5).abs() < 1e-6);
        let expected = turn * Matrix3::from_diagonal(&[0.25, 0.04, 0.01].into()) * turn.transpose();
        assert!((Matrix3::from_fn(|i, j| f64::from(corner.rows()[i][j])) - expected).norm() < 1e-6);
        let edge = Covariance::along(&Matrix3::identity(), [f64::INFINITY, 0.25, 0.25]);
        assert_eq!(edge.rows(), [[f32::INFINITY, 0.0, 0.0], [0.0, 0.25, 0.0], [0.0, 0.0, 0.25]]);
        assert_eq!(edge.deviation(), f32::INFINITY);
        assert_eq!(Covariance::along(&Matrix3::identity(), [f64::INFINITY; 3]), Covariance::UNKNOWN);
        let near_x = Rotation3::from_euler_angles(0.0, 0.1, 0.0).into_inner();
        let [[xx, _, xz], _, [.., zz]] = Covariance::along(&near_x, [f64::INFINITY, 1.0, 1.0]).rows();
        assert_eq!([xx, xz, zz], [f32::INFINITY; 3], "an infinite entry has no finite variance beside it");
    }

    #[test]
    fn covariances_are_read_as_they_are_written() {
        for variances in [[4.0, 0.1, 0.01], [f64::INFINITY, 4.0, 4.0], [f64::INFINITY; 3]] {
            let covariance = Covariance::along(&Matrix3::identity(), variances);
            let text = serde_json::to_string(&covariance).unwrap();
            assert_eq!(serde_json::from_str::<Covariance>(&text).unwrap(), covariance, "{text}");
        }
    }
}

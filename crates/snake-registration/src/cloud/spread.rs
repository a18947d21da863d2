//! How far points are spread.

use nalgebra::Matrix3;
use snake_geometry::Vector;

/// The standard deviation of points in the direction in which they vary least; 0 for less than two.
pub(crate) fn least_spread(points: &[Vector]) -> f64 {
    let count = points.len().max(1) as f64;
    let mean = points.iter().sum::<Vector>() / count;
    let scatter: Matrix3<f64> = points.iter().map(|point| (point - mean) * (point - mean).transpose()).sum();
    (scatter / count).symmetric_eigenvalues().min().max(0.0).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_on_a_plane_have_no_spread_across_it() {
        let plane: Vec<Vector> = (0..60).map(|i| Vector::new(f64::from(i % 9), f64::from(i / 9), 2.0)).collect();
        assert!(least_spread(&plane) < 1e-9 && least_spread(&plane[..1]) == 0.0 && least_spread(&[]) == 0.0);
        let two: Vec<Vector> = plane.iter().flat_map(|p| [*p, p + Vector::z()]).collect();
        assert!((least_spread(&two) - 0.5).abs() < 1e-9);
    }
}

//! Neighbours of points in f64, and local statistics, for metrics, classical detectors and registration.

use std::num::NonZeroUsize;

use nalgebra::{Matrix3, SymmetricEigen, Vector3};
use rayon::prelude::*;

use crate::{Error, KdTree, Result, in_parallel};

/// Maximum number of neighbour pairs; more would take minutes or hours.
const MAX_PAIRS: f64 = 1e10;

/// A point or an offset in f64.
pub type Vector = Vector3<f64>;

/// Converts a point of `f32` or `f64` to f64.
pub fn vector<T: Into<f64>>(point: [T; 3]) -> Vector {
    point.map(Into::into).into()
}

/// Points with an index for neighbour queries.
pub struct Neighbors {
    /// The points, in the given order.
    pub points: Vec<Vector>,
    tree: KdTree<f64>,
}

impl Neighbors {
    /// Indexes finite points, at least one.
    pub fn new(points: Vec<Vector>) -> Result<Self> {
        let rows: Vec<[f64; 3]> = points.iter().map(|&p| p.into()).collect();
        Ok(Self { points, tree: KdTree::new(&rows)? })
    }

    /// Refuses a radius with so many neighbours that a search would take too long, such as for a cloud that consists almost
    /// only of one repeated point.
    pub fn check_density(&self, name: &'static str, radius: f64) -> Result<()> {
        // All points of a cell are closer to each other than the radius.
        let cell = |point: &Vector| point.map(|v| ((v * 2.0 / radius).floor() + 0.0).to_bits());
        let mut cells: Vec<[u64; 3]> = self.points.iter().map(|point| cell(point).into()).collect();
        cells.par_sort_unstable();
        let pairs: f64 = cells.chunk_by(|a, b| a == b).map(|cell| (cell.len() as f64).powi(2)).sum();
        if pairs <= MAX_PAIRS {
            return Ok(());
        }
        let (count, average) = (self.points.len(), pairs / self.points.len() as f64);
        let reason = format!(
            "the {count} points have more than {average:.0} neighbours each, on average, within {name} = {radius:.3e}; downsample the cloud or choose a smaller radius"
        );
        Err(Error::Input { what: "points", reason })
    }

    /// Indices, ascending, of the points closer than `radius`. Points at a distance equal to `radius` do not count, as in
    /// Open3D.
    pub fn within(&self, query: &Vector, radius: f64) -> Vec<usize> {
        let squared = radius * radius;
        let mut indices = Vec::new();
        self.tree.within(&(*query).into(), squared, |index, distance| {
            if distance < squared {
                indices.push(index);
            }
        });
        indices.sort_unstable();
        indices
    }

    /// The nearest `number` points as indices and distances, nearest first; ties are ordered by index.
    pub fn nearest(&self, query: &Vector, number: NonZeroUsize) -> Vec<(usize, f64)> {
        let mut nearest = self.tree.nearest(&(*query).into(), number);
        nearest.iter_mut().for_each(|(_, distance)| *distance = distance.sqrt());
        nearest
    }

    /// Distance to the nearest point.
    pub fn distance(&self, query: &Vector) -> f64 {
        self.nearest(query, NonZeroUsize::MIN)[0].1
    }

    /// Mean distance of the distinct points to their nearest other point; 0 for one point.
    pub fn resolution(&self) -> f64 {
        // If no points are equal, they are taken in the given order, which keeps the bits of the sum.
        let are_distinct = self.tree.distinct().len() == self.points.len();
        let gap = |point: &[f64; 3]| self.tree.nearest_other(point).map_or(0.0, f64::sqrt);
        let nearest: Vec<f64> = if are_distinct {
            in_parallel(self.points.iter(), |&point| gap(&point.into()))
        } else {
            in_parallel(self.tree.distinct().iter(), gap)
        };
        nearest.iter().sum::<f64>() / nearest.len() as f64
    }

    /// Covariance of the selected points about their mean.
    pub fn covariance(&self, indices: &[usize]) -> Matrix3<f64> {
        let count = indices.len() as f64;
        let mean = indices.iter().map(|&i| self.points[i]).sum::<Vector>() / count;
        self.scatter(indices, &mean) / count
    }

    /// Sum of `(q - center)(q - center)ᵀ` over the selected points.
    pub fn scatter(&self, indices: &[usize], center: &Vector) -> Matrix3<f64> {
        let squared = |&i: &usize| {
            let offset = self.points[i] - center;
            offset * offset.transpose()
        };
        indices.iter().map(squared).sum()
    }

    /// The unit normal of a neighbourhood: the direction of least variance, with arbitrary sign. `None` for fewer than three
    /// points.
    pub fn normal(&self, indices: &[usize]) -> Option<Vector> {
        (indices.len() >= 3).then(|| eigen(self.covariance(indices)).1)
    }
}

/// The eigenvalues, ascending, and the eigenvector of the smallest one.
pub fn eigen(symmetric: Matrix3<f64>) -> ([f64; 3], Vector) {
    let SymmetricEigen { eigenvalues, eigenvectors } = SymmetricEigen::new(symmetric);
    let mut order = [0, 1, 2];
    order.sort_by(|&a, &b| eigenvalues[a].total_cmp(&eigenvalues[b]));
    (order.map(|i| eigenvalues[i]), eigenvectors.column(order[0]).into())
}

/// The standard deviation of points along the direction of least variance; 0 for fewer than two points.
pub fn least_spread(points: &[Vector]) -> f64 {
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

    fn lattice() -> Vec<Vector> {
        // The points have duplicates and exact ties.
        (0..300).map(|i| Vector::new(f64::from(i % 5), f64::from(i / 5 % 5), f64::from(i % 7))).collect()
    }

    #[test]
    fn a_point_at_the_radius_is_not_within_it_and_distances_are_no_squares() {
        let neighbors = Neighbors::new(lattice()).unwrap();
        let at = |radius: f64| neighbors.within(&neighbors.points[0], radius);
        let expected = |is_near: &dyn Fn(f64) -> bool| -> Vec<usize> {
            (0..300).filter(|&i| is_near((neighbors.points[i] - neighbors.points[0]).norm())).collect()
        };
        assert_eq!((at(2.0), at(2.1)), (expected(&|distance| distance < 2.0), expected(&|distance| distance <= 2.0)));
        assert_eq!(neighbors.distance(&Vector::new(-9.0, 0.0, 0.0)), 9.0);
    }

    #[test]
    fn the_resolution_is_the_mean_distance_to_the_nearest_other_point() {
        let cloud = |x: &[f64]| Neighbors::new(x.iter().map(|&x| Vector::new(x, 0.0, 0.0)).collect()).unwrap();
        assert_eq!(cloud(&[0.0, 1.0, 4.0]).resolution(), (1.0 + 1.0 + 3.0) / 3.0);
        assert_eq!(cloud(&[5.0]).resolution(), 0.0);
    }

    #[test]
    fn a_radius_with_too_many_neighbours_is_refused() {
        let cloud = |repeated| [vec![Vector::new(0.5, -0.5, 1e-3); repeated], lattice()].concat();
        Neighbors::new(cloud(100_001)).unwrap().check_density("radius", 0.5).unwrap_err();
        Neighbors::new(cloud(99_990)).unwrap().check_density("radius", 0.5).unwrap();
        let spread = (0..200_000).map(|i| Vector::new(f64::from(i), 0.0, 0.0)).collect();
        Neighbors::new(spread).unwrap().check_density("radius", 50.0).unwrap();
    }
}

//! Noise: whether it explains that the points of a wall do not lie on a plane.

use nalgebra::{Matrix3, SymmetricEigen};

use snake_geometry::Vector;

/// The points within a radius form a wall if the ratio of their variances across and along is below the first value, and that
/// without noise below the second. Walls with noise of 0.0015 z² have 0.12 to 0.25, and 0.01 without noise; most edges in real
/// rooms have 0.05 to 0.3 without noise.
const MAX_NOISE: f64 = 0.35;
const RELIEF: f64 = 0.03;
/// The two sides of a board are no noise: the kurtosis across it is below this. Noise has 3, two sides 1.
const TWO_SIDES: f64 = 1.9;
/// Side of the squares of a wall within which only noise varies, as a share of the radius, and their number along an axis.
const SQUARE: f64 = 0.5;
const SQUARES: usize = 8;
/// Fewer points, beyond one in each square, do not show the noise.
const MIN_REPEATED: f64 = 12.0;

/// The principal axes of points within a radius and the variance along the first, across their plane, if it is noise and less
/// than [`MAX_NOISE`] of that along the plane.
pub(super) fn noise_of_plane(points: &[Vector], radius: f32) -> Option<([Vector; 3], f64)> {
    let mean = points.iter().sum::<Vector>() / points.len() as f64;
    let products: Matrix3<f64> = points.iter().map(|point| (point - mean) * (point - mean).transpose()).sum();
    let SymmetricEigen { eigenvalues, eigenvectors } = products.symmetric_eigen();
    let mut order = [0, 1, 2];
    order.sort_by(|&a, &b| eigenvalues[a].total_cmp(&eigenvalues[b]));
    let axes = order.map(|axis| eigenvectors.column(axis).into());
    let is_plane = eigenvalues[order[0]] < MAX_NOISE * eigenvalues[order[1]];
    noise_across(points, radius, &axes).filter(|_| is_plane).map(|variance| (axes, variance))
}

/// The variance of points along the first axis, across a plane, if noise explains it: within small squares of the plane they vary
/// across it as much as in all. At edges and corners they vary less within squares, whatever the noise.
pub(super) fn noise_across(points: &[Vector], radius: f32, axes: &[Vector; 3]) -> Option<f64> {
    let (count, side) = (points.len() as f64, SQUARE * f64::from(radius));
    let mean = points.iter().sum::<Vector>() / count;
    let mut squares = [[0.0; 2]; SQUARES * SQUARES];
    let [mut across, mut width, mut fourth] = [0.0; 3];
    for point in points {
        let [height, row, column] = axes.map(|axis| axis.dot(&(point - mean)));
        let at = |offset: f64| (offset / side + 0.5 * SQUARES as f64).clamp(0.0, SQUARES as f64 - 1.0) as usize;
        let [number, sum] = &mut squares[at(row) * SQUARES + at(column)];
        (*number, *sum) = (*number + 1.0, *sum + height);
        (across, width, fourth) = (across + height * height, width + row * row, fourth + height.powi(4));
    }
    let occupied = squares.iter().filter(|[number, _]| *number > 0.0);
    let within = across - occupied.clone().map(|[number, sum]| sum * sum / number).sum::<f64>();
    let repeated = count - occupied.count() as f64;
    let has_two_sides = count * fourth < TWO_SIDES * across * across;
    let is_noise = across / (count - 3.0) - within / repeated < RELIEF * (width + across) / count;
    (repeated >= MIN_REPEATED && is_noise && !has_two_sides).then_some(across / count)
}

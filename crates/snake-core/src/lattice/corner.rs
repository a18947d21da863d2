//! Where the lattice of a scene begins: half a voxel below the lowest corner of its points.
//!
//! The lattice moves with the scene, so a translated scene keeps its voxels, field and keypoints, up to rounding.

use snake_geometry::{Normalization, Point};

/// The lowest coordinate of points along each axis; there must be points.
pub(crate) fn lowest_corner(points: &[Point]) -> Point {
    points.iter().fold([f32::INFINITY; 3], |lowest, point| std::array::from_fn(|axis| lowest[axis].min(point[axis])))
}

/// The map to the lattice of a scene with this lowest corner. The lattice begins half a voxel below it: points on a grid of
/// whole voxels then lie in the middle of their cells, where rounding cannot move them to the next cell.
pub(crate) fn from_corner(lowest: Point, voxel_size: f32) -> Normalization {
    Normalization { center: lowest.map(|v| v - 0.5 * voxel_size), scale: voxel_size }
}

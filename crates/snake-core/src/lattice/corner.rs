//! Where the lattice of a scene begins: half a voxel below the lowest corner of its points.
//!
//! A scene that is moved takes its lattice along. It so keeps its voxels, its field and its keypoints, up to rounding.

use snake_geometry::{Normalization, Point};

/// The lowest coordinate of points along each axis; there must be points.
pub(crate) fn lowest_corner(points: &[Point]) -> Point {
    points.iter().fold([f32::INFINITY; 3], |lowest, point| std::array::from_fn(|axis| lowest[axis].min(point[axis])))
}

/// The map to the lattice of a scene with this lowest corner. Half a voxel, so that points on a grid of whole voxels lie in the
/// middle of their cells, where rounding cannot move them to the next one.
pub(crate) fn from_corner(lowest: Point, voxel_size: f32) -> Normalization {
    Normalization { center: lowest.map(|v| v - 0.5 * voxel_size), scale: voxel_size }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_lie_in_the_same_cells_wherever_the_cloud_lies() {
        let points: Vec<Point> = (0..500).map(|i| [131, 577, 883].map(|k| (i * k % 997) as f32 * 0.01)).collect();
        let cells = |offset: f32| {
            let moved: Vec<Point> = points.iter().map(|point| point.map(|v| v + offset)).collect();
            let lattice = from_corner(lowest_corner(&moved), 0.03);
            moved.iter().map(|&point| lattice.to_network(point).map(f32::floor)).collect::<Vec<_>>()
        };
        let expected = cells(0.0);
        assert!(expected.as_flattened().iter().all(|&v| (0.0..400.0).contains(&v)));
        for offset in [0.015, -7.013, 100.02] {
            let moved = cells(offset);
            let equal = moved.iter().zip(&expected).filter(|(a, b)| a == b).count();
            // Rounding moves a point that lies on a border.
            assert!(equal >= 495, "{offset}: {equal}");
        }
    }
}

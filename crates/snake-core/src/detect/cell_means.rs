//! The starting queries of a scene: there is no grid over its box, of which the surface fills almost nothing.

use snake_kernels::Scratch;

use crate::field::Field;
use crate::network::encoder::VoxelGroups;
use snake_geometry::Point;

/// Steps of a query within its cell: with so few digits it lies alike in a scene that is moved by whole voxels.
const STEPS: f32 = 256.0;

/// The mean of the points of each cell with points, in the network's frame; by z, then y, then x.
pub(crate) fn cell_means(field: &Field) -> Scratch<Point> {
    let normalization = field.normalization();
    let in_voxels: Vec<Point> = field.points().iter().map(|&point| normalization.to_network(point)).collect();
    let mut groups = VoxelGroups::default();
    let cells = groups.fill_sparse(&in_voxels);
    let mean = |cell: usize| {
        let low = cells[cell].map(|i| i as f32);
        let number = groups.num_points(cell..cell + 1) as f32;
        // Offsets within the cell, so that a sum of many points keeps its digits.
        let offsets = groups.members(cell..cell + 1).map(|index| in_voxels[index]);
        let sum =
            offsets.fold([0.0; 3], |sum, point| std::array::from_fn(|axis| sum[axis] + (point[axis] - low[axis])));
        std::array::from_fn(|axis| low[axis] + (sum[axis] / number * STEPS).round() / STEPS)
    };
    Scratch::collect(cells.len(), (0..cells.len()).map(mean))
}

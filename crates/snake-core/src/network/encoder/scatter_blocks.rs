//! Soft scattering on the lattice: each point's feature is added to the eight nodes of its cell.
//!
//! The weights w are those of trilinear interpolation. A node of mass m = Σ w holds Σ w · feature / max(m, m0). The mass m0
//! is fixed in the weight file, so a node depends only on the points of its eight cells.

use snake_kernels::{BLOCK_VOXELS, Corners, SimdLevel, add_weighted};

use crate::lattice::BlockGrid;
use snake_geometry::{Point, chunks_in_parallel};

/// Number of values in a cell's eight slots, one for each corner: sums of `channels` features and a mass.
pub(super) fn slots_width(channels: usize) -> usize {
    8 * (channels + 1)
}

/// Adds the feature of a point to the slots of its cell. The point is given by its offset from the cell's centre.
pub(super) fn spread(offset: Point, feature: &[f32], slots: &mut [f32]) {
    let weights = Corners { fraction: offset.map(|v| v + 0.5), ..Corners::default() }.weights();
    add_weighted(SimdLevel::current(), feature, &weights, &[0, 1, 2, 3, 4, 5, 6, 7], slots);
}

/// Writes the nodes `[block][z][y][x][channel]` of the stored blocks, from the slots of the cells with points.
pub(super) fn gather(
    grid: &BlockGrid,
    neighbors: &[[u32; 27]],
    cells: &[[i32; 3]],
    slots: &[f32],
    least_mass: f32,
    channels: usize,
    nodes: &mut [f32],
) {
    // The row of each cell with points, plus one, stored at the cell's lowest node. These blocks contain all such cells, so
    // neighbours with higher numbers have none.
    let mut rows = vec![0_u32; (grid.len() + 1) * BLOCK_VOXELS];
    (1..).zip(cells).for_each(|(row, &cell)| rows[grid.node(cell) as usize] = row);
    let slot = |row: u32, corner: usize| &slots[((row as usize - 1) * 8 + corner) * (channels + 1)..][..channels + 1];
    chunks_in_parallel(nodes, BLOCK_VOXELS * channels, &|block, nodes| {
        let neighbors = &neighbors[block];
        for (voxel, node) in nodes.chunks_exact_mut(channels).enumerate() {
            node.fill(0.0);
            let mut mass = 0.0;
            for corner in 0..8 {
                let row = rows.get(cell_at_corner(neighbors, voxel, corner)).copied().unwrap_or(0);
                if row > 0 {
                    let (sums, mass_of_slot) = slot(row, corner).split_at(channels);
                    mass += mass_of_slot[0];
                    node.iter_mut().zip(sums).for_each(|(value, sum)| *value += sum);
                }
            }
            let divisor = mass.max(least_mass);
            node.iter_mut().for_each(|value| *value /= divisor);
        }
    });
}

/// The index of the cell whose corner `corner` is the node `voxel` of a block.
fn cell_at_corner(neighbors: &[u32; 27], voxel: usize, corner: usize) -> usize {
    let (mut block, mut within) = (0, 0);
    for (axis, stride) in [1, 4, 16].into_iter().enumerate() {
        // Counted from the first node of the lower neighbour.
        let place = voxel / stride % 4 + 4 - (corner >> axis & 1);
        block += place / 4 * [1, 3, 9][axis];
        within += place % 4 * stride;
    }
    neighbors[block] as usize * BLOCK_VOXELS + within
}

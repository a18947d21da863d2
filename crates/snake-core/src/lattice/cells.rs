//! The starting queries of a scene: one per cell with points. A grid over the box would be almost empty.

use super::voxel_groups::VoxelGroups;
use crate::Result;
use snake_geometry::Point;

/// Steps per voxel of a query's rounding in its cell. A scene that moves by whole voxels keeps its queries.
const STEPS: f32 = 256.0;

/// The cells of a lattice of unit spacing that hold points.
#[derive(Debug, Clone)]
pub(crate) struct Cells {
    means: Vec<Point>,
}

impl Cells {
    /// The cells of points.
    ///
    /// # Errors
    /// [`crate::Error::Input`] for more points than [`u32::MAX`].
    pub(crate) fn from_points(points: &[Point]) -> Result<Self> {
        let mut groups = VoxelGroups::default();
        let cells = groups.fill_sparse(points)?;
        Ok(Self::from_groups(points, &groups, &cells))
    }

    /// The cells of points that are grouped already; `cells` are their lowest nodes.
    pub(crate) fn from_groups(points: &[Point], groups: &VoxelGroups, cells: &[[i32; 3]]) -> Self {
        let mean = |cell: usize| {
            let low = cells[cell].map(|i| i as f32);
            let number = groups.num_points(cell..cell + 1) as f32;
            // Offsets are relative to the cell, so a sum of many points keeps its precision.
            let offsets = groups.members(cell..cell + 1).map(|index| points[index]);
            let sum =
                offsets.fold([0.0; 3], |sum, point| std::array::from_fn(|axis| sum[axis] + (point[axis] - low[axis])));
            std::array::from_fn(|axis| low[axis] + (sum[axis] / number * STEPS).round() / STEPS)
        };
        Self { means: (0..cells.len()).map(mean).collect() }
    }

    /// The mean of the points of each cell, by z, then y, then x.
    pub(crate) fn means(&self) -> &[Point] {
        &self.means
    }
}

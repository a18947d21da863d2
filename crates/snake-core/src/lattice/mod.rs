//! Where the voxels of a volume lie: in a cube to which every cloud is scaled, or in blocks around the points of a scene.
//!
//! Only this folder distinguishes the two. For both it answers which frame a cloud is put into, where detection starts
//! its queries, which scores it corrects afterwards, and which options are valid.
//!
//! A scene's network frame has the voxel as its unit and begins half a voxel below the lowest corner of the points. Node `i` of the
//! lattice lies at coordinate `i`, and a cell is the space between eight nodes. Far from all points every layer of the network has a
//! constant value, so blocks without points nearby need neither memory nor time.

mod blocks;
mod cells;
mod corner;
mod cube;
mod levels;
mod queries;
mod query_grid;
mod shape;
mod voxel_groups;
mod voxel_size;

pub(crate) use self::blocks::{BlockGrid, MAX_NODE};
pub(crate) use self::cells::Cells;
pub(crate) use self::corner::from_corner;
pub use self::cube::VolumeFrame;
pub(crate) use self::levels::{FinestLevel, Level, levels};
pub(crate) use self::queries::{Queries, Refined};
pub use self::shape::VolumeShape;
pub(crate) use self::voxel_groups::VoxelGroups;
pub(crate) use self::voxel_size::voxel_size;

use std::borrow::Cow;

use crate::Result;
use crate::options::DetectOptions;
use snake_geometry::Point;
use snake_geometry::rotations::Rotation;
use snake_kernels::{BLOCK_SIDE, Corners};

/// The positions of a volume's voxels.
#[derive(Debug, Clone)]
pub(crate) enum Lattice {
    /// All voxels of a cube.
    Cube(VolumeFrame),
    /// The voxels of a scene's blocks, and the cells that contain its points.
    Blocks(BlockGrid, Cells),
}

impl Lattice {
    /// The eight voxels around a query.
    pub(crate) fn corners(&self, query: Point) -> Corners {
        match self {
            Self::Cube(frame) => frame.corners(query),
            Self::Blocks(blocks, _) => blocks.corners(query),
        }
    }

    /// Voxels per network unit along each axis at a query.
    pub(crate) fn voxels_per_unit(&self, query: Point) -> Point {
        match self {
            Self::Cube(frame) => frame.voxels_per_unit(query),
            Self::Blocks(..) => [1.0; 3],
        }
    }

    /// Lower and upper end of the volume along each axis, in the network's frame.
    pub(crate) fn bounds(&self) -> [[f32; 2]; 3] {
        match self {
            Self::Cube(frame) => frame.bounds(),
            Self::Blocks(blocks, _) => blocks.bounds().map(|ends| ends.map(|end| end as f32)),
        }
    }

    /// D, H, W. The blocks of a scene are stacked along z; the first one stands for all missing blocks.
    pub(crate) fn size(&self) -> [usize; 3] {
        match self {
            Self::Cube(frame) => frame.size(),
            Self::Blocks(blocks, _) => [(blocks.len() + 1) * BLOCK_SIDE, BLOCK_SIDE, BLOCK_SIDE],
        }
    }

    /// The positions of a cube's voxels.
    pub(crate) fn frame(&self) -> Option<VolumeFrame> {
        match self {
            Self::Cube(frame) => Some(*frame),
            Self::Blocks(..) => None,
        }
    }

    /// The voxel size along `axis` in cloud units; `scale` is cloud units per network unit, `[low, high]` are the ends of the volume.
    pub(crate) fn voxel_size_along(&self, axis: usize, [low, high]: [f32; 2], scale: f32) -> f32 {
        match self {
            Self::Cube(frame) => (high - low) / frame.resolution[axis] as f32,
            Self::Blocks(..) => scale,
        }
    }

    /// The voxel size along x in cloud units; `scale` is cloud units per network unit.
    pub(crate) fn voxel_size(&self, scale: f32) -> f32 {
        match self {
            Self::Cube(frame) => frame.voxel_size(scale),
            Self::Blocks(..) => scale,
        }
    }

    /// The voxels as the saliency decoder sees them. In the released code only the occupancy decoder uses the z bounds; the
    /// saliency decoder assumes ±0.5. All published networks have these bounds.
    pub(crate) fn for_saliency(&self) -> Cow<'_, Self> {
        match self {
            Self::Cube(frame) => Cow::Owned(Self::Cube(VolumeFrame { z_bounds: [-0.5, 0.5], ..*frame })),
            Self::Blocks(..) => Cow::Borrowed(self),
        }
    }

    /// The queries from which detection starts: a grid over the cube, or the mean of the points of each cell of a scene.
    /// `points` is the cloud in the frame of the volume, which `orientation` rotates.
    pub(crate) fn queries(
        &self,
        points: impl Iterator<Item = Point>,
        orientation: &Rotation,
        options: &DetectOptions,
    ) -> Queries {
        match self {
            Self::Cube(frame) => Queries::grid(frame, points, orientation, options),
            Self::Blocks(_, cells) => Queries::cells(cells.means().iter().copied()),
        }
    }

    /// Whether the volume follows a scene.
    pub(crate) fn is_scene(&self) -> bool {
        matches!(self, Self::Blocks(..))
    }

    /// The mean of the points of each cell of a scene; a cube has none.
    pub(crate) fn cell_means(&self) -> &[Point] {
        match self {
            Self::Cube(_) => &[],
            Self::Blocks(_, cells) => cells.means(),
        }
    }

    /// Replaces the cells of a scene by the cells of these points, which are in the network's frame.
    pub(crate) fn set_cells(&mut self, points: impl Iterator<Item = Point>) -> Result<()> {
        if let Self::Blocks(_, cells) = self {
            *cells = Cells::from_points(&points.collect::<Vec<_>>())?;
        }
        Ok(())
    }
}

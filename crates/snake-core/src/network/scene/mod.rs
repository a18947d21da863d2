//! The volume of a scene: voxels of one size on an unbounded lattice, stored in blocks where the points reach.
//!
//! Node `i` of the lattice lies at the coordinate `i` of the network's frame, whose unit is the voxel. A cell is the space
//! between eight nodes. Far from all points every layer of the network has a constant value, so blocks without points
//! nearby need neither memory nor time ([`encoder`]).

mod block_grid;
mod encoder;
mod levels;
pub(crate) mod measured;
mod scatter;
pub(crate) mod sweep;
#[cfg(test)]
mod tests;
mod unet;
mod voxel_size;

pub(crate) use self::block_grid::BlockGrid;
pub(crate) use self::encoder::{SceneEncoder, SceneMemory};
pub(crate) use self::voxel_size::voxel_size;

//! The encoder, from points to a volume: PointNet with local max-pooling, scattering, 3-D U-Net (SNAKE 3.1, ConvONet).

mod blocks;
mod dense;
mod pointnet;
mod pointnet_blocks;
mod scatter_blocks;
mod scatter_dense;
#[cfg(test)]
mod tests;
mod unet_blocks;
mod unet_dense;
mod voxel_sums;

pub(crate) use self::dense::aggregated;

use self::blocks::BlockEncoder;
use self::dense::DenseEncoder;
use crate::Result;
use crate::control::Counter;
use crate::lattice::{VolumeShape, VoxelGroups};
use crate::network::config::ModelConfig;
use crate::network::volume::Volume;
use crate::network::weights::Scope;
use snake_geometry::Point;

/// The memory for the points of a cloud, grouped by voxels of a cube or cells of a scene. The next cloud reuses it.
#[derive(Debug, Clone, Default)]
pub(crate) struct EncoderMemory {
    pub(crate) groups: VoxelGroups,
    /// Sums over the points of each voxel.
    pub(crate) sums: Vec<f32>,
}

/// The encoder of a network, by the shape of its volume.
#[derive(Debug)]
pub(crate) enum Encoder {
    Dense(Box<DenseEncoder>),
    Blocks(Box<BlockEncoder>),
}

impl Encoder {
    pub(crate) fn load(scope: &Scope, config: &ModelConfig) -> Result<Self> {
        Ok(match config.volume {
            VolumeShape::Cube(frame) => Self::Dense(Box::new(DenseEncoder::load(scope, config, frame)?)),
            VolumeShape::Scene { scatter_mass } => {
                Self::Blocks(Box::new(BlockEncoder::load(scope, config, scatter_mass)?))
            }
        })
    }

    /// The progress units of [`Encoder::encode`] for a number of points; 0 for a scene model, whose encoder sets the total itself.
    pub(crate) fn work(&self, num_points: usize) -> usize {
        match self {
            Self::Dense(encoder) => encoder.work(num_points),
            Self::Blocks(_) => 0,
        }
    }

    /// Encodes `num_points` points to the feature volume. `point` returns them in the network's frame.
    pub(crate) fn encode(
        &self,
        num_points: usize,
        point: impl Fn(usize) -> Point + Sync,
        memory: &mut EncoderMemory,
        counter: &Counter,
    ) -> Result<Volume> {
        match self {
            Self::Dense(encoder) => encoder.encode(num_points, point, memory, counter),
            Self::Blocks(encoder) => {
                let points: Vec<Point> = (0..num_points).map(point).collect();
                encoder.encode(&points, memory, counter)
            }
        }
    }

    /// The encoder of a cube, for tests of its stages.
    #[cfg(test)]
    pub(crate) fn dense(&self) -> &DenseEncoder {
        let Self::Dense(encoder) = self else { panic!("this is a scene model") };
        encoder
    }
}

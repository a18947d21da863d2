//! Points to volume: PointNet with local max-pooling, scatter-mean, 3-D U-Net (SNAKE 3.1, ConvONet).

mod pointnet;
mod unet;

use rayon::prelude::*;

use self::pointnet::PointNet;
pub(crate) use self::pointnet::VoxelGroups;
use self::unet::UNet3d;
use crate::Result;
use crate::model::ModelConfig;
use crate::nn::Tensor;
use crate::points::Point;
use crate::progress::Counter;
use crate::volume::{Volume, VolumeFrame};
use crate::weights::Scope;
use snake_kernels::{ConstantRegion, channel_sums};

/// The encoder of a model.
#[derive(Debug)]
pub(crate) struct Encoder {
    frame: VolumeFrame,
    pointnet: PointNet,
    unet: UNet3d,
}

impl Encoder {
    pub(crate) fn load(scope: &Scope, config: &ModelConfig) -> Result<Self> {
        Ok(Self {
            frame: config.frame,
            pointnet: PointNet::load(scope, config)?,
            unet: UNet3d::load(&scope.at("unet3d"), config)?,
        })
    }

    /// What [`Encoder::encode`] counts for so many points: each point in each pass over them, which are grouping, those of
    /// the PointNet and scattering, and the voxels of the U-Net, which take about as long.
    pub(crate) fn work(&self, num_points: usize) -> usize {
        2 * num_points + self.pointnet.work(num_points) + self.unet.work(self.frame.size())
    }

    /// Points of the network's frame to the feature volume.
    pub(crate) fn encode(&self, points: &[Point], counter: &Counter) -> Volume {
        let groups = VoxelGroups::new(points, &self.frame);
        counter.add(points.len());
        let features = self.point_features(points, &groups, counter);
        let volume = self.scatter_mean(&features, &groups, counter);
        Volume { frame: self.frame, channels: volume.channels, values: self.unet.forward(volume, counter) }
    }

    /// Features `(points, c_dim)`.
    pub(crate) fn point_features(&self, points: &[Point], groups: &VoxelGroups, counter: &Counter) -> Vec<f32> {
        self.pointnet.features(points, groups, counter)
    }

    /// Mean feature of each voxel's points; voxels without points are zero.
    pub(crate) fn scatter_mean(&self, features: &[f32], groups: &VoxelGroups, counter: &Counter) -> Tensor {
        let channels = features.len() / groups.num_points();
        let size = self.frame.size();
        let means = groups.mean_pool(features, channels, counter);
        let mut values = self.unet.pool.take(size.iter().product::<usize>() * channels);
        values.par_chunks_mut(size[1] * size[2] * channels).for_each(|plane| plane.fill(0.0));
        for (voxel, mean) in groups.voxels().zip(means.chunks_exact(channels)) {
            values[voxel * channels..][..channels].copy_from_slice(mean);
        }
        let constant = Some(ConstantRegion::around(size, groups.voxels()));
        Tensor { size, channels, values, sums: channel_sums(&means, channels), constant }
    }
}

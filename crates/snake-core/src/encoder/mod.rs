//! Points to volume: PointNet with local max-pooling, scatter-mean, 3-D U-Net (SNAKE 3.1, ConvONet).

mod pointnet;
mod unet;

use self::pointnet::PointNet;
pub(crate) use self::pointnet::VoxelGroups;
use self::unet::UNet3d;
use crate::Result;
use crate::kernels::Blank;
use crate::model::ModelConfig;
use crate::nn::Tensor;
use crate::points::Point;
use crate::volume::{Volume, VolumeFrame};
use crate::weights::Scope;

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

    /// Points of the network's frame to the feature volume.
    pub(crate) fn encode(&self, points: &[Point]) -> Volume {
        let groups = VoxelGroups::new(points, &self.frame);
        let features = self.point_features(points, &groups);
        let channels = features.len() / points.len();
        let mut volume = Tensor::new(self.frame.size(), channels, self.scatter_mean(&features, &groups));
        volume.blank = Some(Blank::around(volume.size, groups.iter().map(|(voxel, _)| voxel)));
        Volume { frame: self.frame, channels, values: self.unet.forward(volume) }
    }

    /// Features `(points, c_dim)`.
    pub(crate) fn point_features(&self, points: &[Point], groups: &VoxelGroups) -> Vec<f32> {
        self.pointnet.features(points, groups)
    }

    /// Mean feature of each voxel's points; voxels without points are zero.
    pub(crate) fn scatter_mean(&self, features: &[f32], groups: &VoxelGroups) -> Vec<f32> {
        let channels = features.len() / groups.num_points();
        let mut volume = self.unet.pool.take(self.frame.size().iter().product::<usize>() * channels);
        volume.fill(0.0);
        for (voxel, members) in groups.iter() {
            let mean = &mut volume[voxel * channels..][..channels];
            for &point in members {
                for (m, f) in mean.iter_mut().zip(&features[point as usize * channels..]) {
                    *m += f;
                }
            }
            mean.iter_mut().for_each(|m| *m /= members.len() as f32);
        }
        volume
    }
}

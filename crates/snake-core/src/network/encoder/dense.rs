//! The encoder of a cube: voxels from points, then a dense U-Net.

use super::EncoderMemory;
use super::pointnet::PointNet;
use super::scatter_dense as scatter;
use super::unet_dense::UNet3d;
use super::voxel_sums::{add, divide_by_counts};
use crate::Result;
use crate::control::Counter;
use crate::lattice::{Lattice, VolumeFrame, VoxelGroups};
use crate::network::config::{ModelConfig, Scatter};
use crate::network::layers::Tensor;
use crate::network::volume::Volume;
use crate::network::weights::Scope;
use snake_geometry::{Point, chunks_in_parallel};
use snake_kernels::{ConstantRegion, channel_sums};

/// The encoder of a model whose volume is a cube.
#[derive(Debug)]
pub(crate) struct DenseEncoder {
    frame: VolumeFrame,
    scatter: Scatter,
    pub(crate) points: PointNet,
    unet: UNet3d,
}

impl DenseEncoder {
    pub(crate) fn load(scope: &Scope, config: &ModelConfig, frame: VolumeFrame) -> Result<Self> {
        Ok(Self {
            frame,
            scatter: config.scatter,
            points: PointNet::load(scope, config)?,
            unet: UNet3d::load(&scope.at("unet3d"), config, frame)?,
        })
    }

    /// The progress units of [`DenseEncoder::encode`]: each point once for grouping, once per block of the point encoder and
    /// once for its last layer, and the voxels of the U-Net. All units take similar times.
    pub(crate) fn work(&self, num_points: usize) -> usize {
        num_points + self.points.work(num_points) + self.unet.work(self.frame.size())
    }

    /// Encodes `num_points` points to the feature volume. `point` returns them in the network's frame.
    pub(crate) fn encode(
        &self,
        num_points: usize,
        point: impl Fn(usize) -> Point + Sync,
        memory: &mut EncoderMemory,
        counter: &Counter,
    ) -> Result<Volume> {
        let volume = self.point_volume(num_points, point, memory, counter)?;
        let lattice = Lattice::Cube(self.frame);
        Ok(Volume { lattice, channels: volume.channels, values: self.unet.forward(volume, counter)? })
    }

    /// The input of the U-Net: the scattered features of the points.
    fn point_volume(
        &self,
        num_points: usize,
        point: impl Fn(usize) -> Point + Sync,
        memory: &mut EncoderMemory,
        counter: &Counter,
    ) -> Result<Tensor> {
        memory.groups.fill(num_points, &point, &self.frame)?;
        counter.add(num_points);
        counter.check()?;
        match self.scatter {
            Scatter::Hard => {
                self.points.voxel_means(&memory.groups, &point, &mut memory.sums, counter)?;
                Ok(self.scatter(&memory.sums, &memory.groups))
            }
            Scatter::Soft => self.scatter_soft(memory, &point, counter),
        }
    }

    /// Writes the mean features to the occupied voxels; voxels without points are zero.
    pub(crate) fn scatter(&self, means: &[f32], groups: &VoxelGroups) -> Tensor {
        let (size, channels) = (self.frame.size(), self.points.channels());
        let mut values = self.unet.pool.take(size.iter().product::<usize>() * channels);
        chunks_in_parallel(&mut values, size[1] * size[2] * channels, &|_, plane| plane.fill(0.0));
        write_rows(means, groups, channels, &mut values);
        let constant = Some(ConstantRegion::around(size, groups.voxels()));
        Tensor { size, channels, values, sums: channel_sums(means, channels), constant }
    }

    /// Adds the features of the points to their eight nearest voxels ([`Scatter::Soft`]); voxels without mass are zero.
    fn scatter_soft(
        &self,
        EncoderMemory { groups, sums: slots }: &mut EncoderMemory,
        point: impl Fn(usize) -> Point + Sync,
        counter: &Counter,
    ) -> Result<Tensor> {
        let (size, channels) = (self.frame.size(), self.points.channels());
        let spread =
            |point: Point, feature: &[f32], slots: &mut [f32]| scatter::spread(&self.frame, point, feature, slots);
        self.points.voxel_sums(groups, point, scatter::slots_width(channels), spread, slots, counter)?;
        let mut values = self.unet.pool.take(size.iter().product::<usize>() * channels);
        chunks_in_parallel(&mut values, size[1] * size[2] * channels, &|_, plane| plane.fill(0.0));
        counter.check()?;
        let touched = scatter::gather(&self.frame, groups, slots, &mut values, counter)?;
        let sums = channel_sums(&values, channels);
        counter.check()?;
        Ok(Tensor {
            size,
            channels,
            values,
            sums,
            constant: Some(ConstantRegion::around(size, touched.iter().copied())),
        })
    }
}

/// Writes the rows `(voxels, channels)` of the occupied voxels into a volume `[z][y][x][channel]`.
fn write_rows(rows: &[f32], groups: &VoxelGroups, channels: usize, volume: &mut [f32]) {
    for (voxel, row) in groups.voxels().zip(rows.chunks_exact(channels)) {
        volume[voxel * channels..][..channels].copy_from_slice(row);
    }
}

/// Aggregates given features into a zeroed volume `[z][y][x][channel]`. `feature` returns a grouped point with its feature.
pub(crate) fn aggregated<'a>(
    scatter: Scatter,
    frame: &VolumeFrame,
    groups: &VoxelGroups,
    feature: impl Fn(usize) -> (Point, &'a [f32]),
    values: &mut [f32],
) -> Result<()> {
    let channels = values.len() / frame.resolution.iter().product::<usize>();
    let width = if scatter == Scatter::Hard { channels } else { scatter::slots_width(channels) };
    let mut sums = vec![0.0; groups.num_voxels() * width];
    for (voxel, sums) in sums.chunks_exact_mut(width).enumerate() {
        for (point, feature) in groups.members(voxel..voxel + 1).map(&feature) {
            match scatter {
                Scatter::Hard => add(point, feature, sums),
                Scatter::Soft => scatter::spread(frame, point, feature, sums),
            }
        }
    }
    match scatter {
        Scatter::Hard => {
            divide_by_counts(&mut sums, groups, channels);
            write_rows(&sums, groups, channels, values);
        }
        Scatter::Soft => drop(scatter::gather(frame, groups, &sums, values, &Counter::default())?),
    }
    Ok(())
}

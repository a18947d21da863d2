//! Sums and means of the features of the points in each voxel.

use super::pointnet::PointNet;
use crate::Result;
use crate::control::Counter;
use crate::lattice::VoxelGroups;
use snake_geometry::Point;

impl PointNet {
    /// Replaces `means` by the mean feature of each occupied voxel, `(voxels, c_dim)`. `point` returns a grouped point in
    /// the network's frame.
    pub(crate) fn voxel_means(
        &self,
        groups: &VoxelGroups,
        point: impl Fn(usize) -> Point + Sync,
        means: &mut Vec<f32>,
        counter: &Counter,
    ) -> Result<()> {
        self.voxel_sums(groups, point, self.channels(), add, means, counter)?;
        divide_by_counts(means, groups, self.channels());
        Ok(())
    }

    /// Replaces `sums` by the sums over the points of each occupied voxel, `(voxels, width)`. `add` adds one point with its
    /// feature `(c_dim)` to the sums of its voxel; points come in the order of the cloud.
    pub(crate) fn voxel_sums(
        &self,
        groups: &VoxelGroups,
        point: impl Fn(usize) -> Point + Sync,
        width: usize,
        add: impl Fn(Point, &[f32], &mut [f32]) + Sync,
        sums: &mut Vec<f32>,
        counter: &Counter,
    ) -> Result<()> {
        sums.clear();
        sums.resize(groups.num_voxels() * width, 0.0);
        self.add_to_voxels(groups, point, add, sums, counter)
    }
}

/// Adds a feature to the sum of its voxel.
pub(super) fn add(_: Point, feature: &[f32], sums: &mut [f32]) {
    sums.iter_mut().zip(feature).for_each(|(sum, value)| *sum += value);
}

/// Divides the sums `(voxels, channels)` by the number of points of each occupied voxel.
pub(super) fn divide_by_counts(sums: &mut [f32], groups: &VoxelGroups, channels: usize) {
    for (voxel, mean) in sums.chunks_exact_mut(channels).enumerate() {
        let size = groups.num_points(voxel..voxel + 1);
        mean.iter_mut().for_each(|sum| *sum /= size as f32);
    }
}

//! Groups points by voxel.

use std::ops::Range;

use rayon::prelude::*;

use crate::points::Point;
use crate::volume::VolumeFrame;

/// The points of a cloud, grouped by the voxel that contains them, in eight bytes per point.
#[derive(Debug, Clone, Default)]
pub(crate) struct VoxelGroups {
    /// The voxel in the upper 32 bits and the point's index in the lower 32 bits, ascending.
    members: Vec<u64>,
    /// The start of each occupied voxel in `members`, and the end.
    starts: Vec<u32>,
}

impl VoxelGroups {
    /// Groups `num_points` points, at most [`u32::MAX`], given by `point` in the network's frame, instead of those that
    /// were grouped before.
    pub(crate) fn fill(&mut self, num_points: usize, point: impl Fn(usize) -> Point + Sync, frame: &VolumeFrame) {
        let Self { members, starts } = self;
        let member = |index: usize| (frame.voxel(point(index)) as u64) << 32 | index as u64;
        (0..num_points).into_par_iter().map(member).collect_into_vec(members);
        members.par_sort_unstable();
        let is_first = |&place: &usize| place == 0 || voxel(members[place - 1]) != voxel(members[place]);
        starts.clear();
        starts.reserve(num_points.min(frame.resolution.iter().product()) + 1);
        starts.extend((0..num_points).filter(is_first).map(|place| place as u32));
        starts.push(num_points as u32);
    }

    /// The number of occupied voxels.
    pub(crate) fn num_voxels(&self) -> usize {
        self.starts.len() - 1
    }

    /// The flat indices of the occupied voxels, ascending.
    pub(crate) fn voxels(&self) -> impl Iterator<Item = usize> {
        self.starts[..self.num_voxels()].iter().map(|&start| voxel(self.members[start as usize]))
    }

    /// Divides a range of at least two occupied voxels into two, each with about half of the points.
    pub(crate) fn halves(&self, voxels: Range<usize>) -> [Range<usize>; 2] {
        let half = u32::midpoint(self.starts[voxels.start], self.starts[voxels.end]);
        let inner = &self.starts[voxels.start + 1..voxels.end - 1];
        let middle = voxels.start + 1 + inner.partition_point(|start| *start < half);
        [voxels.start..middle, middle..voxels.end]
    }

    /// The number of points in a range of occupied voxels.
    pub(crate) fn num_points(&self, voxels: Range<usize>) -> usize {
        (self.starts[voxels.end] - self.starts[voxels.start]) as usize
    }

    /// The indices of the points of a range of occupied voxels: voxel by voxel, ascending within a voxel.
    pub(crate) fn members(&self, voxels: Range<usize>) -> impl Iterator<Item = usize> {
        let [start, end] = [voxels.start, voxels.end].map(|voxel| self.starts[voxel] as usize);
        self.members[start..end].iter().map(index)
    }
}

fn voxel(member: u64) -> usize {
    (member >> 32) as usize
}

fn index(member: &u64) -> usize {
    (member & u64::from(u32::MAX)) as usize
}

//! Groups points by voxel.

use std::ops::Range;

use rayon::prelude::*;

use crate::points::Point;
use crate::volume::VolumeFrame;

/// The points of a cloud, grouped by the voxel that contains them, in eight bytes per point.
#[derive(Debug)]
pub(crate) struct VoxelGroups {
    /// The voxel in the upper 32 bits and the point's index in the lower 32 bits, ascending.
    members: Vec<u64>,
    /// The start of each occupied voxel in `members`, and the end.
    starts: Vec<u32>,
}

impl VoxelGroups {
    /// Groups `num_points` points, at most [`u32::MAX`], given by `point` in the network's frame.
    pub(crate) fn new(num_points: usize, point: impl Fn(usize) -> Point + Sync, frame: &VolumeFrame) -> Self {
        let member = |index: usize| (frame.voxel(point(index)) as u64) << 32 | index as u64;
        let mut members: Vec<u64> = (0..num_points).into_par_iter().map(member).collect();
        members.par_sort_unstable();
        let is_first = |&place: &usize| place == 0 || voxel(members[place - 1]) != voxel(members[place]);
        let mut starts: Vec<u32> = (0..num_points).filter(is_first).map(|place| place as u32).collect();
        starts.push(num_points as u32);
        Self { members, starts }
    }

    /// The number of occupied voxels.
    pub(crate) fn num_voxels(&self) -> usize {
        self.starts.len() - 1
    }

    /// The flat indices of the occupied voxels, ascending.
    pub(crate) fn voxels(&self) -> impl Iterator<Item = usize> {
        self.starts[..self.num_voxels()].iter().map(|&start| voxel(self.members[start as usize]))
    }

    /// Splits the occupied voxels into ranges with at most `num_points` points, or with a single voxel that has more.
    pub(crate) fn chunks(&self, num_points: usize) -> Vec<Range<usize>> {
        let mut chunks: Vec<Range<usize>> = Vec::new();
        for voxel in 0..self.num_voxels() {
            match chunks.last_mut() {
                Some(chunk) if self.num_points(chunk.start..voxel + 1) <= num_points => chunk.end = voxel + 1,
                _ => chunks.push(voxel..voxel + 1),
            }
        }
        chunks
    }

    /// The number of points in a range of occupied voxels.
    pub(crate) fn num_points(&self, voxels: Range<usize>) -> usize {
        (self.starts[voxels.end] - self.starts[voxels.start]) as usize
    }

    /// The indices of the points of a range of occupied voxels: voxel by voxel, ascending within a voxel.
    pub(crate) fn members(&self, voxels: Range<usize>) -> impl Iterator<Item = usize> {
        self.of_voxels(voxels).iter().map(index)
    }

    /// [`VoxelGroups::members`] for several threads.
    pub(crate) fn par_members(&self, voxels: Range<usize>) -> impl IndexedParallelIterator<Item = usize> {
        self.of_voxels(voxels).par_iter().map(index)
    }

    fn of_voxels(&self, voxels: Range<usize>) -> &[u64] {
        &self.members[self.starts[voxels.start] as usize..self.starts[voxels.end] as usize]
    }
}

fn voxel(member: u64) -> usize {
    (member >> 32) as usize
}

fn index(member: &u64) -> usize {
    (member & u64::from(u32::MAX)) as usize
}

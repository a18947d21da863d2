//! Groups points by voxel.

use std::ops::Range;

use rayon::prelude::*;

use super::cube::VolumeFrame;
use crate::Result;
use snake_geometry::Point;

/// The points of a cloud, grouped by the voxel that contains them, in eight bytes per point.
#[derive(Debug, Clone, Default)]
pub(crate) struct VoxelGroups {
    /// The flat index of each point's voxel.
    voxel_of_point: Vec<u32>,
    /// The indices of the points, voxel by voxel and ascending within a voxel.
    members: Vec<u32>,
    /// The flat indices of the occupied voxels, ascending.
    voxels: Vec<u32>,
    /// The start of each occupied voxel in `members`, and the end.
    starts: Vec<u32>,
}

impl VoxelGroups {
    /// Groups `num_points` points, at most [`u32::MAX`], and replaces the previous groups. `point` returns a point by its
    /// index, in the network's frame.
    pub(crate) fn fill(&mut self, num_points: usize, point: impl Fn(usize) -> Point + Sync, frame: &VolumeFrame) {
        let Self { voxel_of_point, members, voxels, starts } = self;
        let voxel = |index: usize| frame.voxel(point(index)) as u32;
        (0..num_points).into_par_iter().map(voxel).collect_into_vec(voxel_of_point);
        // A counting sort: `next` has the number of points of each voxel, and then the place of its next point.
        let mut next = vec![0_u32; frame.resolution.iter().product()];
        voxel_of_point.iter().for_each(|voxel| next[*voxel as usize] += 1);
        voxels.clear();
        starts.clear();
        let most = num_points.min(next.len());
        voxels.reserve(most);
        starts.reserve(most + 1);
        let mut end = 0;
        for (voxel, next) in (0..).zip(next.iter_mut()).filter(|(_, number)| **number > 0) {
            voxels.push(voxel);
            starts.push(end);
            (*next, end) = (end, end + *next);
        }
        starts.push(end);
        members.resize(num_points, 0);
        for (index, voxel) in (0..).zip(voxel_of_point.iter()) {
            let next = &mut next[*voxel as usize];
            members[*next as usize] = index;
            *next += 1;
        }
    }

    /// Groups points by the cell of a lattice of unit spacing that contains them, and replaces the previous groups. Each cell
    /// has 32³ parts; only the first point of a part is kept, so a cloud in which every point occurs twice is encoded like the
    /// cloud itself. Coordinates must be within ±2^20. Returns the lowest node of each occupied cell, ordered by z, then y,
    /// then x.
    pub(crate) fn fill_sparse(&mut self, points: &[Point]) -> Vec<[i32; 3]> {
        const MIDDLE: i32 = 1 << 20;
        let key = |point: &Point| {
            let [x, y, z] = point.map(|v| (v.floor() as i32 + MIDDLE) as u64);
            (z << 42) | (y << 21) | x
        };
        let mut order: Vec<(u64, u32)> = points.iter().map(key).zip(0..).collect();
        order.par_sort_unstable();
        self.voxel_of_point.clear();
        self.voxels.clear();
        self.starts.clear();
        self.members.clear();
        let mut cells = Vec::new();
        let mut parts = CellParts::default();
        for members in order.chunk_by(|a, b| a.0 == b.0) {
            let key = members[0].0;
            self.voxels.push(self.voxels.len() as u32);
            self.starts.push(self.members.len() as u32);
            cells.push([key, key >> 21, key >> 42].map(|bits| (bits & ((1 << 21) - 1)) as i32 - MIDDLE));
            let indices = members.iter().map(|&(_, index)| index);
            self.members.extend(indices.filter(|&index| parts.take(&points[index as usize])));
            parts.clear();
        }
        self.starts.push(self.members.len() as u32);
        cells
    }

    /// The number of occupied voxels.
    pub(crate) fn num_voxels(&self) -> usize {
        self.voxels.len()
    }

    /// The flat indices of the occupied voxels, ascending.
    pub(crate) fn voxels(&self) -> impl Iterator<Item = usize> {
        self.voxels.iter().map(|&voxel| voxel as usize)
    }

    /// Runs a task in parallel on ranges of occupied voxels with at most `most` points, or of one voxel, and their `sums`.
    pub(crate) fn in_parts(
        &self,
        most: usize,
        sums: &mut [f32],
        task: &(impl Fn(Range<usize>, &mut [f32]) -> Result<()> + Sync),
    ) -> Result<()> {
        self.range_in_parts(0..self.num_voxels(), most, sums, task)
    }

    fn range_in_parts(
        &self,
        voxels: Range<usize>,
        most: usize,
        sums: &mut [f32],
        task: &(impl Fn(Range<usize>, &mut [f32]) -> Result<()> + Sync),
    ) -> Result<()> {
        if voxels.len() == 1 || self.num_points(voxels.clone()) <= most {
            return task(voxels, sums);
        }
        let width = sums.len() / voxels.len();
        let [first, rest] = self.halves(voxels);
        let (first_sums, rest_sums) = sums.split_at_mut(first.len() * width);
        let (first, rest) = rayon::join(
            || self.range_in_parts(first, most, first_sums, task),
            || self.range_in_parts(rest, most, rest_sums, task),
        );
        first.and(rest)
    }

    /// Divides a range of at least two occupied voxels into two, each with about half of the points.
    fn halves(&self, voxels: Range<usize>) -> [Range<usize>; 2] {
        let half = u32::midpoint(self.starts[voxels.start], self.starts[voxels.end]);
        let inner = &self.starts[voxels.start + 1..voxels.end - 1];
        let middle = voxels.start + 1 + inner.partition_point(|start| *start < half);
        [voxels.start..middle, middle..voxels.end]
    }

    /// The number of points in a range of occupied voxels.
    pub(crate) fn num_points(&self, voxels: Range<usize>) -> usize {
        (self.starts[voxels.end] - self.starts[voxels.start]) as usize
    }

    /// The indices of the points in a range of occupied voxels, voxel by voxel and ascending within a voxel.
    pub(crate) fn members(&self, voxels: Range<usize>) -> impl Iterator<Item = usize> {
        let [start, end] = [voxels.start, voxels.end].map(|voxel| self.starts[voxel] as usize);
        self.members[start..end].iter().map(|&index| index as usize)
    }
}

/// The parts of a cell, 32 along each axis, that contain a point.
#[derive(Debug)]
struct CellParts {
    is_taken: Vec<bool>,
    taken: Vec<usize>,
}

impl Default for CellParts {
    fn default() -> Self {
        Self { is_taken: vec![false; Self::SIDE.pow(3)], taken: Vec::new() }
    }
}

impl CellParts {
    const SIDE: usize = 32;

    /// Takes the part of a point. Returns whether it was free.
    fn take(&mut self, point: &Point) -> bool {
        let [x, y, z] = point.map(|v| ((v - v.floor()) * Self::SIDE as f32) as usize).map(|i| i.min(Self::SIDE - 1));
        let part = (z * Self::SIDE + y) * Self::SIDE + x;
        let is_free = !std::mem::replace(&mut self.is_taken[part], true);
        if is_free {
            self.taken.push(part);
        }
        is_free
    }

    /// Frees all parts, for the next cell.
    fn clear(&mut self) {
        self.taken.drain(..).for_each(|part| self.is_taken[part] = false);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_that_lie_almost_at_one_place_count_once() {
        let at = |i: usize, step: f32| (i as f32 * step).fract() * 20.0 - 10.0;
        let points: Vec<Point> =
            (0..4000).map(|i| [at(i, 0.618_034), at(i, 0.754_877_7), at(i, 0.569_840_3)]).collect();
        let mut groups = VoxelGroups::default();
        let cells = groups.fill_sparse(&points);
        let once: Vec<usize> = groups.members(0..cells.len()).collect();
        assert!((3990..=4000).contains(&once.len()), "{}", once.len());
        assert_eq!(groups.fill_sparse(&points.repeat(3)), cells);
        assert_eq!(groups.members(0..cells.len()).collect::<Vec<_>>(), once);
        let moved = points.iter().map(|point| point.map(|v| v + 2e-4));
        let twice: Vec<Point> = points.iter().copied().chain(moved).collect();
        // In a few pairs, the two points lie on different sides of a part's border.
        let number = groups.fill_sparse(&twice).len();
        assert!((4000..4200).contains(&groups.num_points(0..number)), "{}", groups.num_points(0..number));
    }
}

//! Groups points by voxel.

use std::ops::Range;

use super::cube::VolumeFrame;
use crate::Result;
use snake_geometry::{CellGroups, Point, floor, lot};

/// Parts of a cell along each axis.
const PARTS: usize = 3;

/// The points of a cloud, grouped by the voxel that contains them.
#[derive(Debug, Clone, Default)]
pub(crate) struct VoxelGroups {
    /// The indices of the points, voxel by voxel.
    members: Vec<u32>,
    /// The flat indices of the occupied voxels, ascending.
    voxels: Vec<u32>,
    /// The start of each occupied voxel in `members`, and the end.
    starts: Vec<u32>,
}

impl VoxelGroups {
    /// Groups `num_points` points and replaces the previous groups. `point` returns a point by its index, in the network's frame.
    ///
    /// # Errors
    /// [`crate::Error::Input`] for more points than [`u32::MAX`].
    pub(crate) fn fill(
        &mut self,
        num_points: usize,
        point: impl Fn(usize) -> Point,
        frame: &VolumeFrame,
    ) -> Result<()> {
        let grouped = CellGroups::new((0..num_points).map(|index| [frame.voxel(point(index)) as i64, 0, 0]))?;
        let mut voxels: Vec<_> = grouped.iter().collect();
        voxels.sort_unstable_by_key(|(cell, _)| cell[0]);
        self.set_members(voxels.iter().map(|(_, members)| members.iter().copied()));
        self.voxels = voxels.into_iter().map(|(cell, _)| cell[0] as u32).collect();
        Ok(())
    }

    /// Groups points by the cell of a lattice of unit spacing that contains them, and replaces the previous groups. Each cell has
    /// 3³ parts, and one point of a part is kept, whatever their order: more points of a surface say nothing new, and a cloud in which
    /// every point occurs twice is encoded like the cloud itself. Coordinates must be within ±2^20. Returns the lowest node of each
    /// occupied cell, ordered by z, then y, then x.
    ///
    /// # Errors
    /// [`crate::Error::Input`] for more points than [`u32::MAX`].
    pub(crate) fn fill_sparse(&mut self, points: &[Point]) -> Result<Vec<[i32; 3]>> {
        let grouped = CellGroups::new(points.iter().map(|point| point.map(|v| floor(f64::from(v)))))?;
        let mut cells: Vec<_> = grouped.iter().collect();
        cells.sort_unstable_by_key(|&([x, y, z], _)| [z, y, x]);
        self.set_members(cells.iter().map(|(_, members)| {
            let mut chosen: [Option<u32>; PARTS.pow(3)] = [None; PARTS.pow(3)];
            for &index in *members {
                let point = points[index as usize];
                let chosen = &mut chosen[part_of(point)];
                if chosen.is_none_or(|other| lot(&point) < lot(&points[other as usize])) {
                    *chosen = Some(index);
                }
            }
            chosen.into_iter().flatten()
        }));
        self.voxels = (0..cells.len() as u32).collect();
        Ok(cells.into_iter().map(|(cell, _)| cell.map(|i| i as i32)).collect())
    }

    /// Replaces the members by those of each voxel.
    fn set_members(&mut self, voxels: impl Iterator<Item = impl Iterator<Item = u32>>) {
        self.members.clear();
        self.starts.clear();
        self.starts.push(0);
        for members in voxels {
            self.members.extend(members);
            self.starts.push(self.members.len() as u32);
        }
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

    /// The indices of the points in a range of occupied voxels, voxel by voxel.
    pub(crate) fn members(&self, voxels: Range<usize>) -> impl Iterator<Item = usize> {
        let [start, end] = [voxels.start, voxels.end].map(|voxel| self.starts[voxel] as usize);
        self.members[start..end].iter().map(|&index| index as usize)
    }
}

/// The part of its cell that contains a point.
fn part_of(point: Point) -> usize {
    let [x, y, z] = point.map(|v| ((v - v.floor()) * PARTS as f32) as usize).map(|i| i.min(PARTS - 1));
    (z * PARTS + y) * PARTS + x
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use super::*;

    #[test]
    fn one_point_of_each_part_of_a_cell_counts_whatever_their_order() {
        let at = |i: usize, step: f32| (i as f32 * step).fract() * 4.0 - 2.0;
        let points: Vec<Point> =
            (0..4000).map(|i| [at(i, 0.618_034), at(i, 0.754_877_7), at(i, 0.569_840_3)]).collect();
        let part = |point: &Point| point.map(|v| (v * PARTS as f32).floor() as i32);
        let parts: HashSet<[i32; 3]> = points.iter().map(part).collect();
        let chosen = |points: &[Point]| {
            let mut groups = VoxelGroups::default();
            let cells = groups.fill_sparse(points).unwrap();
            assert_eq!((cells.len(), cells.is_sorted_by_key(|[x, y, z]| [*z, *y, *x])), (64, true));
            groups.members(0..64).map(|index| points[index]).collect::<Vec<_>>()
        };
        let once = chosen(&points);
        assert_eq!((once.len(), once.iter().map(part).collect::<HashSet<_>>()), (parts.len(), parts));
        let reversed: Vec<Point> = points.iter().copied().rev().collect();
        assert_eq!(chosen(&reversed), once);
        assert_eq!(chosen(&points.repeat(3)), once);
    }
}

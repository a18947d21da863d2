//! Points grouped by the cubic cells that contain them.

use std::ops::Range;

use crate::{Error, Result};

/// The number of a cell along x, y and z.
pub type Cell = [i64; 3];

/// Points grouped by cell, in a time proportional to their number.
#[derive(Debug)]
pub struct CellGroups {
    /// In the order of their first points.
    groups: Vec<Group>,
    /// The indices of the points, group by group and ascending within a group.
    members: Vec<u32>,
    /// A hash table of the indices of the groups, with linear probing. It is at most half full.
    slots: Vec<u32>,
}

/// The points of a cell.
#[derive(Debug)]
struct Group {
    cell: Cell,
    /// Where the members begin and end.
    start: u32,
    end: u32,
}

impl Group {
    #[inline]
    fn range(&self) -> Range<usize> {
        self.start as usize..self.end as usize
    }
}

/// Marks a free slot of the hash table.
const FREE: u32 = u32::MAX;

impl CellGroups {
    /// Groups points, of which these are the cells.
    ///
    /// # Errors
    /// [`Error::Input`] for more points than [`u32::MAX`].
    pub fn new(cells: impl ExactSizeIterator<Item = Cell>) -> Result<Self> {
        let number = cells.len();
        if u32::try_from(number).is_err() {
            return Err(Error::Input { what: "points", reason: format!("{number} are too many") });
        }
        let mut grouped = Self { groups: Vec::new(), members: vec![0; number], slots: vec![FREE; 16] };
        // The points of a scan come in lines, so most lie in the same cell as the previous one.
        let mut last = None;
        let group_of = |cell| match last {
            Some((other, group)) if other == cell => group,
            _ => last.insert((cell, grouped.group(cell))).1,
        };
        let group_of: Vec<u32> = cells.map(group_of).collect();
        // A counting sort: the ends are first the numbers of points.
        group_of.iter().for_each(|group| grouped.groups[*group as usize].end += 1);
        let mut start = 0;
        for group in &mut grouped.groups {
            (group.start, group.end, start) = (start, start, start + group.end);
        }
        for (index, group) in (0..).zip(&group_of) {
            let group = &mut grouped.groups[*group as usize];
            grouped.members[group.end as usize] = index;
            group.end += 1;
        }
        Ok(grouped)
    }

    /// The cells that contain points, in the order of their first points, each with the indices of its points, ascending.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = (Cell, &[u32])> {
        self.groups.iter().map(|group| (group.cell, &self.members[group.range()]))
    }

    /// The index of the first point of each cell, ascending.
    pub fn firsts(&self) -> impl ExactSizeIterator<Item = usize> {
        self.groups.iter().map(|group| self.members[group.start as usize] as usize)
    }

    /// The indices of the points, cell by cell and ascending within a cell.
    pub fn members(&self) -> &[u32] {
        &self.members
    }

    /// The range in [`CellGroups::members`] of the points in a cell.
    #[inline]
    pub fn range(&self, cell: Cell) -> Range<usize> {
        self.groups.get(self.slots[self.slot(cell)] as usize).map_or(0..0, Group::range)
    }

    /// The index of a cell's group, which is new if the cell has no slot.
    fn group(&mut self, cell: Cell) -> u32 {
        let slot = self.slot(cell);
        if self.slots[slot] != FREE {
            return self.slots[slot];
        }
        let index = self.groups.len() as u32;
        self.groups.push(Group { cell, start: 0, end: 0 });
        self.slots[slot] = index;
        if 2 * self.groups.len() > self.slots.len() {
            self.slots = vec![FREE; 4 * self.slots.len()];
            for index in 0..self.groups.len() {
                let slot = self.slot(self.groups[index].cell);
                self.slots[slot] = index as u32;
            }
        }
        index
    }

    /// The slot of a cell; it is free if the cell has no points.
    #[inline]
    fn slot(&self, cell: Cell) -> usize {
        // Fibonacci hashing (Knuth, The Art of Computer Programming 3, section 6.4) along each axis.
        const FACTORS: [u64; 3] = [0x9e37_79b9_7f4a_7c15, 0xd1b5_4a32_d192_ed03, 0xaef1_7502_108e_f2d9];
        let hash = (0..3).fold(0, |hash, axis| hash ^ (cell[axis] as u64).wrapping_mul(FACTORS[axis]));
        let mut slot = (hash >> (64 - self.slots.len().ilog2())) as usize;
        while self.slots[slot] != FREE && self.groups[self.slots[slot] as usize].cell != cell {
            slot = (slot + 1) & (self.slots.len() - 1);
        }
        slot
    }
}

/// The largest integer that is at most `place`, saturated to the range of `i64`.
pub fn floor(place: f64) -> i64 {
    let whole = place as i64;
    if whole as f64 > place { whole.saturating_sub(1) } else { whole }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn groups_are_those_of_the_plain_search() {
        let at = |i: i64, k: i64| i * k % 997 % 12 - 6;
        let scattered: Vec<Cell> = (0..3000).map(|i| [at(i, 131), at(i, 577), at(i, 883)]).collect();
        let far = [[i64::MAX, i64::MIN, 0], [0; 3], [i64::MAX, i64::MIN, 0], [-1, 0, 0]];
        for cells in [&scattered[..], &far, &[]] {
            let groups = CellGroups::new(cells.iter().copied()).unwrap();
            let firsts: Vec<usize> = (0..cells.len()).filter(|&i| !cells[..i].contains(&cells[i])).collect();
            assert_eq!(groups.firsts().collect::<Vec<_>>(), firsts);
            for ((cell, members), first) in groups.iter().zip(firsts) {
                assert_eq!(cell, cells[first]);
                let expected: Vec<u32> =
                    (0..).zip(cells).filter(|(_, other)| **other == cell).map(|(i, _)| i).collect();
                assert_eq!(members, expected);
                assert_eq!(groups.members()[groups.range(cell)], expected);
            }
            assert!(groups.range([7, 0, 0]).is_empty());
        }
    }
}

//! Points in cells as wide as a radius, for queries within this radius.

use std::ops::RangeInclusive;

use rayon::prelude::*;

use crate::{Error, Point, Result};

/// Bits of a cell's number along an axis. Cells 2^21 steps apart have the same number, which costs time but changes no result.
const BITS: u64 = 21;

/// The largest number of a cell along an axis; the next cell has number 0.
const LAST: u64 = (1 << BITS) - 1;

/// Distances in `f32` are rounded, so a point within the radius is at most this many radii away.
const MARGIN: f64 = 1.0 + 1e-6;

/// Points sorted into cells that are as wide as a radius. A query within this radius visits at most 27 cells; a query within another
/// radius visits more cells, or larger ones than it needs.
///
/// If the queries are at least a fixed share of the radius apart, as in suppression, each point is visited a bounded number
/// of times, for every arrangement of points except those in which the numbers of cells coincide.
pub struct RadiusCells<'a> {
    points: &'a [Point],
    radius: f32,
    side: f64,
    /// The cell and the index of each point, ascending.
    members: Vec<(u64, u32)>,
    /// The index in `members` of each cell's first member, in a hash table with linear probing that is at most half full.
    firsts: Vec<u32>,
}

/// Marks a free slot of the hash table.
const FREE: u32 = u32::MAX;

impl<'a> RadiusCells<'a> {
    /// Sorts finite points for queries within about `radius`, which must be positive.
    ///
    /// # Errors
    /// [`Error::Input`] for more points than [`u32::MAX`].
    pub fn new(points: &'a [Point], radius: f32) -> Result<Self> {
        let number = u32::try_from(points.len())
            .map_err(|_| Error::Input { what: "points", reason: format!("{} are too many", points.len()) })?;
        let side = f64::from(radius) * MARGIN;
        let slots = (2 * points.len()).max(2).next_power_of_two();
        let firsts = vec![FREE; slots];
        let mut cells = Self { points, radius, side, members: Vec::new(), firsts };
        cells.members = (0..number).map(|index| (key(cells.cell(&points[index as usize])), index)).collect();
        cells.members.par_sort_unstable();
        for place in 0..number {
            let cell = cells.members[place as usize].0;
            if place == 0 || cells.members[place as usize - 1].0 != cell {
                let slot = cells.slot(cell);
                cells.firsts[slot] = place;
            }
        }
        Ok(cells)
    }

    /// The points.
    pub fn points(&self) -> &[Point] {
        self.points
    }

    /// The radius that is the width of the cells.
    pub fn radius(&self) -> f32 {
        self.radius
    }

    /// Calls `visit` with the index of each point at most `radius` from a position. The order depends only on the
    /// points.
    pub fn within(&self, position: &Point, radius: f32, mut visit: impl FnMut(usize)) {
        let [xs, ys, zs] = position.map(|value| self.reached(value, radius));
        for [y, z] in zs.flat_map(|z| ys.clone().map(move |y| [y, z])) {
            for cell in xs.clone().map(|x| key([x, y, z].map(number))) {
                let first = self.firsts[self.slot(cell)] as usize;
                let members = self.members.get(first..).unwrap_or_default();
                for &(_, index) in members.iter().take_while(|(other, _)| *other == cell) {
                    let other = &self.points[index as usize];
                    let [x, y, z]: Point = std::array::from_fn(|axis| position[axis] - other[axis]);
                    if x * x + y * y + z * z <= radius * radius {
                        visit(index as usize);
                    }
                }
            }
        }
    }

    /// The slot of a cell; it is free if the cell has no members.
    fn slot(&self, cell: u64) -> usize {
        // Fibonacci hashing (Knuth, The Art of Computer Programming 3, section 6.4).
        let hash = cell.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> (64 - self.firsts.len().ilog2());
        let mut slot = hash as usize;
        while self.members.get(self.firsts[slot] as usize).is_some_and(|(other, _)| *other != cell) {
            slot = (slot + 1) & (self.firsts.len() - 1);
        }
        slot
    }

    /// The number of a position's cell along x, y and z.
    fn cell(&self, position: &Point) -> [u64; 3] {
        position.map(|value| number(floor(f64::from(value) / self.side)))
    }

    /// The cells within a radius of a coordinate. Far from zero, where cells are finer than the steps of `f32`, equal coordinates have
    /// the same cell, and different ones are farther apart than the radius.
    fn reached(&self, value: f32, radius: f32) -> RangeInclusive<i64> {
        let [place, reach] = [f64::from(value), f64::from(radius) * MARGIN].map(|length| length / self.side);
        floor(place - reach)..=floor(place + reach)
    }
}

/// The largest integer that is at most `place`, saturated to the range of `i64`.
fn floor(place: f64) -> i64 {
    let whole = place as i64;
    if whole as f64 > place { whole.saturating_sub(1) } else { whole }
}

/// The number of a cell along an axis.
fn number(cell: i64) -> u64 {
    cell as u64 & LAST
}

/// The key of a cell.
fn key([x, y, z]: [u64; 3]) -> u64 {
    x | y << BITS | z << (2 * BITS)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn squared(a: &Point, b: &Point) -> f32 {
        let [x, y, z]: Point = std::array::from_fn(|axis| a[axis] - b[axis]);
        x * x + y * y + z * z
    }

    #[test]
    fn points_within_the_radius_are_those_of_the_plain_loop() {
        let at = |i: u32, k: u32| (i * k % 997) as f32 / 997.0;
        let random: Vec<Point> = (0..300).map(|i| [at(i, 131), at(i, 577), at(i, 883)]).collect();
        let lattice: Vec<Point> = (0..300_u16).map(|i| [i % 5, i / 5 % 5, i % 7].map(|v| 0.1 * f32::from(v))).collect();
        let far = vec![[3e38; 3], [-3e38; 3], [0.0; 3], [1e-40; 3], [0.05, 0.0, 0.0]];
        // Cells with the same number, and cells on both sides of the largest number.
        let period = 0.3 * (1.0 + 1e-6) * (LAST + 1) as f32;
        let same: Vec<Point> =
            (0..60).map(|i| [(i % 3 - 1) as f32 * period + 0.1 * i as f32, 0.05 * i as f32, period]).collect();
        for points in [random, lattice, far, same, vec![[1.0; 3]; 9], vec![]] {
            for radius in [1e-30, 0.1, 0.3, 5.0, 1e19] {
                let cells = RadiusCells::new(&points, radius).unwrap();
                for query in points.iter().chain(&[[0.5; 3], [-9.0, 0.0, 0.0], [3e38, 0.0, -3e38]]) {
                    for radius in [2.3 * radius.min(1e18), radius, 0.85 * radius, 0.5 * radius] {
                        let mut inside = Vec::new();
                        cells.within(query, radius, |index| inside.push(index));
                        inside.sort_unstable();
                        let is_near = |&index: &usize| squared(query, &points[index]) <= radius * radius;
                        assert_eq!(inside, (0..points.len()).filter(is_near).collect::<Vec<_>>(), "{query:?} {radius}");
                    }
                }
            }
        }
    }

    // This test would take a minute instead of a second if the far point made the cells wider.
    #[test]
    fn a_point_far_away_costs_no_time() {
        let at = |i: u32, factor: u32| (i.wrapping_mul(factor) >> 8) as f32 / (1 << 24) as f32;
        let mut points: Vec<Point> = (0..200_000).map(|i| [at(i, 2_654_435_761), at(i, 40_503), 0.0]).collect();
        points.push([1e7, -1e7, 1e7]);
        let cells = RadiusCells::new(&points, 0.002).unwrap();
        let mut number = 0;
        points.iter().for_each(|point| cells.within(point, 0.002, |_| number += 1));
        assert!((200_001..2_000_000).contains(&number), "{number}");
    }
}

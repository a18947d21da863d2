//! Points in cells as wide as a radius, for queries within it.

use rayon::prelude::*;

use crate::points::Point;
use crate::{Error, Result};
use snake_kernels::Scratch;

/// Bits of a cell's number along an axis. Cells so many steps apart have the same number, which costs time and no result.
const BITS: u64 = 21;

/// The largest number of a cell along an axis. After it comes 0.
const LAST: u64 = (1 << BITS) - 1;

/// Points sorted into cells that are as wide as a radius: a query looks at 27 cells.
///
/// Where the queries themselves are at least a share of the radius apart, as in suppression, each point is looked at a
/// bounded number of times, for every arrangement of points but those that make numbers of cells coincide.
pub(crate) struct RadiusCells<'a> {
    points: &'a [Point],
    side: f64,
    /// The cell and the index of each point, ascending.
    members: Scratch<(u64, u32)>,
}

impl<'a> RadiusCells<'a> {
    /// Sorts finite points for queries within at most `radius`, which is positive.
    ///
    /// # Errors
    /// [`Error::Input`] for more points than [`u32::MAX`].
    pub(crate) fn new(points: &'a [Point], radius: f32) -> Result<Self> {
        let number = u32::try_from(points.len())
            .map_err(|_| Error::Input { what: "points", reason: format!("{} are too many", points.len()) })?;
        // Distances in f32 are rounded: a point within the radius is at most this far.
        let side = f64::from(radius) * (1.0 + 1e-6);
        let mut cells = Self { points, side, members: Scratch::default() };
        let members = (0..number).map(|index| (key(cells.cell(&points[index as usize])), index));
        cells.members = Scratch::collect(points.len(), members);
        cells.members.par_sort_unstable();
        Ok(cells)
    }

    /// The points.
    pub(crate) fn points(&self) -> &[Point] {
        self.points
    }

    /// Calls `found` with the index of each point at most `radius` from a position, in an order that depends on the points
    /// alone. The radius is at most that of the cells.
    pub(crate) fn within(&self, position: &Point, radius: f32, mut found: impl FnMut(usize)) {
        let [[before, x, after], ys, zs] = self.cell(position).map(neighbors);
        // Neighbours along x follow each other, except at the last number.
        let one_run = [[before, after]];
        let three_runs = [[before; 2], [x; 2], [after; 2]];
        let runs = if before < after { &one_run[..] } else { &three_runs };
        for [y, z] in zs.into_iter().flat_map(|z| ys.map(|y| [y, z])) {
            for run in runs {
                let [first, last] = run.map(|x| key([x, y, z]));
                let start = self.members.partition_point(|(cell, _)| *cell < first);
                for &(_, index) in self.members[start..].iter().take_while(|(cell, _)| *cell <= last) {
                    let other = &self.points[index as usize];
                    let [x, y, z]: Point = std::array::from_fn(|axis| position[axis] - other[axis]);
                    if x * x + y * y + z * z <= radius * radius {
                        found(index as usize);
                    }
                }
            }
        }
    }

    /// The number of a position's cell along x, y and z. Far from zero, where cells are finer than `f32`, equal coordinates have
    /// the same cell, and others are farther apart than the radius.
    fn cell(&self, position: &Point) -> [u64; 3] {
        position.map(|value| (f64::from(value) / self.side).floor().rem_euclid((LAST + 1) as f64) as u64)
    }
}

/// The numbers of a cell and its neighbours along an axis.
fn neighbors(cell: u64) -> [u64; 3] {
    [cell.wrapping_sub(1) & LAST, cell, (cell + 1) & LAST]
}

/// One number for a cell. Neighbours along x follow each other.
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
        // Cells with the same number, and cells on both sides of the last number.
        let period = 0.3 * (1.0 + 1e-6) * (LAST + 1) as f32;
        let same: Vec<Point> =
            (0..60).map(|i| [(i % 3 - 1) as f32 * period + 0.1 * i as f32, 0.05 * i as f32, period]).collect();
        for points in [random, lattice, far, same, vec![[1.0; 3]; 9], vec![]] {
            for radius in [1e-30, 0.1, 0.3, 5.0, 1e19] {
                let cells = RadiusCells::new(&points, radius).unwrap();
                for query in points.iter().chain(&[[0.5; 3], [-9.0, 0.0, 0.0], [3e38, 0.0, -3e38]]) {
                    for radius in [radius, 0.5 * radius] {
                        let mut found = Vec::new();
                        cells.within(query, radius, |index| found.push(index));
                        found.sort_unstable();
                        let is_near = |&index: &usize| squared(query, &points[index]) <= radius * radius;
                        assert_eq!(found, (0..points.len()).filter(is_near).collect::<Vec<_>>(), "{query:?} {radius}");
                    }
                }
            }
        }
    }

    // This test would take a minute and not a second if the far point made the cells wider.
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

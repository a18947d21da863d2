//! Points in cells as wide as a radius, for queries within this radius.

use std::ops::RangeInclusive;

use super::cell_groups::{CellGroups, floor};
use crate::{Point, Result};

/// Distances in `f32` are rounded, so a point within the radius is at most this many radii away.
const MARGIN: f64 = 1.0 + 1e-6;

/// Points sorted into cells that are as wide as a radius. A query within this radius visits at most 27 cells; a query within another
/// radius visits more cells, or larger ones than it needs.
///
/// If the queries are at least a fixed share of the radius apart, as in suppression, each point is visited a bounded number
/// of times, for every arrangement of points.
pub struct RadiusCells<'a> {
    points: &'a [Point],
    radius: f32,
    side: f64,
    cells: CellGroups,
    /// The points, cell by cell.
    sorted: Vec<Point>,
}

impl<'a> RadiusCells<'a> {
    /// Sorts finite points for queries within about `radius`, which must be positive.
    ///
    /// # Errors
    /// [`Error::Input`](crate::Error::Input) for more points than [`u32::MAX`].
    pub fn new(points: &'a [Point], radius: f32) -> Result<Self> {
        let side = f64::from(radius) * MARGIN;
        let cell = |point: &Point| point.map(|value| floor(f64::from(value) / side));
        let cells = CellGroups::new(points.iter().map(cell))?;
        let sorted = cells.members().iter().map(|&index| points[index as usize]).collect();
        Ok(Self { points, radius, side, cells, sorted })
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
            for x in xs.clone() {
                let range = self.cells.range([x, y, z]);
                for (other, &index) in self.sorted[range.clone()].iter().zip(&self.cells.members()[range]) {
                    let [x, y, z]: Point = std::array::from_fn(|axis| position[axis] - other[axis]);
                    if x * x + y * y + z * z <= radius * radius {
                        visit(index as usize);
                    }
                }
            }
        }
    }

    /// The cells within a radius of a coordinate. Far from zero, where cells are finer than the steps of `f32`, equal coordinates have
    /// the same cell, and different ones are farther apart than the radius.
    fn reached(&self, value: f32, radius: f32) -> RangeInclusive<i64> {
        let [place, reach] = [f64::from(value), f64::from(radius) * MARGIN].map(|length| length / self.side);
        floor(place - reach)..=floor(place + reach)
    }
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
        for points in [random, lattice, far, vec![[1.0; 3]; 9], vec![]] {
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

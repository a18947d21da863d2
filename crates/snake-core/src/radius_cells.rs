//! Points in cells as wide as a radius, for queries within it.

use rayon::prelude::*;

use crate::points::Point;
use crate::{Error, Result};
use snake_kernels::Scratch;

/// Cells along an axis, at most; a cloud of greater extent has wider cells.
const MOST_CELLS: f64 = (1 << 20) as f64;

/// Bits of a cell's number along an axis.
const BITS: u64 = 21;

/// Points sorted into cells that are at least as wide as a radius: a query looks at 27 cells.
///
/// Where the queries themselves are at least a share of the radius apart, as in suppression, each point is looked at a
/// bounded number of times, for every arrangement of points.
pub(crate) struct RadiusCells<'a> {
    points: &'a [Point],
    corner: [f64; 3],
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
        let along = |axis: usize| points.iter().map(move |point| f64::from(point[axis]));
        let corner: [f64; 3] = std::array::from_fn(|axis| along(axis).fold(f64::INFINITY, f64::min));
        let end: [f64; 3] = std::array::from_fn(|axis| along(axis).fold(f64::NEG_INFINITY, f64::max));
        let extent = (0..3).map(|axis| end[axis] - corner[axis]).fold(0.0, f64::max);
        // Distances in f32 are rounded: a point within the radius is at most this far.
        let side = (f64::from(radius) * (1.0 + 1e-6)).max(extent / MOST_CELLS);
        let mut cells = Self { points, corner, side, members: Scratch::default() };
        let members = (0..number).map(|index| (key(cells.cell(&points[index as usize])), index));
        cells.members = Scratch::collect(points.len(), members);
        cells.members.par_sort_unstable();
        Ok(cells)
    }

    /// The points.
    pub(crate) fn points(&self) -> &[Point] {
        self.points
    }

    /// Calls `found` with the index of each point at most `radius` from a position, in no particular order. The radius is at
    /// most that of the cells.
    pub(crate) fn within(&self, position: &Point, radius: f32, mut found: impl FnMut(usize)) {
        let [x, y, z] = self.cell(position);
        for [y, z] in (z - 1..=z + 1).flat_map(|z| (y - 1..=y + 1).map(move |y| [y, z])) {
            let [first, last] = [x - 1, x + 1].map(|x| key([x, y, z]));
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

    /// The cell of a position along x, y and z, at least 1, so that there is one before it.
    fn cell(&self, position: &Point) -> [u64; 3] {
        std::array::from_fn(|axis| {
            let cells = (f64::from(position[axis]) - self.corner[axis]) / self.side;
            (cells.clamp(-1.0, MOST_CELLS).floor() + 2.0) as u64
        })
    }
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
        for points in [random, lattice, far, vec![[1.0; 3]; 9], vec![]] {
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
}

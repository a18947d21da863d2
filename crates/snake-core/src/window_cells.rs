//! A lattice of cells over a large cloud, which gives the centres of its windows and the points in each window.

use std::collections::{BTreeMap, HashSet};

use crate::points::Point;

/// Side of the cells, in units of a window's radius: every query lies well inside its window.
pub(crate) const SPACING: f32 = 0.8;

/// Number of cells that a window can reach beyond the cell of its centre, along each axis: 1 / 0.8 rounded up.
pub(crate) const REACH: i128 = 2;

/// A cell of the lattice, by its number along x, y and z.
pub(crate) type Cell = [i128; 3];

/// The points of a cloud grouped by cells, in four bytes per point. Each cell has a window.
pub(crate) struct WindowCells<'a> {
    points: &'a [Point],
    radius: f32,
    /// The occupied cells, ascending.
    cells: Vec<Cell>,
    /// The start of each cell in `members`, and the end.
    starts: Vec<usize>,
    /// Indices of points, cell by cell, ascending within a cell.
    members: Vec<u32>,
    /// The mean of the points of each cell.
    pub(crate) centers: Vec<Point>,
}

impl<'a> WindowCells<'a> {
    /// Groups finite points, at most [`u32::MAX`], for windows of `radius`.
    pub(crate) fn new(points: &'a [Point], radius: f32) -> Self {
        let mut sums: BTreeMap<Cell, ([f64; 3], usize)> = BTreeMap::new();
        for point in points {
            let (sum, number) = sums.entry(cell(point, radius)).or_default();
            sum.iter_mut().zip(point).for_each(|(sum, &v)| *sum += f64::from(v));
            *number += 1;
        }
        let mean = |(sum, number): &([f64; 3], usize)| sum.map(|v| (v / *number as f64) as f32);
        let centers = sums.values().map(mean).collect();
        let mut starts = vec![0];
        starts.extend(sums.values().scan(0, |end, (_, number)| {
            *end += number;
            Some(*end)
        }));
        let cells: Vec<Cell> = sums.into_keys().collect();
        let mut next = starts.clone();
        let mut members = vec![0; points.len()];
        for (index, point) in (0..).zip(points) {
            let number = cells.partition_point(|other| *other < cell(point, radius));
            members[next[number]] = index;
            next[number] += 1;
        }
        Self { points, radius, cells, starts, members, centers }
    }

    /// The points of a window, at most the radius from its centre, in the order of the cloud.
    pub(crate) fn points_of(&self, window: usize) -> Vec<Point> {
        let center = self.centers[window];
        let [x, y, z] = cell(&center, self.radius);
        let mut inside: Vec<u32> = Vec::new();
        for x in x - REACH..=x + REACH {
            for y in y - REACH..=y + REACH {
                // The cells of a column are contiguous.
                let [first, end] = [z - REACH, z + REACH + 1].map(|z| self.cells.partition_point(|c| *c < [x, y, z]));
                let members = &self.members[self.starts[first]..self.starts[end]];
                inside.extend(members.iter().filter(|&&index| self.is_inside(&center, index)));
            }
        }
        inside.sort_unstable();
        inside.into_iter().map(|index| self.points[index as usize]).collect()
    }

    fn is_inside(&self, center: &Point, index: u32) -> bool {
        let [x, y, z]: Point = std::array::from_fn(|axis| center[axis] - self.points[index as usize][axis]);
        x * x + y * y + z * z <= self.radius * self.radius
    }
}

/// Whether more than `most` windows of `radius` cover the points.
pub(crate) fn has_more_windows(points: &[Point], radius: f32, most: usize) -> bool {
    let mut cells = HashSet::new();
    points.iter().any(|point| cells.insert(cell(point, radius)) && cells.len() > most)
}

/// The cell of a point.
pub(crate) fn cell(point: &Point, radius: f32) -> Cell {
    let side = f64::from(SPACING * radius);
    point.map(|v| (f64::from(v) / side).floor() as i128)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A plate with a ridge, at `offset`.
    fn points(offset: f32) -> Vec<Point> {
        (0..4000)
            .map(|i| [(i % 80) as f32 * 0.05, (i / 80) as f32 * 0.05, ((i % 7) as f32).max(5.0) * 0.1])
            .map(|p| p.map(|v| v + offset))
            .collect()
    }

    #[test]
    fn the_points_of_a_window_are_those_within_its_radius() {
        for (offset, radius) in [(0.0, 0.3), (-7.3, 0.05), (1e5, 0.4), (0.0, 100.0), (2.0, 1e-9)] {
            let points = points(offset);
            let cells = WindowCells::new(&points, radius);
            let number = cells.centers.len();
            assert!(!has_more_windows(&points, radius, number) && has_more_windows(&points, radius, number - 1));
            for window in (0..cells.centers.len()).step_by(17) {
                let center = cells.centers[window];
                let squared = |p: &Point| (0..3).map(|axis| (center[axis] - p[axis]).powi(2)).sum::<f32>();
                let expected: Vec<Point> = points.iter().filter(|p| squared(p) <= radius * radius).copied().collect();
                assert_eq!(cells.points_of(window), expected, "{offset} {radius} {window}");
            }
        }
    }

    #[test]
    fn every_point_lies_well_inside_a_window() {
        let points = points(0.0);
        let centers = WindowCells::new(&points, 1.0).centers;
        assert!((16..60).contains(&centers.len()), "{}", centers.len());
        let nearest = |p: &Point| {
            let distance = |m: &Point| (0..3).map(|axis| (m[axis] - p[axis]).powi(2)).sum::<f32>().sqrt();
            centers.iter().map(distance).fold(f32::INFINITY, f32::min)
        };
        assert!(points.iter().map(nearest).fold(0.0, f32::max) < 0.75);
    }
}

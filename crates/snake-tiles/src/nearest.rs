//! The nearest point of each keypoint.

use std::collections::BTreeMap;
use std::ops::Range;

use snake_core::space::nearest_points;
use snake_core::{Control, Point};

use crate::Result;
use crate::run::{TiledRun, widen};

impl TiledRun {
    /// The index of the nearest point of all files for each position; the lowest index among equally near points.
    pub(crate) fn nearest(&self, positions: &[Point], control: &Control) -> Result<Vec<u64>> {
        let mut by_place: BTreeMap<[i32; 2], Vec<usize>> = BTreeMap::new();
        for (index, position) in positions.iter().enumerate() {
            by_place.entry(self.plan.place(self.detector.cell(position)?)).or_default().push(index);
        }
        let counter = control.begin("nearest points", by_place.len());
        let mut nearest = vec![0; positions.len()];
        for (place, mut open) in by_place {
            counter.check()?;
            let mut margin = self.detector.halo();
            // A point beyond the columns may be nearer, or none may be in them.
            while !open.is_empty() {
                let columns = widen(&self.plan.columns(place), margin);
                let (points, indices) = self.points(&columns)?;
                let is_whole = self.plan.is_inside(&columns);
                let queries: Vec<Point> = open.iter().map(|&index| positions[index]).collect();
                let found = if points.is_empty() { Vec::new() } else { nearest_points(&points, &queries)? };
                let mut is_known = vec![false; open.len()];
                for (rank, &point) in found.iter().enumerate() {
                    nearest[open[rank]] = indices[point];
                    is_known[rank] = is_whole || self.is_inside(&queries[rank], &points[point], &columns);
                }
                let mut is_known = is_known.into_iter();
                open.retain(|_| is_known.next() == Some(false));
                margin = margin.saturating_mul(2);
            }
            counter.add(1);
        }
        Ok(nearest)
    }

    /// Whether all points that are as near as the found one lie in the columns.
    fn is_inside(&self, query: &Point, found: &Point, columns: &[Range<i32>; 2]) -> bool {
        let distance = (0..3).map(|axis| f64::from(query[axis] - found[axis]).powi(2)).sum::<f64>().sqrt();
        let reach = distance * (1.0 + 1e-5);
        (0..2).all(|axis| {
            let [low, high] =
                [columns[axis].start, columns[axis].end].map(|c| f64::from(c) * self.detector.cell_side());
            let at = f64::from(query[axis]);
            at - reach > low && at + reach < high
        })
    }
}

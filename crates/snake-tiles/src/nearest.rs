//! The nearest point of each keypoint, and the distance of each point to its nearest other point.

use std::collections::BTreeMap;
use std::ops::Range;

use snake_core::Control;
use snake_geometry::{Point, gaps, nearest_points};

use crate::Result;
use crate::run::{TiledRun, widen};

impl TiledRun {
    /// For each position, the index of the nearest point of all files; among equally near points, the lowest index.
    pub(crate) fn nearest(&self, positions: &[Point], control: &Control) -> Result<Vec<u64>> {
        let mut by_place: BTreeMap<[i32; 2], Vec<usize>> = BTreeMap::new();
        for (index, position) in positions.iter().enumerate() {
            by_place.entry(self.plan.place(self.detector.column(position)?)).or_default().push(index);
        }
        let counter = control.begin("nearest points", by_place.len());
        let mut nearest = vec![0; positions.len()];
        for (place, mut open) in by_place {
            counter.check()?;
            let mut margin = 1;
            // A point outside the columns may be nearer, or the columns may contain no point.
            while !open.is_empty() {
                let columns = widen(&self.plan.columns(place), margin);
                let (points, indices) = self.points(&columns)?;
                let is_whole = self.plan.is_inside(&columns);
                let queries: Vec<Point> = open.iter().map(|&index| positions[index]).collect();
                let nearest_indices = if points.is_empty() { Vec::new() } else { nearest_points(&points, &queries)? };
                let mut is_known = vec![false; open.len()];
                for (rank, &point) in nearest_indices.iter().enumerate() {
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

    /// The mean distance of the distinct points of all tiles to their nearest other point. This is the cloud's
    /// [`snake_geometry::resolution`] if it has no outliers.
    pub(crate) fn resolution(&self) -> Result<f64> {
        let (mut sum, mut number) = (0.0, 0_u32);
        for tile in self.tiles() {
            let own = self.plan.columns(tile.place);
            let (mut margin, mut known) = (1, None);
            while known.is_none() {
                let columns = widen(&own, margin);
                let (points, _) = self.points(&columns)?;
                let is_whole = self.plan.is_inside(&columns);
                let is_own = |(point, _): &(Point, f64)| self.detector.is_in(point, &own);
                let own: Vec<(Point, f64)> = gaps(&points)?.into_iter().filter(is_own).collect();
                let is_known = |(point, gap): &(Point, f64)| is_whole || self.detector.is_inside(point, *gap, &columns);
                known = own.iter().all(is_known).then_some(own);
                margin = margin.saturating_mul(2);
            }
            for (_, gap) in known.into_iter().flatten().filter(|(_, gap)| gap.is_finite()) {
                sum += gap;
                number += 1;
            }
        }
        Ok(if number > 0 { sum / f64::from(number) } else { 0.0 })
    }

    /// Whether all points that are as near as the one found lie in the columns.
    fn is_inside(&self, query: &Point, found: &Point, columns: &[Range<i32>; 2]) -> bool {
        let distance = (0..3).map(|axis| f64::from(query[axis] - found[axis]).powi(2)).sum::<f64>().sqrt();
        self.detector.is_inside(query, distance * (1.0 + 1e-5), columns)
    }
}

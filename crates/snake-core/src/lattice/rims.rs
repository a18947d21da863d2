//! Rims: where the seen surface ends, at the border of a crop, at the edge of an image or beside an occluding object.
//!
//! The network sees less of a surface at its rim and mistakes it for a corner. A cell lies on a rim if the cells around it are
//! nearly planar and lie on one side of it. At an edge or a corner, another face lies on the other side. The points cannot show
//! whether an object really ends there: scores at the free edge of a board are lowered too, and only its strongest corners
//! survive.

use nalgebra::{Matrix3, Vector3};
use snake_geometry::{Point, RadiusCells, eigen, in_parallel};

use super::queries::Refined;
use crate::Result;

/// Cells within this distance of a cell, in voxels, are its neighbours.
const NEIGHBOURHOOD: f32 = 3.0;
/// Minimum distance along the plane, in voxels, between a cell on a rim and the mean of its neighbours. The mean of half a disc
/// lies 1.27 voxels from the centre.
const MIN_OFFSET: f64 = 0.75;
/// Maximum variance across the plane, as a share of the smaller one along it.
const MAX_THICKNESS: f64 = 0.3;
/// Minimum of the smaller variance along the plane, as a share of the larger one: a pole or a ring of a sweep has no rim.
const MIN_WIDTH: f64 = 0.1;
/// Scores are lowered within this distance of a cell on a rim, in voxels.
const DISTANCE: f32 = 1.5;
/// Factor of the scores near a rim.
const SHARE: f32 = 0.6;
/// Offsets are rounded to 1 / `STEPS` voxels, because sums of integers do not depend on their order.
const STEPS: f32 = 256.0;

/// Lowers the scores of queries near a rim. `cells` are the mean points of all occupied cells. All positions are in
/// voxels.
pub(super) fn lower_rims(refined: &mut [Refined], cells: &[Point]) -> Result<()> {
    let around = RadiusCells::new(cells, NEIGHBOURHOOD)?;
    let mut is_asked = vec![false; cells.len()];
    for query in refined.iter().filter(|query| query.score > 0.0) {
        around.within(&query.position, DISTANCE, |cell| is_asked[cell] = true);
    }
    let is_on_rim = in_parallel(0..cells.len(), |cell| is_asked[cell] && is_on_rim(&around, cell));
    let lowered = in_parallel(refined.iter(), |query| {
        let mut is_near = false;
        if query.score > 0.0 {
            around.within(&query.position, DISTANCE, |cell| is_near |= is_on_rim[cell]);
        }
        if is_near { SHARE * query.score } else { query.score }
    });
    refined.iter_mut().zip(lowered).for_each(|(query, score)| query.score = score);
    Ok(())
}

fn is_on_rim(around: &RadiusCells, cell: usize) -> bool {
    let center = around.points()[cell];
    let (mut number, mut sum, mut products) = (0_i64, [0_i64; 3], [[0_i64; 3]; 3]);
    around.within(&center, NEIGHBOURHOOD, |other| {
        let offset: [i64; 3] =
            std::array::from_fn(|axis| ((around.points()[other][axis] - center[axis]) * STEPS).round() as i64);
        number += 1;
        for (axis, row) in products.iter_mut().enumerate() {
            sum[axis] += offset[axis];
            row.iter_mut().zip(offset).for_each(|(product, value)| *product += offset[axis] * value);
        }
    });
    let number = number as f64;
    let mean = Vector3::from(sum.map(|sum| sum as f64 / number / f64::from(STEPS)));
    let second = Matrix3::from_fn(|row, column| products[row][column] as f64 / number / f64::from(STEPS).powi(2));
    let ([across, narrow, wide], normal) = eigen(second - mean * mean.transpose());
    let is_flat = across < MAX_THICKNESS * narrow && narrow > MIN_WIDTH * wide;
    is_flat && (mean - normal * normal.dot(&mean)).norm() > MIN_OFFSET
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two numbers of queries at cells whose score stays: of all, and of those whose position `is_asked` accepts.
    fn left(cells: &[Point], is_asked: impl Fn(&Point) -> bool) -> [usize; 2] {
        let mut refined: Vec<Refined> = cells.iter().map(|&position| Refined { position, score: 0.5 }).collect();
        lower_rims(&mut refined, cells).unwrap();
        let asked = || refined.iter().filter(|query| is_asked(&query.position));
        [asked().filter(|query| query.score == 0.5).count(), asked().count()]
    }

    fn square(n: i32, place: impl Fn(f32, f32) -> Point) -> Vec<Point> {
        (0..n * n).map(|i| place((i % n) as f32 + 0.5, (i / n) as f32 + 0.5)).collect()
    }

    #[test]
    fn a_sheet_has_lower_scores_along_its_rim_and_kept_within() {
        type Sheet = fn(f32, f32) -> Point;
        let sheets: [Sheet; 3] = [|x, y| [x, y, 0.3], |x, y| [x, 0.5, y], |x, y| [x, y, 0.5 * x]];
        for (sheet, second) in sheets.into_iter().zip([1, 2, 1]) {
            let sheet = square(24, sheet);
            let rim = |p: &Point| p[0] < 1.0 || p[0] > 23.0;
            let within = |p: &Point| (6.0..18.0).contains(&p[0]) && (6.0..18.0).contains(&p[second]);
            assert_eq!(left(&sheet, rim)[0], 0);
            let [kept, all] = left(&sheet, within);
            assert!(kept == all && all > 50);
        }
    }

    #[test]
    fn edges_corners_and_lines_keep_their_queries() {
        let faces = [|x, y| [x, y, 0.5], |x, y| [x, 0.5, y], |x, y| [0.5, x, y]];
        let corner: Vec<Point> = faces.into_iter().flat_map(|face| square(20, face)).collect();
        let [kept, all] = left(&corner, |p| p.iter().all(|&v| v < 8.0));
        assert!(kept == all && all > 100);
        let pole: Vec<Point> = (0..20).map(|i| [0.5, 0.5, i as f32 + 0.5]).collect();
        assert_eq!(left(&pole, |_| true), [20, 20]);
    }

    #[test]
    fn few_cells_or_none_have_no_rims() {
        assert_eq!(left(&[], |_| true), [0, 0]);
        assert_eq!(left(&[[0.5; 3]], |_| true), [1, 1]);
        assert_eq!(left(&[[0.5; 3], [1.5, 0.5, 0.5]], |_| true), [2, 2]);
    }
}

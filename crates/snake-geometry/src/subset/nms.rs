//! Non-maximum suppression by radius, and nearest input points.

use std::collections::HashSet;

use rayon::prelude::*;

use crate::{KdTree, Point, PointTree, RadiusCells, Result, in_parallel};
use snake_kernels::SimdLevel;

/// Greedy non-maximum suppression. Returns the indices of the kept points, best first; each is farther than `radius` from
/// all earlier ones.
///
/// Points are processed in order of falling score and, for equal scores, of rising index. At most `limit` are kept.
/// A radius of 0 suppresses only by `limit`.
pub fn suppress(points: &[Point], scores: &[f32], radius: f32, limit: usize) -> Result<Vec<usize>> {
    suppress_in_order(points, by_falling_score(scores), radius, limit)
}

/// Greedy non-maximum suppression of points `(N, 3)` that are sorted best first. Returns the indices of the kept points,
/// in the same order; each is farther than `radius` from all earlier ones.
///
/// At most `limit` are kept. A radius of 0 suppresses only by `limit`.
///
/// # Errors
/// [`Error::Input`](crate::Error::Input) for more points than [`u32::MAX`]. The points must be finite.
pub fn suppress_ranked(points: &[Point], radius: f32, limit: usize) -> Result<Vec<usize>> {
    suppress_in_order(points, (0..points.len()).collect(), radius, limit)
}

fn suppress_in_order(points: &[Point], mut order: Vec<usize>, radius: f32, limit: usize) -> Result<Vec<usize>> {
    if radius <= 0.0 || points.is_empty() {
        order.truncate(limit);
        return Ok(order);
    }
    let cells = RadiusCells::new(points, radius)?;
    Ok(keep_in_order(&cells, &order, cells.radius(), limit))
}

/// Indices in order of falling score and, for equal scores, of rising index.
pub fn by_falling_score(scores: &[f32]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..scores.len()).collect();
    order.sort_unstable_by(|&a, &b| scores[b].total_cmp(&scores[a]).then(a.cmp(&b)));
    order
}

/// The points of `order` that suppression keeps, with a radius of at most that of the cells.
pub fn keep_in_order(cells: &RadiusCells, order: &[usize], radius: f32, limit: usize) -> Vec<usize> {
    keep_apart(order, limit, |index, found| cells.within(&cells.points()[index], radius, found))
}

/// The points of `order` that suppression keeps. `within(index, visit)` must call `visit` with each
/// point within the radius of point `index`.
pub fn keep_apart(order: &[usize], limit: usize, within: impl Fn(usize, &mut dyn FnMut(usize))) -> Vec<usize> {
    let mut suppressed = vec![false; order.len()];
    let mut kept = Vec::with_capacity(limit.min(order.len()));
    for &index in order {
        if kept.len() == limit {
            break;
        }
        if !suppressed[index] {
            kept.push(index);
            within(index, &mut |other| suppressed[other] = true);
        }
    }
    kept
}

/// What greedy suppression does with a candidate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fate {
    /// It is a keypoint.
    Kept,
    /// A kept candidate of higher rank lies within the radius.
    Suppressed,
    /// It depends on candidates that are not known.
    Unknown,
}

/// Greedy non-maximum suppression if only a part of a cloud is known. The points `(N, 3)` are sorted best first. Returns the
/// fate of each point in the suppression of the whole cloud.
///
/// `sees_all` says whether the known points include all points of the whole cloud within the radius of a point. A fate is
/// known if it follows from such points alone.
pub fn suppress_seen(points: &[Point], radius: f32, sees_all: impl Fn(usize) -> bool) -> Result<Vec<Fate>> {
    if radius <= 0.0 {
        return Ok(vec![Fate::Kept; points.len()]);
    }
    let tree = KdTree::new(points)?;
    let mut fates = vec![None; points.len()];
    // All points of a cell are within the radius of each other, so a point of unknown fate makes those of
    // lower rank unknown. Candidates are dense: without cells, each of them would visit thousands of others.
    let cell = |point: Point| point.map(|value| (f64::from(value) / (0.57 * f64::from(radius))).floor() as i64);
    let mut unknown_cells = HashSet::new();
    let mut near = Vec::new();
    for index in 0..points.len() {
        if fates[index].is_some() {
            continue;
        }
        near.clear();
        let is_known = sees_all(index) && !unknown_cells.contains(&cell(points[index])) && {
            tree.within(&points[index], radius * radius, |other, _| near.push(other));
            near.iter().all(|&other| fates[other] != Some(Fate::Unknown))
        };
        if is_known {
            near.iter().filter(|&&other| other > index).for_each(|&other| fates[other] = Some(Fate::Suppressed));
            fates[index] = Some(Fate::Kept);
        } else {
            fates[index] = Some(Fate::Unknown);
            unknown_cells.insert(cell(points[index]));
        }
    }
    Ok(fates.into_iter().map(|fate| fate.unwrap_or(Fate::Unknown)).collect())
}

/// Index of the nearest point `(N, 3)` for each query `(M, 3)`; the lowest index among equally near points.
pub fn nearest_points(points: &[Point], queries: &[Point]) -> Result<Vec<usize>> {
    // For a few hundred queries a linear search is faster than building a tree.
    if queries.len() < 256 {
        return Ok(in_parallel(queries.iter(), |&query| nearest_of_all(points, query)));
    }
    let mut nearest = vec![(f32::INFINITY, 0); queries.len()];
    for (number, points) in points.chunks(TREE_POINTS).enumerate() {
        let tree = PointTree::new(points)?;
        nearest.par_iter_mut().zip(queries).for_each(|(nearest, query)| {
            let (distance, index) = tree.nearest(query, None);
            if distance < nearest.0 {
                *nearest = (distance, number * TREE_POINTS + index);
            }
        });
    }
    Ok(nearest.into_iter().map(|(_, index)| index).collect())
}

/// Points per tree. Large clouds are searched with several trees, one at a time, to save memory.
const TREE_POINTS: usize = 1 << 16;

fn nearest_of_all(points: &[Point], query: Point) -> usize {
    let mut best = 0;
    snake_kernels::nearest_row(SimdLevel::current(), points, query, &mut best);
    best
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::near::hard_clouds::scattered;

    fn squared_distance(a: Point, b: Point) -> f32 {
        (0..3).map(|axis| (a[axis] - b[axis]).powi(2)).sum()
    }

    /// Suppression in the given order, with one structure for neighbours.
    type Suppression = fn(&[Point], &[usize], f32, usize) -> Vec<usize>;

    /// The plain definition, and the structures that must equal it: kiddo's tree, and the cells that detection uses.
    const SUPPRESSIONS: [(&str, Suppression); 2] = [
        ("tree", |points, order, radius, limit| {
            let tree = KdTree::new(points).unwrap();
            let within = |index: usize, found: &mut dyn FnMut(usize)| {
                tree.within(&points[index], radius * radius, |other, _| found(other));
            };
            keep_apart(order, limit, within)
        }),
        ("cells", |points, order, radius, limit| {
            keep_in_order(&RadiusCells::new(points, radius).unwrap(), order, radius, limit)
        }),
    ];

    fn plain(points: &[Point], order: &[usize], radius: f32, limit: usize) -> Vec<usize> {
        let mut kept: Vec<usize> = Vec::new();
        for &i in order {
            let is_free = kept.iter().all(|&k| squared_distance(points[i], points[k]) > radius * radius);
            if is_free && kept.len() < limit {
                kept.push(i);
            }
        }
        kept
    }

    #[test]
    fn every_suppression_equals_the_quadratic_loop_and_respects_ties() {
        let lattice = |i: u32| std::array::from_fn(|axis| (i * [7, 13, 29][axis] % 17) as f32 * 0.1);
        let random = |i: u32| std::array::from_fn(|axis| scattered(i, axis) * 1e-4);
        let clouds: [Vec<Point>; 7] = [
            (0..400).map(lattice).collect(),
            (0..400).map(random).collect(),
            (0..400).map(|i| [0.0, random(i)[0], 0.0]).collect(),
            (0..400).map(|i| if i % 3 == 0 { [1.0; 3] } else { random(i) }).collect(),
            (0..400).map(|i| if i % 50 == 0 { [1e7, -1e7, 1e7] } else { random(i) }).collect(),
            vec![[1.0; 3]; 9],
            vec![],
        ];
        for (number, points) in clouds.iter().enumerate() {
            let scores: Vec<f32> = (0..points.len() as u32).map(|i| (i * 31 % 23) as f32).collect();
            let mut order: Vec<usize> = (0..points.len()).collect();
            order.sort_by(|&a, &b| scores[b].total_cmp(&scores[a]).then(a.cmp(&b)));
            for (radius, limit) in [(1e-20, 400), (0.1, 400), (0.15, 400), (0.2, 400), (0.5, 7), (9.0, 3), (0.1, 0)] {
                let expected = plain(points, &order, radius, limit);
                for (name, suppression) in SUPPRESSIONS {
                    let kept = suppression(points, &order, radius, limit);
                    assert_eq!(kept, expected, "{name}: cloud {number}, radius {radius}");
                }
                assert_eq!(suppress(points, &scores, radius, limit).unwrap(), expected);
                let ranked: Vec<Point> = order.iter().map(|&index| points[index]).collect();
                let kept = suppress_ranked(&ranked, radius, limit).unwrap();
                assert!(kept.into_iter().map(|rank| order[rank]).eq(expected));
            }
            assert_eq!(suppress(points, &scores, 0.0, 5).unwrap()[..], order[..order.len().min(5)]);
        }
    }

    #[test]
    fn fates_of_a_part_are_those_of_the_whole() {
        let at = |i: u32, factor: u32| (i * factor % 997) as f32 / 100.0;
        let points: Vec<Point> = (0..900).map(|i| [at(i, 131), at(i, 577), 0.0]).collect();
        let kept = suppress_ranked(&points, 0.4, 900).unwrap();
        let all = suppress_seen(&points, 0.4, |_| true).unwrap();
        assert!(all.iter().enumerate().all(|(i, fate)| (*fate == Fate::Kept) == kept.contains(&i)));
        assert!(!all.contains(&Fate::Unknown));
        for high in [5.0, 8.0] {
            let part: Vec<usize> = (0..900).filter(|&i| points[i][0] < high).collect();
            let positions: Vec<Point> = part.iter().map(|&i| points[i]).collect();
            let fates = suppress_seen(&positions, 0.4, |rank| positions[rank][0] + 0.4001 < high).unwrap();
            let known = part.iter().zip(&fates).filter(|(_, fate)| **fate != Fate::Unknown);
            assert!(known.clone().all(|(&i, fate)| *fate == all[i]));
            // Not all fates at the border are known.
            assert!((part.len() / 10..part.len()).contains(&known.count()));
        }
    }

    #[test]
    fn fates_of_crowded_points_equal_the_quadratic_loop() {
        let at = |i: u32, factor: u32| (i.wrapping_mul(factor) >> 8) as f32 / (1 << 24) as f32;
        let points: Vec<Point> = (0..1500).map(|i| [2_654_435_761, 0x9e37_79b1, 40_503].map(|f| at(i, f))).collect();
        let radius = 0.3_f32;
        let sees_all = |index: usize| points[index][0] > 0.1;
        let mut expected: Vec<Fate> = Vec::new();
        for index in 0..points.len() {
            let is_near = |&other: &usize| squared_distance(points[other], points[index]) <= radius * radius;
            let near: Vec<Fate> = (0..index).filter(is_near).map(|other| expected[other]).collect();
            expected.push(if near.contains(&Fate::Kept) {
                Fate::Suppressed
            } else if sees_all(index) && !near.contains(&Fate::Unknown) {
                Fate::Kept
            } else {
                Fate::Unknown
            });
        }
        for fate in [Fate::Kept, Fate::Suppressed, Fate::Unknown] {
            assert!(expected.contains(&fate));
        }
        assert_eq!(suppress_seen(&points, radius, sees_all).unwrap(), expected);
    }

    #[test]
    fn the_nearest_of_equal_points_is_the_first() {
        let points = [[1.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [-1.0, 0.0, 0.0]];
        let queries = [[0.1, 0.0, 0.0], [0.0, 0.0, 0.0], [0.5, 0.0, 0.0]];
        assert_eq!(nearest_points(&points, &queries).unwrap(), [1, 1, 0]);
        assert_eq!(nearest_points(&points, &queries.repeat(100)).unwrap(), [1, 1, 0].repeat(100));
    }

    #[test]
    fn the_tree_and_the_scan_find_the_same_point() {
        let point = |i: u32| std::array::from_fn(|axis| scattered(i, axis));
        // With this many points, several trees have equally near points.
        let points: Vec<Point> = (0..2 * TREE_POINTS as u32 + 1000).map(point).collect();
        let queries: Vec<Point> = (5000..5300).map(point).collect();
        let scanned: Vec<usize> = queries.iter().map(|&query| nearest_of_all(&points, query)).collect();
        assert_eq!(nearest_points(&points, &queries).unwrap(), scanned);
    }
}

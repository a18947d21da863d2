//! Non-maximum suppression by radius, and nearest input points.

use kiddo::{ImmutableKdTree, SquaredEuclidean};

use crate::points::Point;
use crate::{Error, Result};

/// Greedy suppression: indices of the kept points, best first, each farther than `radius` from all kept before it.
///
/// Points are taken by falling score; of equal scores the lower index comes first. At most `limit` are kept.
/// A radius of 0 suppresses only by `limit`.
pub(crate) fn suppress(points: &[Point], scores: &[f32], radius: f32, limit: usize) -> Result<Vec<usize>> {
    let mut order: Vec<usize> = (0..points.len()).collect();
    order.sort_by(|&a, &b| scores[b].total_cmp(&scores[a]).then(a.cmp(&b)));
    if radius <= 0.0 || points.is_empty() {
        order.truncate(limit);
        return Ok(order);
    }
    let tree = NearestPoints::new(points)?;
    let mut alive = vec![true; points.len()];
    let mut kept = Vec::new();
    for index in order {
        if kept.len() == limit {
            break;
        }
        if alive[index] {
            kept.push(index);
            tree.within(points[index], radius * radius).for_each(|other| alive[other] = false);
        }
    }
    Ok(kept)
}

/// A k-d tree over points that answers with ties resolved to the lowest index.
pub(crate) struct NearestPoints(ImmutableKdTree<f32, 3>);

impl NearestPoints {
    pub(crate) fn new(points: &[Point]) -> Result<Self> {
        let tree = ImmutableKdTree::new_from_slice(points)
            .map_err(|e| Error::Input { what: "points", reason: format!("cannot be indexed: {e}") })?;
        Ok(Self(tree))
    }

    /// Index of the point nearest to `query`; of equally near ones the lowest.
    pub(crate) fn nearest(&self, query: Point) -> usize {
        let nearest = self.0.query(&query).nearest_one::<SquaredEuclidean<f32>>().execute();
        // The tree returns equally near points in no particular order.
        self.within(query, nearest.distance).min().unwrap_or(nearest.item as usize)
    }

    fn within(&self, query: Point, squared_radius: f32) -> impl Iterator<Item = usize> {
        let found = self.0.query(&query).within::<SquaredEuclidean<f32>>(squared_radius).unsorted().execute();
        found.into_iter().map(|entry| entry.item as usize)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn squared_distance(a: Point, b: Point) -> f32 {
        (0..3).map(|axis| (a[axis] - b[axis]).powi(2)).sum()
    }

    #[test]
    fn equals_the_quadratic_loop_and_respects_ties() {
        let points: Vec<Point> =
            (0_u32..400).map(|i| std::array::from_fn(|axis| (i * [7, 13, 29][axis] % 17) as f32 * 0.1)).collect();
        let scores: Vec<f32> = (0_u32..400).map(|i| (i * 31 % 23) as f32).collect();
        for (radius, limit) in [(0.0, 5), (0.1, 400), (0.15, 400), (0.5, 7), (9.0, 3)] {
            let mut order: Vec<usize> = (0..400).collect();
            order.sort_by(|&a, &b| scores[b].total_cmp(&scores[a]).then(a.cmp(&b)));
            let mut expected: Vec<usize> = Vec::new();
            for i in order {
                let free =
                    expected.iter().all(|&k| radius == 0.0 || squared_distance(points[i], points[k]) > radius * radius);
                if free && expected.len() < limit {
                    expected.push(i);
                }
            }
            assert_eq!(suppress(&points, &scores, radius, limit).unwrap(), expected, "radius {radius}");
        }
    }

    #[test]
    fn the_nearest_of_equal_points_is_the_first() {
        let points = [[1.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [-1.0, 0.0, 0.0]];
        let nearest = NearestPoints::new(&points).unwrap();
        assert_eq!(nearest.nearest([0.1, 0.0, 0.0]), 1);
        assert_eq!(nearest.nearest([0.0, 0.0, 0.0]), 1);
        assert_eq!(nearest.nearest([0.5, 0.0, 0.0]), 0);
    }
}

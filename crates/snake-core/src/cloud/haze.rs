//! Haze: points in the air around a scene, as in splats and dense reconstructions from photographs.

use super::quantile;
use snake_geometry::{Point, PointTree, drawn};

/// Number of points that are measured.
const MEASURED: usize = 512;
/// An isolated point is more than this many median distances from its nearest neighbour. In sweeps, 4 % of the points are.
const ALONE: f64 = 3.0;
/// Smallest share of isolated points in a haze.
const MIN_SHARE: f64 = 0.08;
/// Smallest dimension d of a haze: within twice the distance there are 2^d times as many neighbours. Surfaces have at most
/// 1.9, even if they are sparse, and hazes 2.4 to 2.7.
const MIN_DIMENSION: f64 = 2.2;

/// The share of isolated points of a cloud `(N, 3)`; `None` if they are few, or do not fill space but form a sparse surface.
pub(super) fn haze(points: &[Point]) -> Option<f64> {
    let measured: Vec<Point> = drawn(points, MEASURED);
    let spacings = spacings(&measured);
    let usual = quantile(spacings.clone(), 0.5);
    let alone = measured.iter().zip(&spacings).filter(|(_, spacing)| **spacing > ALONE * usual);
    let alone: Vec<Point> = alone.map(|(point, _)| *point).collect();
    let share = alone.len() as f64 / measured.len() as f64;
    if share < MIN_SHARE || measured.len() < MEASURED / 2 {
        return None;
    }
    let radius = 2.0 * quantile(self::spacings(&alone), 0.5);
    let dimension = (num_pairs(&alone, 2.0 * radius) / num_pairs(&alone, radius)).log2();
    (dimension > MIN_DIMENSION).then_some(share)
}

/// The distance from each point to the nearest other one.
fn spacings(points: &[Point]) -> Vec<f64> {
    let squared = PointTree::new(points).map(|tree| tree.nearest_others());
    squared.unwrap_or_default().into_iter().map(f64::sqrt).collect()
}

/// The number of pairs of points closer than a distance.
fn num_pairs(points: &[Point], distance: f64) -> f64 {
    let limit = distance * distance;
    let closer = |(index, point): (usize, &Point)| {
        points[index + 1..].iter().filter(|other| squared(point, other) < limit).count()
    };
    points.iter().enumerate().map(closer).sum::<usize>() as f64
}

fn squared(a: &Point, b: &Point) -> f64 {
    (0..3).map(|axis| f64::from(a[axis] - b[axis]).powi(2)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Pseudo-random numbers from 0 to 1.
    fn at(i: usize, row: usize) -> f32 {
        ((i as f64 * 12.9898 + row as f64 * 78.233).sin() * 43_758.545).rem_euclid(1.0) as f32
    }

    /// A square of side 1, and other points in a square or a box of side `side` around it.
    fn cloud(others: usize, side: f32, height: f32) -> Vec<Point> {
        let square = (0..3000).map(|i| [at(i, 0), at(i, 1), 0.0]);
        let about = |i: usize, row: usize| (at(i, row) - 0.5) * side + 0.5;
        let others = (0..others).map(|i| [about(i, 2), about(i, 3), (at(i, 4) - 0.5) * height + 0.1]);
        let mut points: Vec<Point> = square.chain(others).collect();
        points.sort_by_key(|point| (point[0] * 1e6).sin().to_bits());
        points
    }

    #[test]
    fn points_that_fill_the_air_are_a_haze_and_a_sparse_surface_is_none() {
        for (others, side) in [(700, 3.0), (1300, 3.0), (1300, 6.0)] {
            let share = haze(&cloud(others, side, side)).unwrap();
            let expected = others as f64 / (3000 + others) as f64;
            assert!((share - expected).abs() < 0.1, "{others} {side}: {share}");
            assert_eq!(haze(&cloud(others, 20.0 * side, 0.0)), None);
        }
        assert_eq!(haze(&cloud(0, 1.0, 0.0)), None);
    }

    #[test]
    fn few_points_and_repeated_ones_have_no_haze() {
        assert_eq!(haze(&cloud(300, 6.0, 6.0)[..200]), None);
        assert_eq!(haze(&[[1.0; 3]; 900]), None);
    }
}

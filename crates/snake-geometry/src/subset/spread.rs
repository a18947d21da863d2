//! Evenly spread keypoints: finds the suppression radius that leaves the wanted number.

use crate::{KdTree, Point, Result, keep_apart};

/// Relative precision of the radius.
const PRECISION: f64 = 1e-3;
/// The search also ends if at most this share more than the wanted number is left.
const SURPLUS: f64 = 0.05;

/// Non-maximum suppression to a number of points instead of by a radius. The points `(N, 3)` are sorted best first. Returns
/// the indices of `count` points, in the same order, and their distance from each other: the radius in cloud units.
///
/// The radius is about the largest that leaves `count` points, or up to a twentieth more, of which the best `count` are
/// kept. It is found by bisection (suppression via square covering: Bailo et al.,
/// "Efficient adaptive non-maximal suppression algorithms for homogeneous spatial keypoint distribution", 2018). The points
/// cover the cloud, whereas the best `count` points alone would cluster. If there are at most `count` points, all are
/// returned, with a radius of 0.
///
/// ```
/// use snake_geometry::suppress_to_count;
/// // The best points are close together.
/// let points = [0.0, 0.1, 0.2, 5.0, 5.1, 9.0].map(|x| [x, 0.0, 0.0]);
/// let (kept, radius) = suppress_to_count(&points, 3)?;
/// assert_eq!(kept, [0, 3, 5]);
/// assert!(radius < 4.0);
/// # Ok::<(), snake_geometry::Error>(())
/// ```
///
/// # Errors
/// [`Error::Input`](crate::Error::Input) for more points than [`u32::MAX`]. The points must be finite.
pub fn suppress_to_count(points: &[Point], count: usize) -> Result<(Vec<usize>, f32)> {
    let order = || (0..points.len()).collect::<Vec<_>>();
    if points.len() <= count {
        return Ok((order(), 0.0));
    }
    let tree = KdTree::new(points)?;
    let most = count + (SURPLUS * count as f64) as usize;
    // One point more than `most` shows that the radius is too small. One tree serves all radii.
    let kept_by = |radius: f32| {
        keep_apart(&order(), most + 1, |index, visit| {
            tree.within(&points[index], radius * radius, |other, _| visit(other));
        })
    };
    let mut kept = (order(), 0.0);
    let (mut low, mut high) = (0.0, diagonal(points));
    while high - low > PRECISION * high && kept.0.len() > most {
        // On a surface, the number falls with the square of the radius: halving from above is faster than from below.
        let middle = if low > 0.0 { f64::midpoint(low, high) } else { high / 2.0 };
        if middle as f32 <= 0.0 {
            break;
        }
        let trial = kept_by(middle as f32);
        if trial.len() < count {
            high = middle;
        } else {
            low = middle;
            kept = (trial.to_vec(), middle as f32);
        }
    }
    kept.0.truncate(count);
    Ok(kept)
}

/// The diagonal of the bounding box, limited so that its square fits into `f32`.
fn diagonal(points: &[Point]) -> f64 {
    let extent = |axis: usize| {
        let along = || points.iter().map(|point| f64::from(point[axis]));
        along().fold(f64::NEG_INFINITY, f64::max) - along().fold(f64::INFINITY, f64::min)
    };
    (0..3).map(|axis| extent(axis).powi(2)).sum::<f64>().sqrt().min(f32::MAX.sqrt().into())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points in a square. The first half, which ranks best, lies in one corner.
    fn clustered() -> Vec<Point> {
        let at = |i: u32, factor: u32| (i * factor % 997) as f32 / 997.0;
        let corner = (1..=450).map(|i| [0.2 * at(i, 131), 0.2 * at(i, 577), 0.0]);
        corner.chain((1..=450).map(|i| [at(i, 577), at(i, 131), 0.0])).collect()
    }

    fn distance(a: Point, b: Point) -> f32 {
        (0..3).map(|axis| (a[axis] - b[axis]).powi(2)).sum::<f32>().sqrt()
    }

    /// The mean distance of the points to the nearest kept point.
    fn coverage(points: &[Point], kept: &[usize]) -> f32 {
        let nearest = |p: &Point| kept.iter().map(|&i| distance(*p, points[i])).fold(f32::INFINITY, f32::min);
        points.iter().map(nearest).sum::<f32>() / points.len() as f32
    }

    #[test]
    fn the_wanted_number_is_reached_and_covers_the_cloud() {
        let points = clustered();
        for count in [1, 2, 10, 50, 100, 250, 500, 899] {
            let (kept, radius) = suppress_to_count(&points, count).unwrap();
            assert_eq!(kept.len(), count);
            assert!(kept[0] == 0 && kept.is_sorted_by(|a, b| a < b), "the best comes first: {kept:?}");
            for (rank, &one) in kept.iter().enumerate() {
                assert!(kept[..rank].iter().all(|&other| distance(points[one], points[other]) > 0.999 * radius));
            }
            let best: Vec<usize> = (0..count).collect();
            if (10..450).contains(&count) {
                let [spread, clustered] = [&kept, &best].map(|kept| coverage(&points, kept));
                assert!(spread < 0.5 * clustered, "{count}: {spread} {clustered}");
            }
        }
    }

    #[test]
    fn the_radius_is_the_largest_that_leaves_the_number() {
        let points = clustered();
        let (kept, radius) = suppress_to_count(&points, 60).unwrap();
        let left = |radius: f32| crate::suppress_ranked(&points, radius, 900).unwrap();
        assert!((60..=63).contains(&left(radius).len()) && left(radius)[..60] == kept);
        assert!(left(1.1 * radius).len() < 60);
    }

    #[test]
    fn few_equal_and_far_points_are_no_trouble() {
        assert_eq!(suppress_to_count(&[], 3).unwrap(), (vec![], 0.0));
        assert_eq!(suppress_to_count(&[[1.0; 3]; 2], 3).unwrap(), (vec![0, 1], 0.0));
        assert_eq!(suppress_to_count(&[[1.0; 3]; 9], 3).unwrap(), (vec![0, 1, 2], 0.0));
        assert_eq!(suppress_to_count(&[[1.0; 3]; 9], 0).unwrap().0, [] as [usize; 0]);
        let far = [[3e38; 3], [-3e38; 3], [0.0; 3], [1e-40; 3]];
        assert_eq!(suppress_to_count(&far, 3).unwrap().0.len(), 3);
    }
}

//! Returns from a sensor's own housing: a large part of a cloud in one tiny place, with empty space around it.

use crate::Point;

/// Smallest share of the points in the place.
const MIN_SHARE: f64 = 0.3;
/// The next point is more than this many radii of the place away: scans of an object have other objects beside it.
const GAP: f64 = 10.0;
/// Smallest spread of the other points about their mean, in radii of the place. A second object of about the same size has less.
const MIN_SPREAD: f64 = 4.0;
/// The other points have no such place: around none of them, this share of them lies within this many radii of the place.
const CLUMP: (f64, f64) = (0.2, 2.0);
/// Number of points that are measured, and number of candidates for the middle of the place.
const MEASURED: usize = 512;
const CANDIDATES: usize = 32;

/// Which of the finite points are in such a place, and a description of the place.
pub(super) fn housing(points: &[Point]) -> Option<(Vec<bool>, String)> {
    let measured = drawn(points, MEASURED);
    let center = densest(&measured, MIN_SHARE)?;
    let mut distances: Vec<f64> = measured.iter().map(|point| distance(point, &center)).collect();
    distances.sort_by(f64::total_cmp);
    let first = (MIN_SHARE * distances.len() as f64) as usize;
    let step = (first..distances.len() - 1).find(|&i| distances[i] > 0.0 && distances[i + 1] > GAP * distances[i])?;
    // Points that are not in the sample can lie somewhat farther out.
    let (radius, limit) = (distances[step], (distances[step] * distances[step + 1]).sqrt());
    let rest: Vec<Point> = measured.into_iter().filter(|point| distance(point, &center) > limit).collect();
    let number = rest.len() as f64;
    let mean: Point =
        std::array::from_fn(|axis| (rest.iter().map(|p| f64::from(p[axis])).sum::<f64>() / number) as f32);
    let spread = (rest.iter().map(|point| distance(point, &mean).powi(2)).sum::<f64>() / number).sqrt();
    let (share, radii) = CLUMP;
    let is_scene = spread > MIN_SPREAD * radius
        && densest(&rest, share).is_some_and(|clump| reach(&clump, &rest, share) > radii * radius);
    is_scene.then(|| {
        let is_inside = points.iter().map(|point| distance(point, &center) <= limit).collect();
        let [radius, x, y, z] =
            [limit, center[0].into(), center[1].into(), center[2].into()].map(|v: f64| format!("{v:.3}"));
        (
            is_inside,
            format!(
                "within {radius} of ({x}, {y}, {z}), with nothing else near, as returns of a sensor's own housing are"
            ),
        )
    })
}

/// At most `most` points, evenly distributed over their order.
fn drawn(points: &[Point], most: usize) -> Vec<Point> {
    let number = points.len().min(most);
    // One draw in each part: a fixed step could equal the width of an image.
    let draw =
        |i: usize| ((i as f64 + (i as f64 * 0.618_033_988_75).fract()) * points.len() as f64 / number as f64) as usize;
    (0..number).map(|i| points[draw(i).min(points.len() - 1)]).collect()
}

/// The candidate that needs the smallest ball for a share of the points.
fn densest(points: &[Point], share: f64) -> Option<Point> {
    let candidates = drawn(points, CANDIDATES).into_iter().map(|center| (reach(&center, points, share), center));
    candidates.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, center)| center)
}

/// The distance within which a share of the points lies.
fn reach(center: &Point, points: &[Point], share: f64) -> f64 {
    let mut distances: Vec<f64> = points.iter().map(|point| distance(point, center)).collect();
    let rank = (share * distances.len() as f64) as usize;
    *distances.select_nth_unstable_by(rank, f64::total_cmp).1
}

fn distance(a: &Point, b: &Point) -> f64 {
    (0..3).map(|axis| (f64::from(a[axis]) - f64::from(b[axis])).powi(2)).sum::<f64>().sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::FinitePoints;
    use crate::clouds::dense_core::tests::drawn;

    fn unit(i: usize, row: usize) -> f32 {
        drawn(i, row) as f32
    }

    /// Points in a cube that fits into the ball of this radius.
    fn ball(number: usize, radius: f32, center: Point) -> Vec<Point> {
        let point = |i| std::array::from_fn(|axis| center[axis] + radius * (2.0 * unit(i, axis) - 1.0) / 1.8);
        (0..number).map(point).collect()
    }

    /// Points on the walls, the floor and the ceiling of a room around the origin, and on a table in it.
    fn room(number: usize) -> Vec<Point> {
        let point = |i: usize| -> Point {
            let mut point = [6.0, 5.0, 2.5].map(f64::from).map(|v| v as f32);
            (0..3).for_each(|axis| point[axis] *= unit(i, axis) - 0.5);
            let axis = i % 3;
            point[axis] = [6.0, 5.0, 2.5][axis] * if unit(i, 3) < 0.5 { -0.5 } else { 0.5 };
            if i.is_multiple_of(10) { [1.5 + unit(i, 0), unit(i, 1), -0.4] } else { point }
        };
        (0..number).map(point).collect()
    }

    fn kept(points: &[Point]) -> (usize, Vec<String>) {
        let used = FinitePoints::clean("points", points, None).unwrap();
        (used.points.len(), used.findings())
    }

    #[test]
    fn a_housing_is_left_out_and_named_wherever_it_is() {
        for number in [10_000, 15_000, 60_000] {
            for (center, radius) in [([0.0; 3], 0.02), ([0.1, -0.2, 0.3], 0.01), ([0.0, 0.0, 0.1], 1e-4)] {
                let points = [room(10_000), ball(number, radius, center)].concat();
                let (left, notes) = kept(&points);
                assert_eq!((left, notes.len()), (10_000, 1), "{number} {notes:?}");
                assert!(notes[0].starts_with(&format!("{number} of ")) && notes[0].contains("housing"), "{notes:?}");
            }
            // A thing before the sensor.
            for (size, distance) in [(0.3, 0.5), (0.3, 1.0), (0.3, 3.0), (1.0, 1.5), (2.0, 5.0)] {
                let thing = ball(10_000, size / 2.0, [0.0, 0.0, distance]);
                let (left, notes) = kept(&[thing, ball(number, 0.015, [0.0; 3])].concat());
                assert!(left == 10_000 && notes[0].contains("housing"), "{number} {size} {distance} {notes:?}");
            }
        }
    }

    #[test]
    fn rooms_things_far_apart_and_statues_keep_their_points() {
        let far = |x: f32| ball(5000, 0.3, [x, 0.0, 0.0]);
        let statue = [room(5000), ball(10_000, 0.4, [0.0, 0.0, -0.9])].concat();
        for points in [
            room(9000),
            ball(4000, 1.0, [0.0; 3]),
            [far(0.0), far(6.0)].concat(),
            [far(0.0), far(6.0), far(-6.0)].concat(),
            statue,
        ] {
            assert_eq!(kept(&points), (points.len(), vec![]));
        }
        assert_eq!(housing(&[[0.0; 3]; 3]), None);
        assert_eq!(housing(&[[0.0; 3]]), None);
    }
}

//! Sweeps: clouds that one sensor saw around itself.

use std::num::NonZeroUsize;

use super::quantile;
use snake_geometry::{Neighbors, Point, Sensor, Vector, drawn, eigen, vector};

/// Number of points that are measured.
const MEASURED: usize = 1024;

/// A sweep has far points: the 98 % quantile of the distance from the centre is more than this many times the median.
/// Objects have 1.7; five in a hundred have more than 3.
const FAR: f64 = 2.5;

/// A sweep is dense near its sensor: the 95 % quantile of the distance to the nearest other point is more than this many times
/// the median. Points drawn evenly from a surface have 2.0; one in a hundred objects has more than 2.3.
const UNEVEN: f64 = 2.2;
/// So much denser are only sweeps: those of a small yard have 3.2, of streets 5 and more, objects and their views at most 2.7.
const VERY_UNEVEN: f64 = 3.0;

/// A sensor within this many radii of a cloud's middle saw it from within.
const WITHIN: f64 = 1.0;

/// A sweep is wide: its deviation along the shortest axis is less than this share of that along the longest one. Streets have
/// 0.04 to 0.06, and most uneven views of objects more than 0.1. A higher one is a sweep if its sensor is found within.
const HEIGHT: f64 = 0.15;

/// Whether a cloud `(N, 3)`, in any unit, looks like the sweep of a sensor at its centre: dense near the sensor, and with
/// points far beyond. Six of 2033 objects do.
pub(super) fn is_sweep(points: &[Point]) -> bool {
    let Some(measured) = measured(points) else { return false };
    let center = Vector::from_fn(|axis, _| quantile(measured.points.iter().map(|point| point[axis]).collect(), 0.5));
    let all: Vec<usize> = (0..measured.points.len()).collect();
    let ([least, _, most], _) = eigen(measured.covariance(&all));
    ratio(measured.points.iter().map(|point| (point - center).norm()).collect(), 0.98) > FAR
        && unevenness(&measured) > UNEVEN
        && (least < HEIGHT * HEIGHT * most || has_sensor_within(points))
}

/// Whether a cloud is much denser near its sensor, which is found within it.
pub(crate) fn is_seen_from_within(points: &[Point]) -> bool {
    measured(points).is_some_and(|measured| unevenness(&measured) > VERY_UNEVEN) && has_sensor_within(points)
}

/// The points that are measured; `None` for too few.
fn measured(points: &[Point]) -> Option<Neighbors> {
    let measured: Vec<Vector> = drawn(points, MEASURED).into_iter().map(vector).collect();
    if measured.len() < MEASURED / 4 { None } else { Neighbors::new(measured).ok() }
}

fn unevenness(measured: &Neighbors) -> f64 {
    let two = NonZeroUsize::MIN.saturating_add(1);
    let nearest = |point: &Vector| measured.nearest(point, two).last().map_or(0.0, |(_, distance)| *distance);
    ratio(measured.points.iter().map(nearest).collect(), 0.95)
}

/// The quantile of lengths at a share, in medians.
fn ratio(lengths: Vec<f64>, share: f64) -> f64 {
    quantile(lengths.clone(), share) / quantile(lengths, 0.5)
}

fn has_sensor_within(points: &[Point]) -> bool {
    Sensor::find(points).is_some_and(|sensor| sensor.radii_away(points) < WITHIN)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloud::tests::sphere;

    /// The rings of a sensor 1.8 above a plane, and walls 6 and `far` away.
    fn sweep(unit: f32, far: f32) -> Vec<Point> {
        let beam = |i: usize| {
            let azimuth = (i / 32) as f32 / 375.0 * std::f32::consts::TAU;
            let elevation = (-25.0 + (i % 32) as f32).to_radians();
            let direction = [azimuth.cos() * elevation.cos(), azimuth.sin() * elevation.cos(), elevation.sin()];
            let wall = if azimuth < 2.0 { 6.0 } else { far } / elevation.cos();
            let range = if elevation < -0.01 { (1.8 / -direction[2]).min(wall) } else { wall };
            direction.map(|v| v * range * unit)
        };
        (0..12_000).map(beam).collect()
    }

    #[test]
    fn a_sweep_is_known_in_any_unit_and_an_object_is_none() {
        for unit in [1.0, 1e-3, 1000.0] {
            assert!(is_sweep(&sweep(unit, 40.0)));
        }
        assert!(!is_sweep(&sphere(5000, 1.0)));
        assert!(!is_sweep(&[]));
        assert!(!is_sweep(&sweep(1.0, 40.0)[..100]));
    }

    #[test]
    fn a_small_yard_is_seen_from_within_and_a_ball_is_not() {
        let yard: Vec<Point> = sweep(1.0, 15.0).into_iter().map(|[x, y, z]| [x + 30.0, y - 20.0, z]).collect();
        assert!(!is_sweep(&yard) && is_seen_from_within(&yard));
        assert!(!is_seen_from_within(&sphere(5000, 1.0)));
    }
}

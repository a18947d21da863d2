//! Sweeps: clouds that one sensor saw around itself.

use super::quantile;
use snake_geometry::{Neighbors, Point, Sensor, drawn, eigen, vector};

/// Number of points that are measured.
const MEASURED: usize = 1024;

/// A sweep has far points: the 98 % quantile of the distance from the centre is more than this many times the median.
/// Objects have 1.7; five in a hundred have more than 3.
const FAR: f64 = 2.5;

/// A sweep is dense near its sensor: the 95 % quantile of the distance to the nearest other point is more than this many times
/// the median. Points drawn evenly from a surface have 2.0; one in a hundred objects has more than 2.3.
const UNEVEN: f64 = 2.2;

/// A sensor within this many radii of a cloud's middle saw it from within.
const WITHIN: f64 = 1.0;

/// A sweep is wide: its deviation along the shortest axis is less than this share of that along the longest one. Streets have
/// 0.04 to 0.06, and most uneven views of objects more than 0.1. A higher one is a sweep if its sensor is found within.
const HEIGHT: f64 = 0.15;

/// Whether a cloud `(N, 3)`, in any unit, looks like the sweep of a sensor at its centre: dense near the sensor, and with
/// points far beyond. Six of 2033 objects do.
pub(super) fn is_sweep(points: &[Point]) -> bool {
    let measured: Vec<Point> = drawn(points, MEASURED);
    if measured.len() < MEASURED / 4 {
        return false;
    }
    let center = std::array::from_fn(|axis| {
        let mut values: Vec<f32> = measured.iter().map(|point| point[axis]).collect();
        *values.select_nth_unstable_by(measured.len() / 2, f32::total_cmp).1
    });
    let is_more = |squared: Vec<f64>, share: f64, times: f64| {
        quantile(squared.clone(), share) > times * times * quantile(squared, 0.5)
    };
    let nearest = |(i, point): (usize, &Point)| {
        let others = measured.iter().enumerate().filter(|(j, _)| i != *j);
        others.map(|(_, other)| squared_distance(point, other)).fold(f64::INFINITY, f64::min)
    };
    let all: Vec<usize> = (0..measured.len()).collect();
    let Ok(neighbors) = Neighbors::new(measured.iter().copied().map(vector).collect()) else { return false };
    let ([least, _, most], _) = eigen(neighbors.covariance(&all));
    let is_seen_from_within = || Sensor::find(points).is_some_and(|sensor| sensor.radii_away(points) < WITHIN);
    is_more(measured.iter().map(|point| squared_distance(point, &center)).collect(), 0.98, FAR)
        && is_more(measured.iter().enumerate().map(nearest).collect(), 0.95, UNEVEN)
        && (least < HEIGHT * HEIGHT * most || is_seen_from_within())
}

fn squared_distance(a: &Point, b: &Point) -> f64 {
    (0..3).map(|axis| f64::from(a[axis] - b[axis]).powi(2)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloud::tests::sphere;

    /// The rings of a sensor 1.8 above a plane, and walls 6 and 40 away.
    fn sweep(unit: f32) -> Vec<Point> {
        let beam = |i: usize| {
            let azimuth = (i / 32) as f32 / 375.0 * std::f32::consts::TAU;
            let elevation = (-25.0 + (i % 32) as f32).to_radians();
            let direction = [azimuth.cos() * elevation.cos(), azimuth.sin() * elevation.cos(), elevation.sin()];
            let wall = if azimuth < 2.0 { 6.0 } else { 40.0 } / elevation.cos();
            let range = if elevation < -0.01 { (1.8 / -direction[2]).min(wall) } else { wall };
            direction.map(|v| v * range * unit)
        };
        (0..12_000).map(beam).collect()
    }

    #[test]
    fn a_sweep_is_known_in_any_unit_and_an_object_is_none() {
        for unit in [1.0, 1e-3, 1000.0] {
            assert!(is_sweep(&sweep(unit)));
        }
        assert!(!is_sweep(&sphere(5000, 1.0)));
        assert!(!is_sweep(&[]));
        assert!(!is_sweep(&sweep(1.0)[..100]));
    }
}

//! Sweeps: clouds that one sensor saw about itself.

use crate::points::Point;

/// Number of points that are measured.
const MEASURED: usize = 1024;

/// A sweep has far points: 98 % of the points lie within this many times the distance within which half of them lie.
/// Objects have 1.7, five in a hundred more than 3.
const FAR: f64 = 2.5;

/// A sweep is dense near its sensor: the distance to the nearest other point, of which 95 % are smaller, is this many times
/// the median. Points that are drawn evenly from a surface have 2.0, one in a hundred objects more than 2.3.
const UNEVEN: f64 = 2.2;

/// Whether a cloud `(N, 3)`, in any unit, looks like the sweep of a sensor in its midst: dense near the sensor, and with points
/// far beyond. Of 2033 objects six do.
pub(crate) fn is_sweep(points: &[Point]) -> bool {
    let step = points.len().div_ceil(MEASURED).max(1);
    // A fixed step could be the width of an image, and take one column of it.
    let draw = |i: usize| i * step + (i as f64 * 0.618_033_988_75 % 1.0 * step as f64) as usize;
    let number = points.len().div_ceil(step);
    let measured: Vec<Point> = (0..number).filter_map(|i| points.get(draw(i)).copied()).collect();
    if measured.len() < MEASURED / 4 {
        return false;
    }
    let center = std::array::from_fn(|axis| {
        let mut values: Vec<f32> = measured.iter().map(|point| point[axis]).collect();
        *values.select_nth_unstable_by(measured.len() / 2, f32::total_cmp).1
    });
    let reach = quantiles(measured.iter().map(|point| distance(point, &center)).collect(), [0.5, 0.98]);
    let nearest = |(i, point): (usize, &Point)| {
        let others = measured.iter().enumerate().filter(|(j, _)| i != *j).map(|(_, other)| distance(point, other));
        others.fold(f64::INFINITY, f64::min)
    };
    let spacing = quantiles(measured.iter().enumerate().map(nearest).collect(), [0.5, 0.95]);
    reach[1] > FAR * reach[0] && spacing[1] > UNEVEN * spacing[0]
}

fn distance(a: &Point, b: &Point) -> f64 {
    (0..3).map(|axis| f64::from(a[axis] - b[axis]).powi(2)).sum::<f64>().sqrt()
}

fn quantiles(mut values: Vec<f64>, shares: [f64; 2]) -> [f64; 2] {
    values.sort_unstable_by(f64::total_cmp);
    shares.map(|share| values[(share * (values.len() - 1) as f64) as usize])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What a sensor 1.8 above a plane sees of it in rings, and of walls 6 and 40 away.
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
        let ball: Vec<Point> = (0..5000)
            .map(|i| {
                let z = 2.0 * (i as f32 + 0.5) / 5000.0 - 1.0;
                let (sin, cos) = (i as f32 * 2.4).sin_cos();
                [(1.0 - z * z).sqrt() * cos, (1.0 - z * z).sqrt() * sin, z]
            })
            .collect();
        assert!(!is_sweep(&ball));
        assert!(!is_sweep(&[]));
        assert!(!is_sweep(&sweep(1.0)[..100]));
    }
}

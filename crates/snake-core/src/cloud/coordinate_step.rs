//! Coordinates that are multiples of a length, as float32 makes them far from zero.

use snake_geometry::{Point, drawn};

/// Number of points that are measured.
const MEASURED: usize = 4096;

/// Minimum number of different coordinates: a stack of a few shelves has no step.
const MIN_LEVELS: usize = 16;

/// The largest step of the coordinates along any axis, if there is one. Counted from the lowest coordinate, all are multiples
/// of the step within a thousandth of it or within float32 rounding, and at least [`MIN_LEVELS`] of them differ, but
/// not all, as along a line of even points.
pub(super) fn coordinate_step(points: &[Point]) -> Option<CoordinateStep> {
    let measured: Vec<Point> = drawn(points, MEASURED);
    let step_of = |axis: usize| step(measured.iter().map(|point| point[axis]).collect()).map(|length| (axis, length));
    let (axis, length) = (0..3).filter_map(step_of).max_by(|a, b| a.1.total_cmp(&b.1))?;
    Some(CoordinateStep { axis, length })
}

/// A length of which the coordinates along an axis are multiples.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct CoordinateStep {
    /// 0 is x.
    pub(crate) axis: usize,
    /// In cloud units.
    pub(crate) length: f64,
}

fn step(mut values: Vec<f32>) -> Option<f64> {
    values.sort_unstable_by(f32::total_cmp);
    let (lowest, highest) = (f64::from(*values.first()?), f64::from(*values.last()?));
    // Two units in the last place: a subtracted origin may not be a multiple of the step.
    let rounding = 2.0 * f64::from(f32::EPSILON) * lowest.abs().max(highest.abs());
    let gaps = values.windows(2).map(|pair| f64::from(pair[1]) - f64::from(pair[0])).filter(|gap| *gap > rounding);
    let (num_gaps, smallest) = gaps.fold((0, f64::INFINITY), |(number, least), gap| (number + 1, gap.min(least)));
    if num_gaps + 1 < MIN_LEVELS || num_gaps + 1 == values.len() {
        return None;
    }
    // The rounding error of the smallest gap would add up over the levels, so the extent gives the length.
    let length = (highest - lowest) / ((highest - lowest) / smallest).round();
    let off = |value: &f32| {
        let levels = (f64::from(*value) - lowest) / length;
        (levels - levels.round()).abs() * length
    };
    values.iter().all(|value| off(value) <= rounding.max(1e-3 * length)).then_some(length)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points of a wavy surface.
    fn surface() -> Vec<Point> {
        let at = |i: usize, step: f32| (i as f32 * step).fract() * 12.0;
        (0..5000).map(|i| [at(i, 0.618_034), at(i, 0.754_877_7), (i as f32 * 0.01).sin()]).collect()
    }

    #[test]
    fn even_points_on_a_line_have_no_step() {
        let line: Vec<Point> = (0..33).map(|i| [i as f32 / 32.0; 3]).collect();
        assert!(coordinate_step(&line).is_none());
    }

    #[test]
    fn multiples_of_a_length_are_found_about_any_origin() {
        for (step, origin) in [(0.5, 0.0), (0.5, 3.3), (1.0 / 32.0, 7.1)] {
            let striped: Vec<Point> =
                surface().into_iter().map(|[x, y, z]| [x, (y / step).round() * step - origin, z]).collect();
            let measured = coordinate_step(&striped).unwrap();
            assert_eq!(measured.axis, 1);
            assert!((measured.length - f64::from(step)).abs() < 1e-5, "{measured:?}");
        }
    }

    #[test]
    fn measured_coordinates_and_a_few_shelves_have_no_step_that_matters() {
        let shelves: Vec<Point> = surface().into_iter().map(|[x, y, z]| [x, y, (4.0 * z).round() * 0.4]).collect();
        for points in [surface(), shelves, vec![[1.0; 3]; 50], Vec::new()] {
            assert!(coordinate_step(&points).is_none_or(|step| step.length < 1e-4));
        }
    }
}

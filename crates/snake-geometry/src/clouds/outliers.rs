//! The reach of a cloud: where its points lie, even if a few of them are very far away.

use std::fmt;

use super::dense_core::{dense_core, squared_distance};
use crate::Point;

/// The share of the points that determines the reach of a cloud. So fewer than one point in twenty can be outliers.
const SHARE: f64 = 0.95;
/// Outliers are farther from the middle than this many times the distance within which [`SHARE`] of the points lie. The
/// farthest points of objects, rooms and LiDAR sweeps are at 2.6 times that distance and less.
const TIMES: f64 = 5.0;
/// Number of points that are measured. They fit on the stack.
const MEASURED: usize = 1024;
/// Clouds with fewer points have no outliers.
const MIN_POINTS: usize = 20;

/// The ball that contains the points of a cloud, except outliers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reach {
    /// The median of each coordinate, or the middle of the dense core.
    center: [f64; 3],
    /// The distance from the middle within which [`SHARE`] of the points lie, or the radius of the dense core.
    common: f64,
    /// Points farther than this from the middle are outliers.
    limit: f64,
}

impl Reach {
    /// The reach of finite positions, from at most 1024 of them, one drawn from each of as many equal parts of their order.
    /// `None` if there are too few positions to have outliers, or if most of them are one point. The iterator is run twice.
    pub fn of(positions: impl Iterator<Item = [f64; 3]> + Clone) -> Option<Self> {
        let number = positions.clone().count();
        if number < MIN_POINTS {
            return None;
        }
        let mut memory = [[0.0; 3]; MEASURED];
        let measured = &mut memory[..number.min(MEASURED)];
        let part = number as f64 / measured.len() as f64;
        let (mut places, mut next, mut filled) = (positions.enumerate(), 0, 0);
        while let Some(slot) = measured.get_mut(filled) {
            // One draw in each part: a fixed step could equal the width of an image and take a single column.
            let draw = (filled as f64 * 0.618_033_988_75).fract();
            let place = (((filled as f64 + draw) * part) as usize).max(next);
            *slot = places.by_ref().nth(place - next)?.1;
            (next, filled) = (place + 1, filled + 1);
        }
        if let Some((center, radius)) = dense_core(measured) {
            return Some(Self { center, common: radius, limit: radius });
        }
        let middle = measured.len() / 2;
        let center = std::array::from_fn(|axis| {
            measured.select_nth_unstable_by(middle, |a, b| a[axis].total_cmp(&b[axis])).1[axis]
        });
        let rank = (SHARE * measured.len() as f64).ceil() as usize - 1;
        let squared = |position: &[f64; 3]| squared_distance(position, &center);
        let common = squared(measured.select_nth_unstable_by(rank, |a, b| squared(a).total_cmp(&squared(b))).1).sqrt();
        (common > 0.0 && common.is_finite()).then_some(Self { center, common, limit: TIMES * common })
    }

    /// Whether a finite position is not an outlier.
    pub fn holds(&self, position: [f64; 3]) -> bool {
        squared_distance(&position, &self.center) <= self.limit.powi(2)
    }

    /// Finds the outliers among finite points, if there are any.
    pub fn outliers(&self, points: &[Point]) -> Option<Outliers> {
        let squared = points.iter().map(|point| squared_distance(&point.map(f64::from), &self.center));
        let limit = self.limit.powi(2);
        let (number, farthest) = squared
            .filter(|squared| *squared > limit)
            .fold((0, 0.0), |(number, farthest): (usize, f64), squared| (number + 1, farthest.max(squared)));
        (number > 0).then(|| Outliers { number, num_points: points.len(), times: farthest.sqrt() / self.common })
    }
}

/// The points of a cloud that are far beyond all others: fewer than one in twenty, and more than five times as far from the
/// middle; or sparse points around a dense core, such as a dome of sky or the floaters of splats, up to seven in ten. They
/// would determine the cloud's size, so they are left out. The text says so in one sentence.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Outliers {
    /// Number of points that are left out.
    pub number: usize,
    /// Number of finite points.
    pub num_points: usize,
    /// The distance of the farthest outlier from the middle, as a multiple of the distance within which 0.95 of the points lie,
    /// or of the radius of the dense core.
    pub times: f64,
}

impl fmt::Display for Outliers {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let Self { number, num_points, times } = *self;
        let digit = 10_f64.powf(times.log10().floor());
        let times = (times / digit).round() * digit;
        match number {
            1 => write!(
                f,
                "1 of {num_points} points is {times} times as far from the middle as the others: an outlier, left out"
            ),
            _ => {
                let kind = if number * 20 > num_points { "sky, floaters or other outliers" } else { "outliers" };
                write!(
                    f,
                    "{number} of {num_points} points are up to {times} times as far from the middle as the others: {kind}, \
                     left out"
                )
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points on a bent sheet, 1 across, in rows of 64.
    fn sheet(number: usize) -> Vec<Point> {
        let point = |i: usize| [(i % 64) as f32 / 64.0, (i / 64) as f32 * 64.0 / number as f32, (i as f32).sin() * 0.1];
        (0..number).map(point).collect()
    }

    fn outliers(points: &[Point]) -> Option<Outliers> {
        Reach::of(points.iter().map(|point| point.map(f64::from)))?.outliers(points)
    }

    #[test]
    fn few_points_far_away_are_outliers_wherever_they_stand_in_the_order() {
        for number in [64, 1000, 1024, 1025, 40_000] {
            assert_eq!(outliers(&sheet(number)), None);
            for (count, distance) in [(1, 10.0), (1, 3e38), (number / 25, 1e4)] {
                for start in [0, number / 2, number] {
                    let mut points = sheet(number);
                    points.splice(start..start, std::iter::repeat_n([distance, 0.5, 0.0], count));
                    let left_out = outliers(&points).unwrap();
                    assert_eq!((left_out.number, left_out.num_points), (count, number + count), "{start} {distance}");
                }
            }
        }
    }

    #[test]
    fn points_of_many_distances_are_no_outliers() {
        // A sweep: the density falls with the square of the distance, which goes from 1 to 80.
        let sweep: Vec<Point> = (0..5000)
            .map(|i| {
                let ((sin, cos), range) = ((i as f32 * 2.4).sin_cos(), 80_f32.powf(i as f32 / 5000.0));
                [range * cos, range * sin, 0.0]
            })
            .collect();
        assert_eq!(outliers(&sweep), None);
        let tenth = [sheet(900), vec![[50.0; 3]; 100]].concat();
        assert_eq!(outliers(&tenth), None);
        for small in [vec![], vec![[1.0; 3]; 50], [vec![[0.0; 3]; 18], vec![[1e20; 3]]].concat()] {
            assert_eq!(outliers(&small), None);
        }
    }

    #[test]
    fn the_text_says_how_many_and_how_far() {
        let text = |number, times| Outliers { number, num_points: 6001, times }.to_string();
        assert!(text(1, 1023.0).starts_with("1 of 6001 points is 1000 times as far"), "{}", text(1, 1023.0));
        assert!(text(3, 19.6).starts_with("3 of 6001 points are up to 20 times as far"));
    }
}

//! Clouds far from zero: points in `f32` relative to an origin in `f64`.

use serde::{Deserialize, Serialize};

use crate::{NormalizationMethod, Point, Reach};

/// A point cloud with its origin, in the file's order and units.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Cloud {
    /// The points `(N, 3)`, relative to the origin. Coordinates may be infinite or not a number.
    pub points: Vec<Point>,
    /// Added to every point and to every result in the points' frame. It is zero unless the coordinates are so far from
    /// zero (more than 16 times the size of the cloud) that `f32` would lose digits, as in georeferenced scans. Outliers do
    /// not count.
    pub origin: [f64; 3],
}

impl Cloud {
    /// Converts positions in `f64` to points relative to an origin, which is zero near zero. The iterator is run several times.
    ///
    /// ```
    /// use snake_geometry::{Cloud, add_origin};
    /// let scan = [[691_000.25, 5_336_000.5, 512.0], [691_001.0, 5_336_003.0, 514.125]];
    /// let cloud = Cloud::from_positions(scan.iter().copied());
    /// assert_eq!(add_origin(cloud.points[1], cloud.origin), scan[1]);
    /// ```
    pub fn from_positions(positions: impl Iterator<Item = [f64; 3]> + Clone) -> Self {
        let origin = origin(positions.clone());
        Self { points: positions.map(|position| subtract_origin(position, origin)).collect(), origin }
    }

    /// The points with the origin added. Georeferenced points lose digits: at 5e6 m one `f32` step is 0.5 m.
    pub fn into_points(self) -> Vec<Point> {
        let Self { mut points, origin } = self;
        if origin != [0.0; 3] {
            points.iter_mut().for_each(|point| *point = add_origin(*point, origin).map(|v| v as f32));
        }
        points
    }

    /// The cloud for encoding. With a [fixed](NormalizationMethod::is_fixed) normalisation, the coordinates are those of the
    /// network's frame or twice those, so the origin is added to the points.
    #[must_use]
    pub fn for_normalization(self, method: NormalizationMethod) -> Self {
        if method.is_fixed() { Self { points: self.into_points(), origin: [0.0; 3] } } else { self }
    }
}

/// Converts a point relative to an origin to a position in `f64`.
pub fn add_origin(point: Point, origin: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|axis| f64::from(point[axis]) + origin[axis])
}

/// Converts a position to a point relative to an origin.
pub fn subtract_origin(position: [f64; 3], origin: [f64; 3]) -> Point {
    std::array::from_fn(|axis| (position[axis] - origin[axis]) as f32)
}

/// A cloud gets an origin if its distance from zero is more than this many times its size. At this distance, an `f32`
/// has about 20 bits for the position within the cloud.
const FAR: f64 = 16.0;

/// The bounds of finite positions in `f64`, updated one position at a time.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Bounds {
    /// The lowest coordinates; infinite if there are no positions.
    pub low: [f64; 3],
    /// The highest coordinates; infinite if there are no positions.
    pub high: [f64; 3],
}

impl Default for Bounds {
    fn default() -> Self {
        Self { low: [f64::INFINITY; 3], high: [f64::NEG_INFINITY; 3] }
    }
}

impl Bounds {
    /// Adds a position; ignores one that is not finite.
    pub fn add(&mut self, position: [f64; 3]) {
        if position.iter().all(|v| v.is_finite()) {
            for (axis, value) in position.into_iter().enumerate() {
                self.low[axis] = self.low[axis].min(value);
                self.high[axis] = self.high[axis].max(value);
            }
        }
    }

    /// Whether a cloud's reach holds all positions within the bounds.
    fn are_held_by(&self, reach: &Reach) -> bool {
        let corner = |bits: usize| std::array::from_fn(|axis| [self.low, self.high][bits >> axis & 1][axis]);
        (0..8).all(|bits| reach.holds(corner(bits)))
    }

    /// The origin of a cloud with these bounds. It is zero, or for positions far from zero their centre, rounded to a multiple
    /// of a power of two so that the subtraction is exact.
    pub fn origin(&self) -> [f64; 3] {
        let Self { low, high } = *self;
        let size = (0..3).map(|axis| high[axis] - low[axis]).fold(0.0, f64::max);
        let farthest = low.into_iter().chain(high).map(f64::abs).fold(0.0, f64::max);
        // A single position, no positions, or coordinates that overflow: no origin.
        if !(size > 0.0 && farthest > FAR * size && farthest.is_finite()) {
            return [0.0; 3];
        }
        // The step is not below the resolution of the farthest coordinate, or the quotient could overflow, as low + high can.
        let step = size.log2().floor().exp2().max((farthest.log2().floor() - 52.0).exp2());
        std::array::from_fn(|axis| ((low[axis] / 2.0 + high[axis] / 2.0) / step).round() * step)
    }
}

/// The origin of positions, from the bounds of those that are not outliers.
fn origin(positions: impl Iterator<Item = [f64; 3]> + Clone) -> [f64; 3] {
    let bounds_of = |holds: &dyn Fn([f64; 3]) -> bool| {
        let mut bounds = Bounds::default();
        positions.clone().filter(|&position| holds(position)).for_each(|position| bounds.add(position));
        bounds
    };
    let bounds = bounds_of(&|_| true);
    let finite = positions.clone().filter(|position| position.iter().all(|v| v.is_finite()));
    match Reach::of(finite) {
        Some(reach) if !bounds.are_held_by(&reach) => bounds_of(&|position| reach.holds(position)).origin(),
        _ => bounds.origin(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn origins_are_finite_at_both_ends_of_the_numbers() {
        for (low, high) in [([1e308, 1e308, 0.0], [1.1e308, 1.2e308, 0.0]), ([1.0, 0.0, 0.0], [1.0, 1e-320, 0.0])] {
            assert!(origin([low, high].into_iter()).iter().all(|v| v.is_finite()));
        }
    }

    #[test]
    fn far_clouds_get_an_origin_and_keep_their_digits() {
        let cloud = |positions: &[[f64; 3]]| Cloud::from_positions(positions.iter().copied());
        let near = [[0.25, -3.0, 1.0], [0.5, 12.0, 100.0]];
        let Cloud { points, origin } = cloud(&near);
        assert_eq!((origin, points), ([0.0; 3], near.map(|p| p.map(|v| v as f32)).to_vec()));

        let far = [
            [500_000.123, 5_400_000.456, 200.0],
            [500_010.789, 5_400_003.001, f64::NAN],
            [500_020.5, 5_400_007.0, 210.0],
        ];
        let converted = cloud(&far);
        assert!(converted.points[1][2].is_nan());
        for (point, expected) in converted.points.iter().zip(far) {
            for (back, expected) in add_origin(*point, converted.origin).into_iter().zip(expected) {
                assert!((back - expected).abs() < 2e-6 || expected.is_nan(), "{back} {expected}");
            }
        }
        assert_eq!(converted.into_points()[0], far[0].map(|v| v as f32));
        // A single far outlier does not cost the other points their precision.
        let outlier = cloud(&[[1e30, 0.0, 0.0], [0.1, 0.2, 0.3], [0.4, 0.5, 0.6]]);
        assert_eq!((outlier.origin, outlier.points[1]), ([0.0; 3], [0.1, 0.2, 0.3]));
        for points in [vec![], vec![[7.0; 3]; 3], vec![[f64::NAN; 3]], vec![[-1.7e308; 3], [1.7e308; 3]]] {
            assert_eq!(cloud(&points).origin, [0.0; 3], "{points:?}");
        }
    }

    #[test]
    fn outliers_do_not_decide_the_origin() {
        let room =
            (0..900).map(|i| [500_123.25 + f64::from(i % 30) * 0.1, 5_412_345.75 + f64::from(i / 30) * 0.1, 431.0]);
        let clean = Cloud::from_positions(room.clone());
        assert!(clean.origin[1] > 5e6);
        // Missing returns at zero, and a point farther away than the size of the earth.
        for outlier in [[0.0; 3], [1e30, 0.0, 0.0], [f64::MAX, 0.0, f64::MIN], [f64::NAN, 0.0, 0.0]] {
            let converted = Cloud::from_positions(std::iter::once(outlier).chain(room.clone()));
            assert_eq!((converted.origin, &converted.points[1..]), (clean.origin, &clean.points[..]), "{outlier:?}");
        }
        let near = (0..900).map(|i| [f64::from(i % 30) * 0.1, f64::from(i / 30) * 0.1, 1.0]);
        let converted = Cloud::from_positions(std::iter::once([5e6, 5e6, 0.0]).chain(near));
        assert_eq!((converted.origin, converted.points[31]), ([0.0; 3], [0.0, 0.1, 1.0]));
    }

    #[test]
    fn the_networks_frame_has_no_other_origin() {
        let far = Cloud { points: vec![[0.5, 0.25, 0.0], [0.0; 3]], origin: [1024.0, 0.0, -4096.0] };
        assert_eq!(far.clone().for_normalization(NormalizationMethod::UnitSphere), far);
        let absolute = Cloud { points: vec![[1024.5, 0.25, -4096.0], [1024.0, 0.0, -4096.0]], origin: [0.0; 3] };
        assert_eq!(far.clone().for_normalization(NormalizationMethod::None), absolute);
        assert_eq!(far.for_normalization(NormalizationMethod::Half), absolute);
    }
}

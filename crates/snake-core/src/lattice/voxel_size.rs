//! The rule that chooses the voxel size of a scene if none is given.
//!
//! The rule takes the smallest size of the series 1, 1.25, 1.6, 2, 2.5, 3.15, 4, 5, 6.3, 8 (times any power of ten) such that
//!
//! - the number of occupied voxels is at most 80 % of the number of places on the surface. A voxel is then a little larger
//!   than the distance between neighbouring places. A sweep ([`UsedCloud::is_sweep`]) has 95 %, because its points lie far
//!   apart where objects are;
//! - the size is at least the step of the coordinates ([`UsedCloud::coordinate_step`]); and
//! - at most [`MAX_VOXELS`] voxels are occupied and the volume has at most [`MAX_BLOCKS`] blocks. This bounds time and
//!   memory for every cloud.
//!
//! Places are the occupied voxels at the size where halving the voxels finds no more of them. Points that lie closer together
//! count once, such as the points of a cloud that was stored twice.
//!
//! Because of the steps, two clouds of one sensor more often have the same size. A room in millimetres has a thousand times
//! the size of the same room in metres.

use rayon::prelude::*;

use super::blocks::MAX_NODE;
use super::corner::lowest_corner;
use super::levels::FinestLevel;
use crate::Result;
use crate::cloud::{CoordinateStep, UsedCloud};
use crate::control::Control;
use snake_geometry::{Length, Point, check_extent};

/// Maximum number of occupied voxels: about as many as a sweep of 120 000 points has at 0.28 m.
const MAX_VOXELS: usize = 32_000;

/// Maximum number of blocks of the volume: a little more than a sweep of 25 000 points has at 0.25 m.
const MAX_BLOCKS: usize = 18_000;

/// Maximum number of occupied voxels as a share of the number of places: for other clouds, and for a sweep.
const SHARES: [f64; 2] = [0.8, 0.95];

/// Halving the voxels finds no more places if their number grows by less than this factor ...
const NO_MORE: f64 = 1.02;

/// ... and they have at most this many points on average: a few clusters far apart do not show all places.
const MAX_POINTS_A_PLACE: usize = 8;

/// Steps of the series in a factor of ten.
const STEPS: i32 = 10;

/// Steps of the series in a factor of two.
const STEPS_OF_HALF: i32 = 3;

/// The voxel size in cloud units: the given one, or the one that the rule chooses.
pub(crate) fn voxel_size(given: Option<Length>, cloud: &UsedCloud, control: &Control) -> Result<f32> {
    match given {
        Some(size) => Ok(size.in_units("voxel_size", cloud.points())? as f32),
        None => chosen(cloud, control).map(|size| size as f32),
    }
}

/// The step of the coordinates, if it is coarser than the voxels would be without it.
pub(crate) fn coarse_step(given: Option<Length>, cloud: &UsedCloud) -> Option<CoordinateStep> {
    let step = cloud.coordinate_step()?;
    let size = match given {
        Some(size) => size.in_units("voxel_size", cloud.points()).ok()?,
        None => size_of(step_for_density(cloud, &Control::default()).ok()?),
    };
    (size < step.length).then_some(step)
}

/// The size that the rule chooses from the places of the surface, the blocks of the volume and the step of the coordinates.
fn chosen(cloud: &UsedCloud, control: &Control) -> Result<f64> {
    let step = step_for_density(cloud, control)?;
    let least = cloud.coordinate_step().map(|CoordinateStep { length, .. }| step_of(length));
    Ok(size_of(step.max(least.unwrap_or(step))))
}

/// The step of the series before the step of the coordinates is considered. The cloud caches it.
fn step_for_density(cloud: &UsedCloud, control: &Control) -> Result<i32> {
    if let Some(step) = cloud.voxel_step.get() {
        return Ok(*step);
    }
    let voxels = Voxels { points: cloud.points(), lowest: lowest_corner(cloud.points()) };
    let extent = voxels.extent();
    check_extent(extent)?;
    let largest = step_of(extent);
    let share = SHARES[usize::from(cloud.is_sweep())];
    let step = step_for_places(&voxels, largest, share, control)?;
    let step = step_for_blocks(&voxels, step, largest, control)?;
    Ok(*cloud.voxel_step.get_or_init(|| step))
}

/// The smallest step at which the occupied voxels are at most `share` times the places, and at most [`MAX_VOXELS`].
fn step_for_places(voxels: &Voxels, largest: i32, share: f64, control: &Control) -> Result<i32> {
    let numbers = numbers_of_halves(voxels, largest, share, control)?;
    let (&(mut too_small, places), larger) = numbers.split_last().expect("one voxel as large as the cloud");
    let most = MAX_VOXELS.min((share * places as f64) as usize).max(1);
    let mut fits = larger.iter().rfind(|(_, number)| *number <= most).map_or(largest + 1, |(step, _)| *step);
    while fits - too_small > 1 {
        control.check()?;
        let middle = too_small + (fits - too_small) / 2;
        if voxels.number(middle) <= most { fits = middle } else { too_small = middle }
    }
    Ok(fits)
}

/// The first step at or above `from` at which the volume has at most [`MAX_BLOCKS`] blocks. Isolated voxels need many blocks,
/// such as voxels on rings far apart, or in a dense part of a much wider cloud.
fn step_for_blocks(voxels: &Voxels, from: i32, largest: i32, control: &Control) -> Result<i32> {
    let mut step = from;
    while step <= largest && !voxels.are_within_budget(size_of(step)) {
        control.check()?;
        step += 1;
    }
    Ok(step)
}

/// The numbers of occupied voxels by step, halving the size from the extent of the cloud on. The last number is the number of
/// places on the surface that the points resolve, and voxels of its step are too small for `share` of them. Halving stops
/// early where the budget of voxels decides instead.
fn numbers_of_halves(voxels: &Voxels, largest: i32, share: f64, control: &Control) -> Result<Vec<(i32, usize)>> {
    let smallest = largest - 6 * STEPS;
    let (mut step, mut number) = (largest, 1);
    let mut numbers = vec![(largest + 1, number)];
    while step > smallest && share * (number as f64) < MAX_VOXELS as f64 {
        control.check()?;
        step -= STEPS_OF_HALF;
        let more = voxels.number(step);
        let is_all = (more as f64) < NO_MORE * number as f64 && more * MAX_POINTS_A_PLACE >= voxels.points.len();
        number = more;
        numbers.push((step, number));
        if is_all {
            break;
        }
    }
    Ok(numbers)
}

/// The voxels of a cloud at any size.
struct Voxels<'a> {
    points: &'a [Point],
    lowest: Point,
}

impl Voxels<'_> {
    /// The offset of a point from the lowest corner.
    fn offset(&self, point: &Point) -> [f64; 3] {
        std::array::from_fn(|axis| f64::from(point[axis]) - f64::from(self.lowest[axis]))
    }

    fn extent(&self) -> f64 {
        self.points.iter().map(|point| self.offset(point).into_iter().fold(0.0, f64::max)).fold(0.0, f64::max)
    }

    /// The sorted keys of all points' cells in the [lattice](super::corner): 21 bits each for z, y and x.
    fn keys(&self, size: f64) -> Vec<u64> {
        let key = |point| {
            let [x, y, z] = self.offset(point).map(|v| (v / size + 0.5) as i64 as u64 & 0x1F_FFFF);
            (z << 42) | (y << 21) | x
        };
        let mut keys: Vec<u64> = self.points.iter().map(key).collect();
        keys.par_sort_unstable();
        keys
    }

    /// The number of occupied voxels at a step.
    fn number(&self, step: i32) -> usize {
        1 + self.keys(size_of(step)).windows(2).filter(|pair| pair[0] != pair[1]).count()
    }

    /// Whether the volume of voxels of a size has at most [`MAX_BLOCKS`] blocks.
    fn are_within_budget(&self, size: f64) -> bool {
        let is_outside = |point| self.offset(point).into_iter().any(|v| v / size + 0.5 >= f64::from(MAX_NODE));
        if self.points.iter().any(is_outside) {
            return false;
        }
        let mut keys = self.keys(size);
        keys.dedup();
        // The lowest 21 bits of a key are a signed place.
        let place = |bits: u64| ((bits << 43) as i64 >> 43) as i32;
        let cells = keys.iter().map(|&key| [key, key >> 21, key >> 42].map(place));
        FinestLevel::new(cells, MAX_BLOCKS).is_some()
    }
}

/// The first step of the series that is not below a size.
fn step_of(size: f64) -> i32 {
    (size.log10() * f64::from(STEPS)).ceil() as i32
}

/// The size of a step, in the rounding of the series.
fn size_of(step: i32) -> f64 {
    const SERIES: [f64; STEPS as usize] = [1.0, 1.25, 1.6, 2.0, 2.5, 3.15, 4.0, 5.0, 6.3, 8.0];
    let (tens, place) = (step.div_euclid(STEPS), step.rem_euclid(STEPS) as usize);
    // A division is exact where a product with a negative power of ten is not.
    if tens < 0 { SERIES[place] / 10_f64.powi(-tens) } else { SERIES[place] * 10_f64.powi(tens) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use snake_geometry::FinitePoints;

    /// A square of n x n points, `spacing` apart.
    fn square(n: usize, spacing: f32) -> Vec<Point> {
        let at = |i: usize| (i as f32 + 0.5) * spacing;
        (0..n * n).map(|i| [at(i % n), at(i / n), 0.0]).collect()
    }

    fn voxels(points: &[Point]) -> Voxels<'_> {
        Voxels { points, lowest: lowest_corner(points) }
    }

    fn size(points: &[Point]) -> f64 {
        let cloud = UsedCloud::new(points).unwrap();
        chosen(&cloud, &Control::default()).unwrap()
    }

    #[test]
    fn a_voxel_is_as_large_as_the_points_are_apart_and_larger_in_dense_clouds() {
        // 100 x 100 points 0.02 apart: 80 % of the voxels at 0.0224.
        assert_eq!(size(&square(100, 0.02)), 0.025);
        assert_eq!(size(&square(100, 20.0)), 25.0);
        // 600 x 600 points 0.001 apart are 0.36 square units: 32 000 voxels of 0.0034.
        assert_eq!(size(&square(600, 0.001)), 0.004);
        assert_eq!(size(&square(100, 0.02).repeat(3)), 0.025);
    }

    #[test]
    fn points_that_were_stored_twice_and_the_order_change_nothing() {
        for points in [square(100, 0.02), rings(16, 900), rings(64, 600)] {
            let expected = size(&points);
            let moved = |by: f32| points.iter().map(move |p| p.map(|v| v + by * (v * 1e4).fract()));
            let twice = |by: f32| points.iter().copied().chain(moved(by)).collect::<Vec<_>>();
            for by in [0.0, 1e-6, 1e-5] {
                assert_eq!(size(&twice(by)), expected, "{by}");
            }
            let reversed: Vec<Point> = twice(0.0).into_iter().rev().collect();
            assert_eq!(size(&reversed), expected);
        }
    }

    /// The points of a sensor with `num_beams` beams, 2 above a plane with walls 12 away.
    fn rings(num_beams: usize, num_columns: usize) -> Vec<Point> {
        let ray = |i: usize| {
            let azimuth = (i / num_beams) as f32 / num_columns as f32 * std::f32::consts::TAU;
            let elevation = (-15.0 + 30.0 * (i % num_beams) as f32 / (num_beams - 1) as f32).to_radians();
            let [x, y, z] = [azimuth.cos() * elevation.cos(), azimuth.sin() * elevation.cos(), elevation.sin()];
            let range = (12.0 / x.abs().max(y.abs())).min(if z < 0.0 { -2.0 / z } else { f32::INFINITY });
            [x, y, z].map(|v| v * range)
        };
        (0..num_beams * num_columns).map(ray).collect()
    }

    #[test]
    fn no_voxel_is_smaller_than_the_step_of_the_coordinates() {
        let points: Vec<Point> =
            rings(64, 600).iter().map(|&[x, y, z]| [x, (2.0 * y).round() / 2.0 - 0.1, z]).collect();
        assert_eq!(size(&points), 0.5);
        let cloud = UsedCloud::new(&points).unwrap();
        assert!(coarse_step(None, &cloud).is_some() && coarse_step(Some(Length::Units(1.0)), &cloud).is_none());
    }

    #[test]
    fn the_series_has_its_decimals() {
        assert_eq!([-11, -10, -4, 0, 1, 9, 10, 25].map(size_of), [0.08, 0.1, 0.4, 1.0, 1.25, 8.0, 10.0, 315.0]);
        assert!([0.3, 1.0, 7.9, 1e-3, 123.0].iter().all(|&size| size_of(step_of(size)) >= 0.999 * size));
    }

    #[test]
    fn clouds_without_extent_are_refused() {
        assert!(voxel_size(None, &UsedCloud::new(&[[1.0; 3]; 9]).unwrap(), &Control::default()).is_err());
        assert!(size(&[[0.0; 3], [1e-3, 0.0, 0.0]]) > 0.0);
    }

    #[test]
    fn the_default_fits_its_budget_whatever_the_distances_of_the_points() {
        let power = |i: usize, step: f32| 10_f32.powf(8.0 * (i as f32 * step).fract() - 4.0);
        let all_scales: Vec<Point> = (0..60_000)
            .map(|i| {
                let scale = power(i, 0.618_034);
                [0.754_877_7, 0.569_840_3, 0.324_718].map(|step| (i as f32 * step).fract() * scale)
            })
            .collect();
        // A statue of 0.1 in terrain of 200 x 200.
        let statue = square(250, 4e-4).into_iter().map(|[x, y, z]| [x + 100.0, y + 100.0, z]);
        let terrain = (0..20_000).map(|i| [0.618_034, 0.754_877_7].map(|step: f32| (i as f32 * step).fract() * 200.0));
        let mixed: Vec<Point> = terrain.map(|[x, y]| [x, y, 0.0]).chain(statue).collect();
        for points in [all_scales, mixed, rings(8, 3600), rings(16, 1800), rings(128, 1024)] {
            let cloud = UsedCloud::from_finite(FinitePoints::all((&points[..]).into()), points.len());
            let size = chosen(&cloud, &Control::default()).unwrap();
            assert!(voxels(&points).are_within_budget(size), "{size}");
            assert!(points.len() < 50_000 || !voxels(&points).are_within_budget(size / 100.0), "{size}");
        }
    }
}

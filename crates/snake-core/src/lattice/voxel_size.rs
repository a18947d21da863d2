//! The voxel size of a scene, where none is given.
//!
//! The rule asks how much the cloud shows. It takes the smallest size of the series 1, 1.25, 1.6, 2, 2.5, 3.15, 4, 5, 6.3, 8
//! (times any power of ten) at which
//!
//! - at most 80 % as many voxels hold points as there are different points: a voxel is then a little larger than the
//!   distance between neighbouring points. Of a sweep, whose points lie far apart where there is something to see, 95 %
//!   ([`UsedCloud::is_sweep`]); and
//! - at most [`MAX_VOXELS`] voxels hold points, which bounds the time of a dense cloud.
//!
//! Two clouds of one sensor so have the same size more often than by a rule without steps, and a room in millimetres has
//! a thousand times the size of the room in metres.

use rayon::prelude::*;
use snake_kernels::Scratch;

use crate::cloud::UsedCloud;
use crate::{Error, Result};
use snake_geometry::{Length, Point};

/// Voxels with points, at most: about as many as a sweep of 120 000 points has at 0.28 m.
const MAX_VOXELS: usize = 32_000;

/// Voxels with points, at most, for each different point; of a sweep the second.
const SHARES: [f64; 2] = [0.8, 0.95];

/// Steps of the series in a factor of ten.
const STEPS: i32 = 10;

/// The voxel size in cloud units: the given one, or the one of the rule for the finite points of a cloud.
pub(crate) fn voxel_size(given: Option<Length>, cloud: &UsedCloud) -> Result<f32> {
    match given {
        Some(size) => Ok(size.in_units("voxel_size", cloud.points())? as f32),
        None => chosen(cloud).map(|size| size as f32),
    }
}

fn chosen(cloud: &UsedCloud) -> Result<f64> {
    let points = cloud.points();
    let extent = (0..3).map(|axis| {
        let ends = points.iter().fold([f32::MAX, f32::MIN], |[low, high], p| [low.min(p[axis]), high.max(p[axis])]);
        f64::from(ends[1]) - f64::from(ends[0])
    });
    let extent = extent.fold(0.0, f64::max);
    if !(1e-15..1e15).contains(&extent) {
        let reason = format!("extent {extent:.1e}: a voxel size cannot be chosen; a cloud needs two different points");
        return Err(Error::Input { what: "points", reason });
    }
    let largest = step_of(extent);
    let distinct = num_voxels(points, size_of(largest - 6 * STEPS));
    let share = SHARES[usize::from(cloud.is_sweep())];
    let most = MAX_VOXELS.min((share * distinct as f64) as usize).max(1);
    // The smallest step that has few enough voxels; one voxel as large as the cloud is always few enough.
    let (mut too_small, mut fits) = (largest - 6 * STEPS, largest + 1);
    while fits - too_small > 1 {
        let middle = too_small + (fits - too_small) / 2;
        if num_voxels(points, size_of(middle)) <= most { fits = middle } else { too_small = middle }
    }
    Ok(size_of(fits))
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

/// The number of voxels of a size that hold points.
fn num_voxels(points: &[Point], size: f64) -> usize {
    let key = |point: &Point| {
        let [x, y, z] = point.map(|v| (f64::from(v) / size).floor() as i64 as u64 & 0x1F_FFFF);
        (z << 42) | (y << 21) | x
    };
    let mut keys = Scratch::collect(points.len(), points.iter().map(|point| (key(point), 0)));
    keys.par_sort_unstable();
    1 + keys.windows(2).filter(|pair| pair[0] != pair[1]).count()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A square of n x n points, `spacing` apart.
    fn square(n: usize, spacing: f32) -> Vec<Point> {
        let at = |i: usize| (i as f32 + 0.5) * spacing;
        (0..n * n).map(|i| [at(i % n), at(i / n), 0.0]).collect()
    }

    fn size(points: &[Point]) -> f64 {
        chosen(&UsedCloud::new(points).unwrap()).unwrap()
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
    fn the_series_has_its_decimals() {
        assert_eq!([-11, -10, -4, 0, 1, 9, 10, 25].map(size_of), [0.08, 0.1, 0.4, 1.0, 1.25, 8.0, 10.0, 315.0]);
        assert!([0.3, 1.0, 7.9, 1e-3, 123.0].iter().all(|&size| size_of(step_of(size)) >= 0.999 * size));
    }

    #[test]
    fn clouds_without_extent_are_refused() {
        assert!(chosen(&UsedCloud::new(&[[1.0; 3]; 9]).unwrap()).is_err());
        assert!(size(&[[0.0; 3], [1e-3, 0.0, 0.0]]) > 0.0);
    }
}

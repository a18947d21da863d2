//! SIFT 3D as in PCL: scale-space extrema of a scalar field on the points.

use std::num::NonZeroUsize;

use serde::{Deserialize, Serialize};

use super::{Response, among_distinct, by_falling_score, each_point, index_cloud};
use snake_core::{Control, Result};
use snake_geometry::{Length, Neighbors, Point, Vector, eigen, in_parallel, options};

/// The search ends at an octave that has fewer points.
const MIN_OCTAVE_POINTS: usize = 25;
/// The number of nearest points, itself included, among which a point must be an extremum.
const EXTREMUM_NEIGHBORS: NonZeroUsize = NonZeroUsize::MIN.saturating_add(24);

/// The scalar field whose extrema are searched.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SiftField {
    /// Surface variation: the smallest eigenvalue of the covariance divided by the sum of the
    /// three, 0 to 1/3. It is invariant to rotation.
    #[default]
    Curvature,
    /// The y coordinate, as in the wrapper behind the paper's tables. It is not invariant to rotation.
    Y,
}

options! {
    /// Options of [`sift3d`].
    pub struct Sift3dOptions {
        /// Standard deviation of the first octave's second Gaussian, and side of its voxels; both
        /// double with each octave.
        min_scale, with_min_scale: Length = Length::Resolutions(2.0);
        /// Maximum number of octaves.
        octaves, with_octaves: usize = 4, from 1 to 64;
        /// Number of differences of Gaussians per octave that are searched for extrema.
        scales_per_octave, with_scales_per_octave: usize = 8, from 1 to 64;
        /// Minimum absolute difference of Gaussians of an extremum, in the field's units.
        min_contrast, with_min_contrast: f64 = 0.0, from 0 or more;
        /// Scalar field: curvature (surface variation) or y (the coordinate, as in the paper's baseline).
        field, with_field: SiftField = SiftField::Curvature;
        /// Radius of the neighbourhood for the surface variation.
        curvature_radius, with_curvature_radius: Length = Length::Resolutions(6.0);
    }
}

/// SIFT 3D keypoints, by falling score. The score is the absolute difference of Gaussians, in the field's units.
///
/// Each octave reduces the previous octave's cloud to voxel means and blurs the field at
/// `scales_per_octave + 3` scales. An extremum is a difference between neighbouring scales that is
/// extreme among the 25 nearest points and exceeds both adjacent scales. A keypoint is the input
/// point nearest to an extremum; if several extrema have the same nearest point, the strongest counts.
///
/// # Errors
/// [`Error::Input`](snake_core::Error::Input) when the cloud has no finite points or is one point
/// repeated; [`Error::Option`](snake_core::Error::Option) when an option is outside its range.
pub fn sift3d(points: &[Point], options: &Sift3dOptions) -> Result<Vec<Response>> {
    sift3d_with(points, options, &Control::default())
}

/// [`sift3d`] with cancellation and a deadline.
///
/// # Errors
/// The errors of [`sift3d`]; [`Error::Cancelled`](snake_core::Error::Cancelled) and
/// [`Error::DeadlineExceeded`](snake_core::Error::DeadlineExceeded).
pub fn sift3d_with(points: &[Point], options: &Sift3dOptions, control: &Control) -> Result<Vec<Response>> {
    among_distinct(points, |points| find(points, options, control))
}

/// [`sift3d`] for finite, distinct points.
fn find(points: &[Point], options: &Sift3dOptions, control: &Control) -> Result<Vec<Response>> {
    options.check_ranges()?;
    let input = index_cloud(points)?;
    let min_scale = options.min_scale.resolve("min_scale", || input.resolution())?;
    let (mut positions, mut field) = (input.points.clone(), values(&input, options, control)?);
    let mut strongest = vec![f64::NEG_INFINITY; points.len()];
    for octave in 0..options.octaves {
        let scale = min_scale * 2_f64.powi(octave as i32);
        (positions, field) = thin(&positions, &field, scale);
        if positions.len() < MIN_OCTAVE_POINTS {
            break;
        }
        let cloud = Neighbors::new(positions)?;
        let differences = differences_of_gaussians(&cloud, &field, scale, options.scales_per_octave, control)?;
        for (position, contrast) in extrema(&cloud, &differences, options.min_contrast) {
            let place = &mut strongest[input.nearest(&position, NonZeroUsize::MIN)[0].0];
            *place = f64::max(*place, contrast);
        }
        positions = cloud.points;
    }
    let responses = strongest.into_iter().enumerate().map(|(index, score)| Response { index, score });
    Ok(by_falling_score(responses.filter(|response| response.score >= 0.0).collect()))
}

/// The field at each point.
fn values(cloud: &Neighbors, options: &Sift3dOptions, control: &Control) -> Result<Vec<f64>> {
    if options.field == SiftField::Y {
        return Ok(cloud.points.iter().map(|p| p.y).collect());
    }
    let radius = options.curvature_radius.resolve("curvature_radius", || cloud.resolution())?;
    cloud.check_density("curvature_radius", radius)?;
    let variation = |point: &Vector| {
        let (eigenvalues, _) = eigen(cloud.covariance(&cloud.within(point, radius)));
        let sum: f64 = eigenvalues.iter().sum();
        if sum > 0.0 { eigenvalues[0].max(0.0) / sum } else { 0.0 }
    };
    each_point(cloud, control, variation)
}

/// The mean point and the mean field value of every occupied voxel. The borders of the voxels are
/// multiples of `edge`.
fn thin(points: &[Vector], field: &[f64], edge: f64) -> (Vec<Vector>, Vec<f64>) {
    let voxel = |p: &Vector| -> [i64; 3] { (p / edge).map(|v| v.floor() as i64).into() };
    let mut order: Vec<([i64; 3], usize)> = points.iter().map(voxel).zip(0..).collect();
    order.sort_unstable();
    let mean = |voxel: &[([i64; 3], usize)]| {
        let count = voxel.len() as f64;
        let point = voxel.iter().map(|&(_, i)| points[i]).sum::<Vector>() / count;
        (point, voxel.iter().map(|&(_, i)| field[i]).sum::<f64>() / count)
    };
    order.chunk_by(|a, b| a.0 == b.0).map(mean).unzip()
}

/// The differences of the field between neighbouring scales of an octave, `[point][scale]`. Gaussians
/// are cut off at 3 sigma.
fn differences_of_gaussians(
    cloud: &Neighbors,
    field: &[f64],
    base: f64,
    scales: usize,
    control: &Control,
) -> Result<Vec<Vec<f64>>> {
    let sigmas: Vec<f64> = (0..scales + 3).map(|i| base * 2_f64.powf((i as f64 - 1.0) / scales as f64)).collect();
    let reach = 3.0 * sigmas[scales + 2];
    let differences = |point: &Vector| {
        let neighbors: Vec<(f64, f64)> = cloud
            .within(point, reach)
            .into_iter()
            .map(|i| ((cloud.points[i] - point).norm_squared(), field[i]))
            .collect();
        let blurred = sigmas.iter().map(|sigma| {
            let (mut sum, mut weights) = (0.0, 0.0);
            for &(squared, value) in neighbors.iter().filter(|(squared, _)| *squared <= 9.0 * sigma * sigma) {
                let weight = (-0.5 * squared / (sigma * sigma)).exp();
                sum += weight * value;
                weights += weight;
            }
            sum / weights
        });
        blurred.collect::<Vec<_>>().windows(2).map(|pair| pair[1] - pair[0]).collect()
    };
    each_point(cloud, control, differences)
}

/// Positions of the extrema, and the absolute values there.
fn extrema(cloud: &Neighbors, differences: &[Vec<f64>], min_contrast: f64) -> Vec<(Vector, f64)> {
    let extrema = |index: usize| {
        let neighbors = cloud.nearest(&cloud.points[index], EXTREMUM_NEIGHBORS);
        let is_maximum = |sign: f64, scale: usize| {
            let value = sign * differences[index][scale];
            let largest = |scale: usize| {
                neighbors.iter().map(|&(i, _)| sign * differences[i][scale]).fold(f64::NEG_INFINITY, f64::max)
            };
            value >= largest(scale) && value > largest(scale - 1) && value > largest(scale + 1)
        };
        let contrast = |scale: usize| differences[index][scale].abs();
        (1..differences[index].len() - 1)
            .filter(|&scale| contrast(scale) >= min_contrast && (is_maximum(1.0, scale) || is_maximum(-1.0, scale)))
            .map(|scale| (cloud.points[index], contrast(scale)))
            .collect::<Vec<_>>()
    };
    in_parallel(0..cloud.points.len(), extrema).concat()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn on_line(positions: &[f64]) -> Vec<Vector> {
        positions.iter().map(|&x| Vector::new(x, 0.0, 0.0)).collect()
    }

    #[test]
    fn voxels_lie_on_multiples_of_their_edge() {
        let points = on_line(&[0.1, 0.7, -0.1, 1.0, 0.4]);
        let (means, field) = thin(&points, &[1.0, 2.0, 5.0, 7.0, 6.0], 1.0);
        assert_eq!(field, [5.0, 3.0, 7.0]);
        assert!(means.iter().zip(on_line(&[-0.1, 0.4, 1.0])).all(|(a, b)| (a - b).norm() < 1e-12));
    }

    #[test]
    fn differences_of_gaussians_by_hand() {
        // With one scale per octave the standard deviations are half the base, the base, twice and four times the
        // base. The neighbour is 2 away: beyond 3 sigma of the first Gaussian and within 3 sigma of the others.
        let cloud = Neighbors::new(on_line(&[0.0, 2.0])).unwrap();
        let differences = differences_of_gaussians(&cloud, &[0.0, 1.0], 1.0, 1, &Control::default()).unwrap();
        let blurred = |sigma: f64| {
            let weight = (-0.5 * (2.0 / sigma).powi(2)).exp();
            weight / (1.0 + weight)
        };
        let expected = [blurred(1.0) - 0.0, blurred(2.0) - blurred(1.0), blurred(4.0) - blurred(2.0)];
        assert!(differences[0].iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12), "{differences:?}");
        assert!(differences[1].iter().zip(expected).all(|(a, b)| (a + b).abs() < 1e-12), "{differences:?}");
    }

    #[test]
    fn extrema_beat_their_neighbours_and_the_adjacent_scales() {
        // 30 points on a line: the first sees points 0 to 24, the last 5 to 29.
        let cloud = Neighbors::new(on_line(&(0..30).map(f64::from).collect::<Vec<_>>())).unwrap();
        let mut differences = vec![vec![0.0; 4]; 30];
        differences[0] = vec![0.5, 2.0, 1.0, 0.0]; // a maximum at scale 1
        differences[29] = vec![0.0, 0.0, -3.0, -4.0]; // the minimum of its scale, but smaller at the next
        assert_eq!(extrema(&cloud, &differences, 0.0), [(cloud.points[0], 2.0)]);
        differences[29][3] = 0.0;
        assert_eq!(extrema(&cloud, &differences, 0.0), [(cloud.points[0], 2.0), (cloud.points[29], 3.0)]);
        assert_eq!(extrema(&cloud, &differences, 2.5), [(cloud.points[29], 3.0)]);
        differences[12][1] = 2.5; // a neighbour of both ends: the first is no longer a maximum
        assert_eq!(extrema(&cloud, &differences, 2.5), [(cloud.points[12], 2.5), (cloud.points[29], 3.0)]);
    }

    #[test]
    fn a_bump_on_a_plane_is_the_strongest() {
        let plane = |i: u32| {
            let (x, y) = ((i % 50) as f32 * 0.1, (i / 50) as f32 * 0.1);
            let squared = (x - 2.0).powi(2) + (y - 3.0).powi(2);
            [x, y, 0.4 * (-squared / 0.08).exp()]
        };
        let points: Vec<Point> = (0..2500).map(plane).collect();
        let strongest = points[sift3d(&points, &Sift3dOptions::default()).unwrap()[0].index];
        let distance = ((strongest[0] - 2.0).powi(2) + (strongest[1] - 3.0).powi(2)).sqrt();
        assert!(distance < 0.3, "{strongest:?}");
    }

    #[test]
    fn fields_options_and_octaves_matter() {
        let wave = |i: u32| [(i % 60) as f32 * 0.1, (i / 60) as f32 * 0.1, ((i % 60) as f32 * 0.4).sin()];
        let points: Vec<Point> = (0..3600).map(wave).collect();
        let keypoints = |options: Sift3dOptions| sift3d(&points, &options).unwrap();
        let default = Sift3dOptions::default();
        let all = keypoints(default);
        assert!(all.len() > 10);
        assert_ne!(keypoints(Sift3dOptions { field: SiftField::Y, ..default }), all);
        assert_ne!(keypoints(Sift3dOptions { min_scale: Length::Resolutions(3.0), ..default }), all);
        assert_ne!(keypoints(Sift3dOptions { scales_per_octave: 3, ..default }), all);
        assert!(keypoints(Sift3dOptions { octaves: 1, ..default }).len() < all.len());
        let median = all[all.len() / 2].score;
        let strong: Vec<_> = all.iter().copied().filter(|response| response.score >= median).collect();
        assert_eq!(keypoints(Sift3dOptions { min_contrast: median, ..default }), strong);
        // Fewer than 25 voxels end the search.
        assert_eq!(keypoints(Sift3dOptions { min_scale: Length::Units(100.0), ..default }), []);
    }
}

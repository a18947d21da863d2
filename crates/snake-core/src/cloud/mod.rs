//! The used points of a cloud, which are finite and neither outliers nor missing returns, and measures that are taken once.

mod coordinate_step;
mod haze;
mod scene_signs;
mod sweep;

pub(crate) use self::coordinate_step::CoordinateStep;
pub use self::scene_signs::{NUM_SIGNS, scene_signs};
pub(crate) use self::sweep::is_seen_from_within;

use std::sync::OnceLock;

use crate::Result;
use snake_geometry::{FinitePoints, Outliers, Point};

/// A cloud as it is used. Its finite points are found once and its properties are computed once, so choosing a model,
/// encoding and hints share the work.
///
/// ```
/// use snake_core::{Builtin, Control, Model, UsedCloud};
/// # let points: Vec<[f32; 3]> = (0..500).map(|i| { let a = i as f32 * 0.1; [a.cos(), a.sin(), (a * 0.3).sin()] }).collect();
/// let cloud = UsedCloud::new(&points)?;
/// let model = Model::builtin(if cloud.is_sweep() { Builtin::Scenes } else { Builtin::Compact });
/// let detection = model.detect_cloud(&cloud, model.recommended(), &Control::default())?;
/// # assert!(!detection.keypoints.is_empty());
/// # Ok::<(), snake_core::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct UsedCloud<'a> {
    finite: FinitePoints<'a>,
    num_given: usize,
    is_sweep: OnceLock<bool>,
    coordinate_step: OnceLock<Option<CoordinateStep>>,
    /// The voxel size that suits the density, as a step of the [series](crate::lattice::voxel_size).
    pub(crate) voxel_step: OnceLock<i32>,
}

impl<'a> UsedCloud<'a> {
    /// The used points of a cloud `(N, 3)`: finite points that are neither outliers nor missing returns. Copied only if some are left out.
    ///
    /// # Errors
    /// [`Error::Input`](crate::Error::Input) for a cloud without finite points.
    pub fn new(points: &'a [Point]) -> Result<Self> {
        Ok(Self::from_finite(FinitePoints::clean("points", points, None)?, points.len()))
    }

    /// The used points of a cloud of `num_given` points.
    pub(crate) fn from_finite(finite: FinitePoints<'a>, num_given: usize) -> Self {
        let (is_sweep, coordinate_step, voxel_step) = Default::default();
        Self { finite, num_given, is_sweep, coordinate_step, voxel_step }
    }

    /// The points that are used, in the given order.
    pub fn points(&self) -> &[Point] {
        &self.finite.points
    }

    /// Number of points of the cloud, including those that are not used.
    pub fn num_given(&self) -> usize {
        self.num_given
    }

    /// The outliers that were left out, far beyond all other points; `None` for a cloud without outliers.
    pub fn outliers(&self) -> Option<Outliers> {
        self.finite.outliers()
    }

    /// One sentence for each kind of points that were left out.
    pub fn findings(&self) -> Vec<String> {
        self.finite.findings()
    }

    /// Whether it looks like the sweep of a sensor at its centre.
    pub fn is_sweep(&self) -> bool {
        *self.is_sweep.get_or_init(|| sweep::is_sweep(self.points()))
    }

    /// The share of isolated points in the air, such as the floaters of splats; `None` without such a haze.
    pub fn haze(&self) -> Option<f64> {
        haze::haze(self.points())
    }

    /// The step of the coordinates, along the axis where it is largest.
    pub(crate) fn coordinate_step(&self) -> Option<CoordinateStep> {
        *self.coordinate_step.get_or_init(|| coordinate_step::coordinate_step(self.points()))
    }

    /// The same cloud, copied if it is borrowed.
    pub fn into_owned(self) -> UsedCloud<'static> {
        let Self { finite, num_given, is_sweep, coordinate_step, voxel_step } = self;
        UsedCloud { finite: finite.into_owned(), num_given, is_sweep, coordinate_step, voxel_step }
    }

    pub(crate) fn into_finite(self) -> FinitePoints<'a> {
        self.finite
    }
}

/// The quantile of the values at a share in [0, 1]. There must be values.
pub(crate) fn quantile(mut values: Vec<f64>, share: f64) -> f64 {
    let rank = (share * (values.len() - 1) as f64) as usize;
    *values.select_nth_unstable_by(rank, f64::total_cmp).1
}

#[cfg(test)]
pub(crate) mod tests {
    use crate::{Builtin, Detection, FrameDetector, Model};
    use snake_geometry::Point;

    pub(crate) fn sphere(number: usize, radius: f32) -> Vec<Point> {
        let point = |i: usize| {
            let z = 2.0 * (i as f32 + 0.5) / number as f32 - 1.0;
            let (sin, cos) = (i as f32 * 2.4).sin_cos();
            let flat = (1.0 - z * z).sqrt();
            [radius * flat * cos, radius * flat * sin, radius * z]
        };
        (0..number).map(point).collect()
    }

    #[test]
    fn missing_returns_change_no_keypoint_of_a_cloud_or_a_frame() {
        let object = (0..2000).map(|i| {
            let (sin, cos) = (i as f32 * 0.754_877_7).sin_cos();
            [5.0 + cos * (i as f32 * 0.01).sin(), sin, (i as f32 * 0.001).fract()]
        });
        let clean: Vec<Point> = object.collect();
        let dirty: Vec<Point> = clean.iter().flat_map(|point| [[0.0; 3], *point]).collect();
        let model = Model::builtin(Builtin::Compact);
        let detect = |points: &[Point]| model.detect(points, model.recommended()).unwrap();
        let (expected, detection, mut frame) = (detect(&clean), detect(&dirty), Detection::default());
        let mut frames = FrameDetector::new(model.clone(), *model.recommended()).unwrap();
        frames.detect_into(&dirty, &mut frame).unwrap();
        assert!(!expected.keypoints.is_empty() && expected.keypoints.len() == detection.keypoints.len());
        for (keypoint, expected) in
            detection.keypoints.iter().chain(&frame.keypoints).zip(expected.keypoints.iter().cycle())
        {
            assert_eq!(keypoint.position, expected.position);
            assert_eq!(keypoint.nearest_index, 2 * expected.nearest_index + 1);
        }
        assert_eq!((detection.num_skipped, frame.num_skipped), (2000, 2000));
    }
}

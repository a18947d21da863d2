//! Options for a detection that must end within a given time.

use std::time::{Duration, Instant};

use crate::Model;
use crate::detect::Detection;
use crate::lattice::TimeBudget;
use crate::live::detector::FrameDetector;
use crate::options::Options;
use crate::{Error, Result};
use snake_geometry::{Length, NormalizationMethod, Point};

/// Query resolutions from fine to coarse.
const RESOLUTIONS: [usize; 4] = [64, 48, 32, 24];
/// Numbers of encoded points whose run times are measured.
const SAMPLES: [usize; 2] = [2048, 16_384];
/// Sizes of a voxel of a scene model, in resolutions of the cloud.
const VOXELS: [f64; 11] = [1.25, 1.6, 2.0, 2.5, 3.15, 4.0, 5.0, 6.3, 8.0, 10.0, 12.5];
/// The finest query grid is chosen that still allows this many encoded points.
const MIN_POINTS: usize = 8192;
/// Numbers of points are rounded down to a multiple of this.
const STEP: usize = 1024;
/// The most points of the made cloud, which takes 12 bytes a point.
const MAX_POINTS: usize = 100_000_000;
/// Detections beside the first one that are measured; the median counts.
const REPEATS: usize = 5;
/// The part of the target that the budget uses. The rest is for clouds that are harder than the measured one.
const SHARE: f64 = 0.5;

impl Model {
    /// [`Model::recommended`] with as many points and queries as a detection may have to end within `target` on this
    /// machine: [`EncodeOptions::max_points`](crate::EncodeOptions::max_points) and
    /// [`DetectOptions::query_resolution`](crate::DetectOptions::query_resolution). Clouds are encoded as they lie, not in
    /// their principal axes: consecutive frames of a sensor lie alike, while their principal axes may change places.
    ///
    /// A scene model keeps all points. Its budget is the size of a voxel
    /// ([`EncodeOptions::voxel_size`](crate::EncodeOptions::voxel_size)), in resolutions of the cloud.
    ///
    /// Detections of a made cloud of `num_points` points are measured, on the current Rayon pool, so call this in the pool
    /// that will detect, once. The options then fix the results: the same options give the same keypoints on any machine.
    /// Keep them, as JSON for example, to repeat a run. The target is not guaranteed: a
    /// [deadline](crate::Control::deadline) stops what takes too long. If not even the smallest budget of 1024 points, or of
    /// voxels of 12.5 resolutions, meets the target, the smallest budget is returned.
    ///
    /// # Errors
    /// [`Error::Option`] for a target of zero, for fewer than two points or more than 10⁸.
    pub fn realtime_options(&self, target: Duration, num_points: usize) -> Result<Options> {
        if target.is_zero() {
            return Err(Error::Option { name: "target", value: "0".into(), allowed: "above 0 (seconds)" });
        }
        if !(2..=MAX_POINTS).contains(&num_points) {
            let allowed = "2 to 100000000";
            return Err(Error::Option { name: "num_points", value: num_points.to_string(), allowed });
        }
        let cloud = room(num_points);
        let seconds_of_budget = target.as_secs_f64() * SHARE;
        match self.config().volume.time_budget() {
            TimeBudget::VoxelSize => self.largest_voxels(&cloud, seconds_of_budget),
            TimeBudget::PointsAndQueries => self.most_points(&cloud, seconds_of_budget),
        }
    }

    /// The options with the finest query grid for which enough points can be encoded in the time.
    fn most_points(&self, cloud: &[Point], seconds_of_budget: f64) -> Result<Options> {
        let mut best = None;
        for query_resolution in RESOLUTIONS {
            let mut seconds = [0.0; 2];
            for (seconds, max_points) in seconds.iter_mut().zip(SAMPLES) {
                *seconds = self.median_seconds(cloud, self.budget(query_resolution, max_points))?;
            }
            let points = affordable_points(seconds, seconds_of_budget);
            best = Some(self.budget(query_resolution, points));
            if points >= MIN_POINTS {
                break;
            }
        }
        Ok(best.unwrap_or(*self.recommended()))
    }

    /// The options of a scene model with the smallest voxels that take at most `seconds`.
    fn largest_voxels(&self, cloud: &[Point], seconds: f64) -> Result<Options> {
        let recommended = *self.recommended();
        let with = |voxel_size| recommended.with_encode(recommended.encode.with_voxel_size(voxel_size));
        let mut budget = recommended;
        for voxel_size in [None].into_iter().chain(VOXELS.map(|number| Some(Length::Resolutions(number)))) {
            budget = with(voxel_size);
            if self.median_seconds(cloud, budget)? <= seconds {
                break;
            }
        }
        Ok(budget)
    }

    fn budget(&self, query_resolution: usize, max_points: usize) -> Options {
        let Options { encode, detect, .. } = *self.recommended();
        let normalization = match encode.normalization {
            NormalizationMethod::PrincipalAxes => NormalizationMethod::UnitSphere,
            as_it_lies => as_it_lies,
        };
        let encode = encode.with_max_points(Some(max_points)).with_normalization(normalization);
        Options::default().with_encode(encode).with_detect(detect.with_query_resolution(query_resolution))
    }

    fn median_seconds(&self, cloud: &[Point], options: Options) -> Result<f64> {
        let mut detector = FrameDetector::new(self.clone(), options)?;
        let mut detection = Detection::default();
        let mut seconds = [0.0; REPEATS];
        detector.detect_into(cloud, &mut detection)?;
        for seconds in &mut seconds {
            let start = Instant::now();
            detector.detect_into(cloud, &mut detection)?;
            *seconds = start.elapsed().as_secs_f64();
        }
        seconds.sort_by(f64::total_cmp);
        Ok(seconds[REPEATS / 2])
    }
}

/// The number of points that can be encoded in a time, given the run times of [`SAMPLES`]. At least [`STEP`].
fn affordable_points([few, many]: [f64; 2], seconds: f64) -> usize {
    // A run on a busy machine can make more points look cheaper; the price is then that of the larger sample alone.
    let rise = (many - few) / (SAMPLES[1] - SAMPLES[0]) as f64;
    let per_point = if rise > 0.0 { rise } else { many / SAMPLES[1] as f64 };
    let points = SAMPLES[1] as f64 + (seconds - many) / per_point;
    (points as usize / STEP * STEP).max(STEP)
}

/// A made cloud: the floor, two walls and a ball in a room.
fn room(num_points: usize) -> Vec<Point> {
    let point = |i: usize| {
        let (u, v) = ((i as f32 * 0.754_877_7).fract(), (i as f32 * 0.569_840_3).fract());
        match i % 4 {
            0 => [10.0 * u, 10.0 * v, 0.0],
            1 => [10.0 * u, 0.0, 3.0 * v],
            2 => [0.0, 10.0 * u, 3.0 * v],
            _ => {
                let (angle, z) = (std::f32::consts::TAU * u, 2.0 * v - 1.0);
                let ring = (1.0 - z * z).max(0.0).sqrt();
                [5.0 + ring * angle.cos(), 5.0 + ring * angle.sin(), 1.0 + z]
            }
        }
    };
    (0..num_points).map(point).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Builtin;

    #[test]
    fn a_larger_target_affords_more_points() {
        let points = |seconds| affordable_points([0.010, 0.024], seconds);
        assert_eq!([points(0.024), points(0.010), points(0.031)], [16_384, 2048, 23_552]);
        assert_eq!([points(0.001), points(0.0)], [STEP; 2]);
        // A second sample that seems to cost nothing.
        assert_eq!(affordable_points([0.020, 0.016], 0.032), 32_768);
    }

    #[test]
    fn a_budget_gives_the_same_keypoints_each_time_and_meets_the_target_where_it_can() {
        let model = Model::builtin(Builtin::Compact);
        let cloud = room(5000);
        for milliseconds in [1, 200] {
            let options = model.realtime_options(Duration::from_millis(milliseconds), cloud.len()).unwrap();
            let detection = model.detect(&cloud, &options).unwrap();
            assert!(detection.num_encoded <= options.encode.max_points.unwrap());
            assert_eq!(options.encode.normalization, NormalizationMethod::UnitSphere);
            let read: Options = serde_json::from_str(&serde_json::to_string(&options).unwrap()).unwrap();
            let one_thread = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
            let again = one_thread.install(|| model.detect(&cloud, &read)).unwrap();
            assert_eq!((again.keypoints, again.counts), (detection.keypoints, detection.counts));
        }
    }

    #[test]
    fn a_scene_keeps_its_points_and_has_larger_voxels_for_a_shorter_time() {
        let model = Model::builtin(Builtin::Scenes);
        let cloud = room(3000);
        let size = |target| model.realtime_options(target, cloud.len()).unwrap().encode.voxel_size;
        assert_eq!(size(Duration::from_secs(1000)), None);
        assert_eq!(size(Duration::from_nanos(1)), Some(Length::Resolutions(12.5)));
        let options = model.realtime_options(Duration::from_nanos(1), cloud.len()).unwrap();
        let detection = model.detect(&cloud, &options).unwrap();
        assert_eq!(detection.num_encoded, cloud.len());
        assert!(detection.voxel_size > model.detect(&cloud, model.recommended()).unwrap().voxel_size);
    }

    #[test]
    fn impossible_budgets_are_refused() {
        let error = |model: Builtin, target, num_points| {
            Model::builtin(model).realtime_options(target, num_points).unwrap_err().to_string()
        };
        let second = Duration::from_secs(1);
        assert!(error(Builtin::Compact, Duration::ZERO, 100).contains("target"));
        for num_points in [1, 100_000_001, usize::MAX] {
            assert!(error(Builtin::Compact, second, num_points).contains("num_points"));
        }
    }
}

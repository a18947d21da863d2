//! Rigid registration: finds the rotation and translation that map one point cloud onto another, without an initial
//! guess. It matches keypoints by descriptors, estimates a transform with RANSAC and refines it with ICP. Keypoints and
//! descriptors come from a SNAKE model or from classical methods ([`detectors`], [`fpfh`]).
//!
//! ```text
//! cloud → keypoints ─────────────────────┐
//!   └──→ voxels → normals → descriptors ─┴→ mutual nearest → RANSAC → ICP on the voxels → t_target_source
//! ```
//!
//! [`register`] runs all steps. A [`Scan`] computes keypoints and descriptors of one cloud. [`fpfh`],
//! [`mutual_nearest`], [`ransac`] and [`kabsch`] are the single steps:
//!
//! ```
//! use snake_core::RigidTransform;
//! use snake_registration::{RansacOptions, ransac, transform_points};
//! let source = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 3.0], [1.0, 1.0, 1.0]];
//! let rows = [[0.0, -1.0, 0.0, 3.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];
//! let t_target_source = RigidTransform::from_matrix(rows)?;
//! let mut target = transform_points(&t_target_source, &source);
//! target[4] = [9.0, 9.0, 9.0]; // a wrong correspondence
//! let found = ransac(&source, &target, &RansacOptions::default())?.expect("four correspondences agree");
//! assert_eq!(found.inliers, [0, 1, 2, 3]);
//! # Ok::<(), snake_core::Error>(())
//! ```
//!
//! `t_target_source` maps a point from the source frame to the target frame: `p_target = R p_source + t`. Results have
//! the same bits for any number of threads.

#![forbid(unsafe_code)]

mod cloud;
pub mod detectors;
mod fpfh;
mod icp;
mod matching;
mod ransac;
mod rigid;
mod scan;

use std::time::Instant;

use serde::{Deserialize, Serialize};

use snake_core::Control;
use snake_core::Length;
use snake_core::Model;
use snake_core::space::FinitePoints;
use snake_core::space::resolution;
use snake_core::space::vector;
use snake_core::{Error, Result, setters};
use snake_core::{Normalization, NormalizationMethod, Point, RigidTransform};

use icp::{fitness, icp};
use matching::matches;
use ransac::{Pair, best_transform, consensus};
use scan::reduce;

pub use cloud::estimate_normals;
pub use fpfh::{FPFH_DIMENSION, fpfh};
pub use matching::mutual_nearest;
pub use ransac::{Consensus, RansacOptions, ransac};
pub use rigid::{kabsch, transform_points};
pub use scan::{Descriptor, KeypointDetector, Scan};

/// Options of [`register`].
///
/// A length that is `None` is derived from the clouds. A length in resolutions refers to the coarser of the two clouds.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct RegisterOptions {
    /// The keypoint detector.
    pub detector: KeypointDetector,
    /// The descriptor that matches keypoints.
    pub descriptor: Descriptor,
    /// Maximum number of keypoints per cloud; the best are kept.
    pub max_keypoints: usize,
    /// Side of the voxels for normals, FPFH and refinement. `None`: 1/80 of the smaller cloud's diameter, which is
    /// twice the largest distance of a point from the mean.
    pub voxel_size: Option<Length>,
    /// Radius of normals. `None`: twice the spacing, which is the voxel size or, if that is greater, the mean distance
    /// between neighbours in the reduced clouds.
    pub normal_radius: Option<Length>,
    /// Radius of FPFH. `None`: 7 times the spacing.
    pub feature_radius: Option<Length>,
    /// A correspondence agrees with a transform that brings its points closer than this. `None`: 1.5 times the spacing.
    pub inlier_distance: Option<Length>,
    /// See [`RansacOptions::edge_length_ratio`].
    pub edge_length_ratio: f64,
    /// Maximum number of RANSAC samples, see [`RansacOptions::max_iterations`].
    pub max_iterations: usize,
    /// See [`RansacOptions::confidence`].
    pub confidence: f64,
    /// Seed of the RANSAC samples and of random keypoints.
    pub seed: u64,
    /// Maximum number of point-to-plane ICP steps on the reduced clouds; 0 skips ICP. Pairs are closer than
    /// `inlier_distance`.
    pub refine_steps: usize,
}

setters!(RegisterOptions {
    detector: KeypointDetector => with_detector,
    descriptor: Descriptor => with_descriptor,
    max_keypoints: usize => with_max_keypoints,
    voxel_size: Option<Length> => with_voxel_size,
    normal_radius: Option<Length> => with_normal_radius,
    feature_radius: Option<Length> => with_feature_radius,
    inlier_distance: Option<Length> => with_inlier_distance,
    edge_length_ratio: f64 => with_edge_length_ratio,
    max_iterations: usize => with_max_iterations,
    confidence: f64 => with_confidence,
    seed: u64 => with_seed,
    refine_steps: usize => with_refine_steps,
});

impl Default for RegisterOptions {
    fn default() -> Self {
        let RansacOptions { edge_length_ratio, max_iterations, confidence, seed, .. } = RansacOptions::default();
        Self {
            detector: KeypointDetector::default(),
            descriptor: Descriptor::default(),
            max_keypoints: 2500,
            voxel_size: None,
            normal_radius: None,
            feature_radius: None,
            inlier_distance: None,
            edge_length_ratio,
            max_iterations,
            confidence,
            seed,
            refine_steps: 30,
        }
    }
}

/// The result of [`register`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Registration {
    /// Maps source points to the target frame: `p_target = R p_source + t`.
    pub t_target_source: RigidTransform,
    /// Number of correspondences that RANSAC's transform brings closer than `inlier_distance`; ICP starts from that
    /// transform. Do not trust the result if they are few or a small share of all correspondences.
    pub num_inliers: usize,
    /// Number of keypoint pairs that are mutual nearest neighbours in descriptor space.
    pub num_correspondences: usize,
    /// Root mean square distance of these inliers under RANSAC's transform, in cloud units; 0 without inliers. It
    /// measures how precisely keypoints repeat, not the error of `t_target_source`.
    pub rmse: f64,
    /// The distance below which correspondences agree and voxels overlap, in cloud units.
    pub inlier_distance: f64,
    /// Share of the source's voxels, 0 to 1, that `t_target_source` brings closer than `inlier_distance` to a voxel of
    /// the target (Open3D's fitness). The other voxels do not overlap the target, or the transform is wrong.
    pub fitness: f64,
    /// Root mean square distance of these voxels to their nearest ones, in cloud units (Open3D's inlier RMSE); 0
    /// without any. A correct transform gives about the mean distance between neighbours.
    pub fitness_rmse: f64,
    /// Number of source and target points that were skipped because they are not finite.
    pub num_skipped: [usize; 2],
    /// Run time.
    pub seconds: f64,
}

impl Registration {
    /// Converts the transform from points relative to an origin (see [`Cloud`](snake_core::Cloud)) to points with their
    /// origins added.
    pub fn between_origins(mut self, source: [f64; 3], target: [f64; 3]) -> Self {
        self.t_target_source = self.t_target_source.add_origins(source, target);
        self
    }
}

/// Finds the rigid transform from `source` `(N, 3)` to `target` `(M, 3)` without an initial guess.
///
/// Both clouds are in the same units; they may overlap only in part.
///
/// ```
/// use snake_core::{Builtin, Model, RigidTransform};
/// use snake_registration::{RegisterOptions, register, transform_points};
/// # let source = snake_io::read_points(concat!(env!("CARGO_MANIFEST_DIR"), "/../../samples/plane.ply").as_ref())?;
/// let rows = [[0.0, -1.0, 0.0, 3.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];
/// let t_target_source = RigidTransform::from_matrix(rows)?;
/// let target = transform_points(&t_target_source, &source);
/// let found = register(&source, &target, &Model::builtin(Builtin::Compact), &RegisterOptions::default())?;
/// let (angle, distance) = found.t_target_source.angle_and_distance_to(&t_target_source);
/// assert!(angle < 0.05 && distance < 0.05 && found.num_inliers > 50);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`Error::Input`] for a cloud without finite points or without extent, and when too few correspondences are found or
/// none of them agree; [`Error::Option`] when an option is outside its range.
pub fn register(source: &[Point], target: &[Point], model: &Model, options: &RegisterOptions) -> Result<Registration> {
    register_with(source, target, model, options, &Control::default())
}

/// [`register`] with progress and cancellation; a classical detector is not interrupted.
///
/// # Errors
/// The errors of [`register`]; [`Error::Cancelled`] and [`Error::DeadlineExceeded`].
pub fn register_with(
    source: &[Point],
    target: &[Point],
    model: &Model,
    options: &RegisterOptions,
    control: &Control,
) -> Result<Registration> {
    let start = Instant::now();
    options.check()?;
    let (num_source, num_target) = (source.len(), target.len());
    let (source, target) = (FinitePoints::of("source", source)?.points, FinitePoints::of("target", target)?.points);
    let (source, target) = (&source[..], &target[..]);
    let [voxel_size, normal_radius, feature_radius, inlier_distance] = options.lengths(source, target)?;
    let voxel_size = match voxel_size {
        Some(size) => size,
        None => diameter("source", source)?.min(diameter("target", target)?) / VOXELS_PER_DIAMETER,
    };
    let source_voxels = reduce(source, voxel_size, control)?;
    let target_voxels = reduce(target, voxel_size, control)?;
    // In a sparse cloud most voxels hold one point, and the voxel size is less than the distance between neighbours.
    let spacing = voxel_size.max(source_voxels.resolution()).max(target_voxels.resolution());
    let lengths = [voxel_size, normal_radius.unwrap_or(2.0 * spacing), feature_radius.unwrap_or(7.0 * spacing)];
    let source_scan = Scan::of(source, source_voxels, model, lengths, control)?;
    let target_scan = Scan::of(target, target_voxels, model, lengths, control)?;

    let describe = |scan: &Scan, seed| -> Result<(Vec<Point>, Vec<f32>)> {
        let keypoints = scan.keypoints_with(options.detector, options.max_keypoints, seed, control)?;
        let descriptors = scan.descriptors_with(&keypoints, options.descriptor, control)?;
        Ok((keypoints, descriptors))
    };
    // The clouds get different random keypoints. With one seed, equal clouds would have a partner for every keypoint.
    let (source_keypoints, source_descriptors) = describe(&source_scan, options.seed)?;
    let (target_keypoints, target_descriptors) = describe(&target_scan, options.seed.wrapping_add(1))?;
    let dimension = source_scan.dimension(options.descriptor);
    let matches = matches(&source_descriptors, &target_descriptors, dimension, control)?;
    let pairs: Vec<Pair> =
        matches.iter().map(|&[s, t]| (vector(source_keypoints[s]), vector(target_keypoints[t]))).collect();

    let ransac_options = options.ransac(inlier_distance.unwrap_or(1.5 * spacing));
    let Some(rough) = best_transform(&pairs, &ransac_options, control)? else {
        let (of_source, of_target) = (source_keypoints.len(), target_keypoints.len());
        let reason = format!(
            "no three of the {} correspondences, of {of_source} and {of_target} keypoints, fit a rigid transform; do the clouds overlap, and in the same units?",
            pairs.len()
        );
        return Err(Error::Input { what: "source and target", reason });
    };
    let inlier_distance = ransac_options.inlier_distance;
    let Scan { voxels, normals, .. } = &target_scan;
    let (source_voxels, steps) = (&source_scan.voxels.points, options.refine_steps);
    let transform = icp(source_voxels, voxels, normals, rough, inlier_distance, steps, control)?;
    let Consensus { inliers, rmse, .. } = consensus(&pairs, &rough, inlier_distance);
    let (fitness, fitness_rmse) = fitness(source_voxels, voxels, &transform, inlier_distance);
    Ok(Registration {
        t_target_source: transform.into(),
        num_inliers: inliers.len(),
        num_correspondences: pairs.len(),
        rmse,
        inlier_distance,
        fitness,
        fitness_rmse,
        num_skipped: [num_source - source.len(), num_target - target.len()],
        seconds: start.elapsed().as_secs_f64(),
    })
}

/// Default number of voxels along the diameter of the smaller cloud.
const VOXELS_PER_DIAMETER: f64 = 80.0;

impl RegisterOptions {
    fn check(&self) -> Result<()> {
        if self.max_keypoints < 3 {
            let value = self.max_keypoints.to_string();
            return Err(Error::Option { name: "max_keypoints", value, allowed: "3 or more" });
        }
        self.ransac(1.0).check()
    }

    /// The lengths that are set, in cloud units: voxel size, radius of normals, radius of FPFH, inlier distance.
    fn lengths(&self, source: &[Point], target: &[Point]) -> Result<[Option<f64>; 4]> {
        let given = [
            ("voxel_size", self.voxel_size),
            ("normal_radius", self.normal_radius),
            ("feature_radius", self.feature_radius),
            ("inlier_distance", self.inlier_distance),
        ];
        let is_multiple = |length: Option<Length>| matches!(length, Some(Length::Resolutions(_)));
        let coarser = match given.iter().any(|(_, length)| is_multiple(*length)) {
            true => resolution("source", source)?.max(resolution("target", target)?),
            false => 0.0,
        };
        let mut lengths = [None; 4];
        for (slot, (name, length)) in lengths.iter_mut().zip(given) {
            *slot = length.map(|length| length.resolve(name, || coarser)).transpose()?;
        }
        Ok(lengths)
    }

    fn ransac(&self, inlier_distance: f64) -> RansacOptions {
        let Self { edge_length_ratio, max_iterations, confidence, seed, .. } = *self;
        RansacOptions { inlier_distance, edge_length_ratio, max_iterations, confidence, seed }
    }
}

/// Twice the largest distance from the mean.
fn diameter(what: &'static str, points: &[Point]) -> Result<f64> {
    let normalization = Normalization::of(points, NormalizationMethod::UnitSphere).map_err(|error| match error {
        Error::Input { reason, .. } => Error::Input { what, reason },
        other => other,
    })?;
    Ok(normalization.scale.into())
}

#[cfg(test)]
mod tests {
    use nalgebra::IsometryMatrix3;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::rigid::tests::random_transform;
    use super::*;
    use snake_core::Builtin;

    fn sample() -> Vec<Point> {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../samples/plane.ply");
        snake_io::read_points(path.as_ref()).unwrap()
    }

    fn options() -> RegisterOptions {
        RegisterOptions { max_keypoints: 500, ..Default::default() }
    }

    fn run(source: &[Point], target: &[Point], options: &RegisterOptions) -> Result<Registration> {
        register(source, target, &Model::builtin(Builtin::Compact), options)
    }

    /// The largest coordinate difference between the points under two transforms.
    fn difference(points: &[Point], a: &RigidTransform, b: &RigidTransform) -> f32 {
        let (a, b) = (transform_points(a, points), transform_points(b, points));
        a.as_flattened().iter().zip(b.as_flattened()).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
    }

    #[test]
    fn two_samplings_are_registered_for_any_rotation() {
        let points = sample();
        // The second sampling lacks the end of a wing.
        let source = &points[..2048];
        let part: Vec<Point> = points[2048..].iter().copied().filter(|p| p[0] < 0.5).collect();
        for seed in 0..4 {
            let truth = RigidTransform::from(random_transform(&mut ChaCha8Rng::seed_from_u64(seed)));
            let found = run(source, &transform_points(&truth, &part), &options()).unwrap();
            assert!(difference(&points, &found.t_target_source, &truth) < 0.05, "seed {seed}: {found:?}");
            assert!(found.num_inliers >= 3 && found.num_correspondences > found.num_inliers, "{found:?}");
            assert!(found.rmse > 0.0 && found.rmse < 0.1 && found.seconds > 0.0, "{found:?}");
        }
    }

    #[test]
    fn field_descriptors_and_refinement_do_their_part() {
        let points = sample();
        let truth = RigidTransform::from(IsometryMatrix3::translation(0.3, -4.0, 1.0));
        let (source, target) = (&points[..2048], transform_points(&truth, &points[2048..]));
        let options = RegisterOptions { descriptor: Descriptor::Field, ..options() };
        let error = |options: RegisterOptions| {
            difference(source, &run(source, &target, &options).unwrap().t_target_source, &truth)
        };
        let (refined, rough) = (error(options), error(RegisterOptions { refine_steps: 0, ..options }));
        assert!(refined < 0.02 && rough > refined, "{refined} {rough}");
    }

    #[test]
    fn inliers_are_those_of_ransac_and_fitness_is_that_of_the_result() {
        let points = sample();
        let truth = RigidTransform::from(random_transform(&mut ChaCha8Rng::seed_from_u64(7)));
        let (source, target) = (&points[..2048], transform_points(&truth, &points[2048..]));
        let found = run(source, &target, &options()).unwrap();
        let rough = run(source, &target, &RegisterOptions { refine_steps: 0, ..options() }).unwrap();
        assert_eq!((found.num_inliers, found.rmse), (rough.num_inliers, rough.rmse));
        assert_eq!(found.inlier_distance, rough.inlier_distance);
        // These are two samplings of one surface, and the rough transform puts a part of it out of reach.
        assert!(found.fitness > 0.95 && found.fitness > rough.fitness + 0.1, "{found:?} {rough:?}");
        assert!(found.fitness_rmse < rough.fitness_rmse, "{found:?} {rough:?}");
    }

    #[test]
    fn keypoints_of_other_detectors_register_too() {
        use KeypointDetector::{Fps, Random};
        let points = sample();
        let truth = RigidTransform::from(random_transform(&mut ChaCha8Rng::seed_from_u64(1)));
        let (source, target) = (&points[..2048], transform_points(&truth, &points[2048..]));
        for detector in [Fps, Random] {
            let found = run(source, &target, &RegisterOptions { detector, ..options() }).unwrap();
            assert!(difference(source, &found.t_target_source, &truth) < 0.05, "{detector:?}: {found:?}");
        }
        // The cloud is registered to itself: most of its random points have no partner.
        let few = RegisterOptions { detector: Random, max_keypoints: 200, ..options() };
        let twice = run(source, source, &few).unwrap();
        assert!(twice.num_correspondences < 150, "{twice:?}");
        assert_ne!(
            twice,
            Registration {
                seconds: twice.seconds,
                ..run(source, source, &RegisterOptions { seed: 5, ..few }).unwrap()
            }
        );
    }

    #[test]
    fn threads_do_not_matter() {
        let points = sample();
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let found = pool.install(|| run(&points[..2000], &points[2000..], &options()).unwrap());
            Registration { seconds: 0.0, ..found }
        };
        assert_eq!(run(1), run(3));
    }

    #[test]
    fn clouds_that_cannot_be_registered_are_refused() {
        let good = sample();
        let line: Vec<Point> = (0..500).map(|i| [0.01 * i as f32, 0.0, 0.0]).collect();
        let plane: Vec<Point> = (0..900).map(|i| [(i % 30) as f32, (i / 30) as f32, 0.0]).collect();
        for (bad, expected) in [
            (vec![], "no points"),
            (vec![[1.0; 3]], "two different"),
            (vec![[1.0; 3]; 99], "two different"),
            (vec![[f32::NAN; 3]; 9], "none of the 9 points is finite"),
        ] {
            let error = run(&bad, &good, &options()).unwrap_err().to_string();
            assert!(error.starts_with("source: ") && error.contains(expected), "{error}");
            let error = run(&good, &bad, &options()).unwrap_err().to_string();
            assert!(error.starts_with("target: ") && error.contains(expected), "{error}");
        }
        // Clouds that determine no rotation, or that do not match, give few inliers or an error, but never a panic.
        for poor in [line, plane, good[..2].to_vec(), good[..5].to_vec()] {
            for (source, target) in [(&poor, &good), (&good, &poor), (&poor, &poor)] {
                match run(source, target, &options()) {
                    Ok(found) => {
                        assert!(found.t_target_source.to_matrix().as_flattened().iter().all(|v| v.is_finite()))
                    }
                    Err(error) => assert!(error.to_string().contains("correspondences"), "{error}"),
                }
            }
        }
    }

    #[test]
    fn lengths_may_be_multiples_of_the_coarser_clouds_resolution() {
        let points = sample();
        let (fine, coarse) = (&points[..3000], &points[3000..]);
        let spacing = resolution("points", coarse).unwrap();
        assert!(spacing > resolution("points", fine).unwrap());
        let lengths = |unit: fn(f64) -> Length, scale: f64| RegisterOptions {
            voxel_size: Some(unit(scale)),
            normal_radius: Some(unit(3.0 * scale)),
            feature_radius: Some(unit(8.0 * scale)),
            inlier_distance: Some(unit(2.0 * scale)),
            ..options()
        };
        let found = |options| Registration { seconds: 0.0, ..run(fine, coarse, &options).unwrap() };
        assert_eq!(found(lengths(Length::Resolutions, 1.0)), found(lengths(Length::Units, spacing)));
    }

    #[test]
    fn points_that_are_not_finite_are_skipped() {
        let points = sample();
        let (source, target) = (&points[..1500], &points[1500..3000]);
        let nan = [source, &[[f32::NAN; 3]; 7], &[[0.0, 0.0, f32::INFINITY]]].concat();
        let (expected, found) = (run(source, target, &options()).unwrap(), run(&nan, target, &options()).unwrap());
        assert_eq!(found, Registration { num_skipped: [8, 0], seconds: found.seconds, ..expected });
    }

    #[test]
    fn options_outside_their_range_are_named() {
        let points = &sample()[..500];
        for (options, name) in [
            (RegisterOptions { max_keypoints: 2, ..options() }, "max_keypoints"),
            (RegisterOptions { voxel_size: Some(Length::Units(0.0)), ..options() }, "voxel_size"),
            (RegisterOptions { normal_radius: Some(Length::Resolutions(-1.0)), ..options() }, "normal_radius"),
            (RegisterOptions { feature_radius: Some(Length::Units(f64::NAN)), ..options() }, "feature_radius"),
            (RegisterOptions { inlier_distance: Some(Length::Units(f64::INFINITY)), ..options() }, "inlier_distance"),
            (RegisterOptions { confidence: 2.0, ..options() }, "confidence"),
        ] {
            let error = run(points, points, &options).unwrap_err().to_string();
            assert!(error.contains(name), "{error}");
        }
        // Each cloud is reduced to one voxel.
        let options = RegisterOptions { voxel_size: Some(Length::Units(1e3)), ..options() };
        assert!(run(points, points, &options).unwrap_err().to_string().contains("correspondences"));
    }
}

//! Registration of two clouds.

use std::time::Instant;

use snake_core::{Control, Model, Result};
use snake_geometry::Point;

use crate::options::RegisterOptions;
use crate::pair::Pair;
use crate::pair::prepared::PreparedClouds;
use crate::result::Registration;

/// Finds the rigid transform from `source` `(N, 3)` to `target` `(M, 3)` without an initial guess.
///
/// Both clouds are in the same units; they may overlap only in part. A detector or descriptor that runs a model gets it
/// from [`register_with`].
///
/// ```
/// use snake_core::RigidTransform;
/// use snake_registration::{RegisterOptions, register, transform_points};
/// # let source = snake_io::read_points(concat!(env!("CARGO_MANIFEST_DIR"), "/../../samples/plane.ply").as_ref())?;
/// let rows = [[0.0, -1.0, 0.0, 3.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];
/// let t_target_source = RigidTransform::from_matrix(rows)?;
/// let target = transform_points(&t_target_source, &source);
/// let found = register(&source, &target, &RegisterOptions::default())?;
/// let (angle, distance) = found.t_target_source.angle_and_distance_to(&t_target_source);
/// assert!(angle < 0.05 && distance < 0.05 && found.is_reliable);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`Error::Input`](snake_core::Error::Input) for a cloud without finite points or without extent;
/// [`Error::NoTransform`](snake_core::Error::NoTransform) when no three matches fit a rigid transform;
/// [`Error::Option`](snake_core::Error::Option) when an option is outside its range or needs a model.
pub fn register(source: &[Point], target: &[Point], options: &RegisterOptions) -> Result<Registration> {
    register_with(source, target, None, options, &Control::default())
}

/// [`register`] with the model of the detector `snake` or the descriptor `field`, progress and cancellation; a classical detector is not interrupted.
///
/// # Errors
/// The errors of [`register`]; [`Error::Cancelled`](snake_core::Error::Cancelled) and
/// [`Error::DeadlineExceeded`](snake_core::Error::DeadlineExceeded).
pub fn register_with(
    source: &[Point],
    target: &[Point],
    model: Option<&Model>,
    options: &RegisterOptions,
    control: &Control,
) -> Result<Registration> {
    let start = Instant::now();
    options.check()?;
    let given = [options.source_viewpoint, options.target_viewpoint];
    let prepared = PreparedClouds::new(&[source, target], &given, &["source", "target"], model, options, control)?;
    let found =
        Pair::new(&prepared.clouds[0], &prepared.clouds[1], prepared.inlier_distance).register(options, control)?;
    Ok(Registration { seconds: start.elapsed().as_secs_f64(), ..found })
}

#[cfg(test)]
mod tests {
    use nalgebra::IsometryMatrix3;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::options::{Descriptor, KeypointDetector};
    use crate::parts::rigid::tests::random_transform;
    use crate::parts::rigid::transform_points;
    use snake_core::Builtin;
    use snake_geometry::{Length, RigidTransform, resolution};

    fn sample() -> Vec<Point> {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../samples/plane.ply");
        snake_io::read_points(path.as_ref()).unwrap()
    }

    fn options() -> RegisterOptions {
        RegisterOptions { max_keypoints: 500, ..Default::default() }
    }

    fn run(source: &[Point], target: &[Point], options: &RegisterOptions) -> Result<Registration> {
        let model = options.needs_model().then(|| Model::builtin(Builtin::Compact));
        register_with(source, target, model.as_ref(), options, &Control::default())
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
            assert!(found.hypotheses[0].t_target_source == found.t_target_source, "{found:?}");
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
    fn options_that_run_a_model_need_one_before_anything_is_computed() {
        let points = sample();
        let snake = options().with_detector(KeypointDetector::Snake);
        for options in [snake, options().with_descriptor(Descriptor::Field), snake.with_num_keypoints(Some(9))] {
            let error = register(&points, &points, &options).unwrap_err().to_string();
            assert!(error.contains("`model` is none") && error.contains("snake"), "{error}");
            // No point of these clouds can be used.
            assert_eq!(register(&[], &[], &options).unwrap_err().to_string(), error);
        }
    }

    #[test]
    fn inliers_are_those_before_icp_and_fitness_is_that_of_the_result() {
        let points = sample();
        let truth = RigidTransform::from(random_transform(&mut ChaCha8Rng::seed_from_u64(7)));
        let (source, target) = (&points[..2048], transform_points(&truth, &points[2048..]));
        let found = run(source, &target, &options()).unwrap();
        let rough = run(source, &target, &RegisterOptions { refine_steps: 0, ..options() }).unwrap();
        assert!(found.num_inliers >= 3 && found.rmse > 0.0 && found.rmse < found.inlier_distance, "{found:?}");
        assert_eq!(found.inlier_distance, rough.inlier_distance);
        // These are two samplings of one surface, and the rough transform puts a part of it out of reach.
        assert!(found.fitness > 0.95 && found.fitness > rough.fitness + 0.02, "{found:?} {rough:?}");
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
        // The cloud is registered to itself: its random points are not those of the target.
        let few = RegisterOptions { detector: Random, max_keypoints: 200, ..options() };
        let twice = run(source, source, &few).unwrap();
        assert!(twice.rmse > 0.0, "{twice:?}");
        assert_ne!(
            twice,
            Registration {
                seconds: twice.seconds,
                ..run(source, source, &RegisterOptions { seed: 5, ..few }).unwrap()
            }
        );
    }

    #[test]
    fn few_spread_keypoints_register_and_their_matches_agree() {
        let points = sample();
        let truth = RigidTransform::from(random_transform(&mut ChaCha8Rng::seed_from_u64(3)));
        let (source, target) = (&points[..2048], transform_points(&truth, &points[2048..]));
        for detector in [KeypointDetector::Voxels, KeypointDetector::Snake] {
            let few = RegisterOptions { detector, num_keypoints: Some(250), ..options() };
            let found = run(source, &target, &few).unwrap();
            assert!(difference(source, &found.t_target_source, &truth) < 0.05, "{detector:?}: {found:?}");
            assert!(found.num_correspondences <= 500, "{found:?}");
            assert_eq!(found.matches.len(), found.num_agreeing);
            for [from, to] in &found.matches {
                let moved = transform_points(&found.t_target_source, &[*from])[0];
                let squared: f32 = (0..3).map(|axis| (moved[axis] - to[axis]).powi(2)).sum();
                assert!(f64::from(squared.sqrt()) < 1.001 * found.inlier_distance);
            }
        }
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
            (RegisterOptions { num_keypoints: Some(2), ..options() }, "num_keypoints"),
            (RegisterOptions { max_matches: 2, ..options() }, "max_matches"),
            (RegisterOptions { hypotheses: 0, ..options() }, "hypotheses"),
            (RegisterOptions { source_viewpoint: Some([f64::NAN; 3]), ..options() }, "source_viewpoint"),
        ] {
            let error = run(points, points, &options).unwrap_err().to_string();
            assert!(error.contains(name), "{error}");
        }
        // Each cloud is reduced to one voxel.
        let options = RegisterOptions { voxel_size: Some(Length::Units(1e3)), ..options() };
        assert!(run(points, points, &options).unwrap_err().to_string().contains("correspondences"));
    }
}

//! Tests of registration as a whole.

use chacha20::ChaCha8Rng;
use nalgebra::{IsometryMatrix3, Vector3};
use rand::{RngExt, SeedableRng};

use super::*;
use crate::Detector;
use crate::options::Descriptor;
use crate::result::Matches;
use crate::rigid::tests::{random_transform, sample};
use crate::rigid::transform_points;
use crate::steps::single_matches::Voters;
use crate::steps::{self, Pair, consensus, describe, judge, match_rows, refine};
use snake_core::{Builtin, Cloud};
use snake_geometry::{Length, RigidTransform, resolution};

fn options() -> RegisterOptions {
    RegisterOptions { max_keypoints: 500, ..Default::default() }
}

fn run(source: &[Point], target: &[Point], options: &RegisterOptions) -> Result<Registration> {
    let model = options.needs_model().then(|| Model::builtin(Builtin::Compact));
    register_with(source, target, model.as_ref(), options, &PairOptions::default(), &Control::default())
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
        assert!(found.hypotheses[0].t_target_source == found.t_target_source && found.seconds > 0.0, "{found:?}");
        let Matches { num_inliers, num_matches, rmse, .. } = found.matches;
        assert!(3 <= num_inliers && num_inliers < num_matches && 0.0 < rmse && rmse < found.fit.inlier_distance);
    }
}

#[test]
fn field_descriptors_and_refinement_do_their_part() {
    let points = sample();
    let truth = RigidTransform::from(IsometryMatrix3::translation(0.3, -4.0, 1.0));
    let (source, target) = (&points[..2048], transform_points(&truth, &points[2048..]));
    let options = RegisterOptions { descriptor: Descriptor::Field, ..options() };
    let error =
        |options: RegisterOptions| difference(source, &run(source, &target, &options).unwrap().t_target_source, &truth);
    let (refined, rough) = (error(options), error(RegisterOptions { icp_steps: 0, ..options }));
    assert!(refined < 0.02 && rough > refined, "{refined} {rough}");
}

#[test]
fn options_that_run_a_model_need_one_before_anything_is_computed() {
    let points = sample();
    let snake = options().with_detector(Detector::Snake);
    for options in [snake, options().with_descriptor(Descriptor::Field), snake.with_num_keypoints(Some(9))] {
        let error = register(&points, &points, &options).unwrap_err().to_string();
        assert!(error.contains("`model` is none") && error.contains("snake"), "{error}");
        // No point of these clouds can be used.
        assert_eq!(register(&[], &[], &options).unwrap_err().to_string(), error);
    }
}

#[test]
fn few_spread_keypoints_register_and_their_matches_agree() {
    let points = sample();
    let truth = RigidTransform::from(random_transform(&mut ChaCha8Rng::seed_from_u64(3)));
    let (source, target) = (&points[..2048], transform_points(&truth, &points[2048..]));
    for detector in [Detector::Voxels, Detector::Snake] {
        let few = RegisterOptions { detector, num_keypoints: Some(250), ..options() };
        let registration = run(source, &target, &few).unwrap();
        assert!(difference(source, &registration.t_target_source, &truth) < 0.05, "{detector:?}: {registration:?}");
        assert!(registration.matches.num_matches <= 500, "{registration:?}");
    }
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
                Ok(registration) => {
                    assert!(registration.t_target_source.to_matrix().as_flattened().iter().all(|v| v.is_finite()))
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
    let registration = |options| Registration { seconds: 0.0, ..run(fine, coarse, &options).unwrap() };
    assert_eq!(registration(lengths(Length::Resolutions, 1.0)), registration(lengths(Length::Units, spacing)));
}

#[test]
fn options_outside_their_range_are_named() {
    let points = &sample()[..500];
    for (pair_options, name) in [
        (PairOptions { hypotheses: 0, ..Default::default() }, "hypotheses"),
        (PairOptions { source_viewpoint: Some([f64::NAN; 3]), ..Default::default() }, "source_viewpoint"),
        (PairOptions { target_viewpoint: Some([f64::INFINITY; 3]), ..Default::default() }, "target_viewpoint"),
    ] {
        let error = register_with(points, points, None, &options(), &pair_options, &Control::default()).unwrap_err();
        assert!(error.to_string().contains(name), "{error}");
    }
    assert!(run(points, points, &options().with_max_matches(2)).unwrap_err().to_string().contains("max_matches"));
    // Each cloud is reduced to one voxel.
    let options = RegisterOptions { voxel_size: Some(Length::Units(1e3)), ..options() };
    assert!(run(points, points, &options).unwrap_err().to_string().contains("correspondences"));
}

#[test]
fn register_runs_the_public_steps() {
    let points = sample();
    let truth = RigidTransform::from(random_transform(&mut ChaCha8Rng::seed_from_u64(6)));
    let (source, target) = (&points[..2048], transform_points(&truth, &points[2048..]));
    let (options, control) = (options(), Control::default());
    let prepared = steps::prepare(&[source, &target], &[], None, &options, &control).unwrap();
    let pair = Pair::new(&prepared.clouds[0], &prepared.clouds[1], options.gravity);
    let pair = pair.without_signs();
    let rows = describe(&pair, &control).unwrap();
    let matches = pair.matches(&match_rows(&rows[0], &rows[1], options.max_matches, &control).unwrap()).unwrap();
    let guesses = consensus(&matches, pair.criteria(), steps::consensus::CANDIDATES, &control).unwrap();
    let candidates = refine(&pair, &matches, &guesses, options.icp_steps, 1, &control).unwrap();
    let judged = judge(&pair, &matches, &candidates).unwrap();
    let unsigned = run(source, &target, &options.with_use_viewpoints(false)).unwrap();
    assert_eq!((judged.t_target_source, judged.verdict), (unsigned.t_target_source, unsigned.verdict));
    // A transform from another origin is measured, refined and judged in the same way.
    let own = steps::approach(&pair, &truth, options.icp_steps, &control).unwrap();
    let own = steps::Candidate::measure(&pair, &matches, &own);
    assert!(own.overlap() > candidates[0].overlap() - 0.05 && own.free_space_violation() == 0.0, "{own:?}");
    assert!(own.num_inliers > 10 && own.score() > own.overlap(), "{own:?}");
    assert!(judge(&pair, &matches, &[own]).unwrap().verdict.is_reliable);
    let error = judge(&pair, &matches, &[]).unwrap_err();
    assert!(matches!(error, snake_core::Error::NoTransform { .. }), "{error}");
    assert!(pair.matches(&[[0, 999_999]]).unwrap_err().to_string().contains("999999"));
}

/// Two sectors of a room with boxes at random places, seen from its middle. Each covers 140 degrees of
/// azimuth, and they share 40. The second is rotated.
fn sectors(seed: u64) -> ([Vec<Point>; 2], RigidTransform) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut points: Vec<Point> = Vec::new();
    let mut face = |corner: [f32; 3], sides: [[f32; 3]; 2]| {
        let steps = sides.map(|side| (side.iter().map(|v| v.abs()).sum::<f32>() / 0.03) as i32);
        for (a, b) in (0..steps[0]).flat_map(|a| (0..steps[1]).map(move |b| (a, b))) {
            let at = [a as f32 / steps[0] as f32, b as f32 / steps[1] as f32];
            points.push(std::array::from_fn(|k| corner[k] + at[0] * sides[0][k] + at[1] * sides[1][k]));
        }
    };
    face([-2.5, -2.0, -1.2], [[5.0, 0.0, 0.0], [0.0, 4.0, 0.0]]);
    for (corner, side) in [
        ([-2.5, -2.0, -1.2], [5.0, 0.0, 0.0]),
        ([-2.5, 2.0, -1.2], [5.0, 0.0, 0.0]),
        ([-2.5, -2.0, -1.2], [0.0, 4.0, 0.0]),
        ([2.5, -2.0, -1.2], [0.0, 4.0, 0.0]),
    ] {
        face(corner, [side, [0.0, 0.0, 2.4]]);
    }
    for _ in 0..14 {
        let angle = rng.random_range(-3.1..3.1_f32);
        let (x, y, radius) = (angle.cos(), angle.sin(), rng.random_range(1.2..1.8));
        let [width, height]: [f32; 2] = [rng.random_range(0.2..0.6), rng.random_range(0.3..1.4)];
        let corner = [radius * x, radius * y, -1.2];
        face(corner, [[-width * y, width * x, 0.0], [0.0, 0.0, height]]);
        face([corner[0], corner[1], height - 1.2], [[-width * y, width * x, 0.0], [0.4 * x, 0.4 * y, 0.0]]);
    }
    let view = |from: f32| -> Vec<Point> {
        let within = |p: &&Point| (p[1].atan2(p[0]).to_degrees() - from).rem_euclid(360.0) < 140.0;
        points.iter().filter(within).copied().collect()
    };
    let motion = RigidTransform::from(IsometryMatrix3::rotation(Vector3::new(0.2, -0.1, 1.9)));
    ([view(0.0), transform_points(&motion, &view(100.0))], motion)
}

#[test]
fn single_matches_find_more_pairs_of_low_overlap() {
    let mut right = [0; 2];
    for seed in [7, 9, 11, 12] {
        let ([source, target], truth) = sectors(seed);
        let (options, control) = (RegisterOptions::default(), Control::default());
        let prepared = steps::prepare(&[&source, &target], &[Some([0.0; 3]); 2], None, &options, &control).unwrap();
        let pair = Pair::new(&prepared.clouds[0], &prepared.clouds[1], None);
        let is_right = [Effort::Usual, Effort::Thorough].map(|effort| {
            let one = Search::new(&pair, &options, &PairOptions::default(), effort, &control).register().unwrap();
            let (angle, distance) = one.t_target_source.angle_and_distance_to(&truth);
            let near = angle < 0.02 && distance < 0.05;
            assert!(near || !one.verdict.is_reliable, "{seed}: {one:?}");
            near
        });
        assert!(is_right[1] || !is_right[0], "{seed}");
        // The transforms with the most support come first; without sensors there are no votes.
        let [from, to] = describe(&pair, &control).unwrap();
        let matches = match_rows(&from, &to, 5000, &control).unwrap();
        let voters = Voters::new(&pair, &matches, &control).unwrap();
        let support: Vec<_> = voters.transforms(9).iter().map(|transform| voters.support(transform)).collect();
        assert!(support.is_sorted_by(|a, b| a >= b) && voters.support(truth.isometry()) >= 5, "{seed}: {support:?}");
        assert!(Voters::new(&pair.without_signs(), &matches, &control).unwrap().transforms(1).is_empty());
        right.iter_mut().zip(is_right).for_each(|(count, is_right)| *count += usize::from(is_right));
    }
    assert_eq!(right, [1, 4]);
}

fn cloud(points: &[Point], origin: [f64; 3]) -> Cloud {
    Cloud { points: points.to_vec(), origin }
}

#[test]
fn a_map_refuses_what_its_scans_would_have_to_tell() {
    let (map, control) = (cloud(&sample(), [0.0; 3]), Control::default());
    let refused = PreparedMap::new(&map, None, None, &RegisterOptions::default(), &control).err().unwrap();
    assert!(refused.to_string().contains("`voxel_size` is none") && refused.to_string().contains("map"), "{refused}");
    let options = RegisterOptions::default().with_voxel_size(Some(Length::Units(0.05)));
    let prepared = PreparedMap::new(&map, None, None, &options, &control).unwrap();
    for (pair, name) in [
        (PairOptions::default().with_target_viewpoint(Some([0.0; 3])), "target_viewpoint"),
        (PairOptions::default().with_estimate_scale(true), "estimate_scale"),
    ] {
        let refused = prepared.register(&map, &pair, &control).unwrap_err().to_string();
        assert!(refused.contains(name), "{refused}");
    }
}

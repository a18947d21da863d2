//! Answers that a verdict must not call reliable: what slides, turns, repeats itself or is not
//! there, and missing returns. Clouds are views of made scenes, so that the right answer is known.

use std::f64::consts::FRAC_PI_2;

use chacha20::ChaCha8Rng;
use nalgebra::{IsometryMatrix3, Rotation3, Vector3};
use rand::{RngExt, SeedableRng};
use snake_core::{Control, Length, Point, RigidTransform};
use snake_registration::steps::prepare;
use snake_registration::{PairOptions, RegisterOptions, Registration, ViewpointUsed, align, register, register_with};

use self::scenes::{Scene, Vec3, street};

mod scenes;

impl Scene {
    /// What a sensor at a place sees within `most`, in its frame, whose axes are those of the
    /// scene.
    fn seen(&self, at: Vec3, rays: &[Vec3], most: f64, noise: f64, seed: u64) -> Vec<Point> {
        let pose = IsometryMatrix3::translation(at[0], at[1], at[2]);
        self.scan(&pose, rays, most, noise, &mut ChaCha8Rng::seed_from_u64(seed))
    }
}

/// A depth camera that looks along x, rotated by `yaw` (radians).
fn camera(yaw: f64) -> Vec<Vec3> {
    let pixel = |i: i32| {
        let (y, z) = (f64::from(i % 120 - 60) / 85.0, f64::from(i / 120 - 45) / 85.0);
        let norm = (1.0 + y * y + z * z).sqrt();
        [(yaw.cos() - y * yaw.sin()) / norm, (yaw.sin() + y * yaw.cos()) / norm, z / norm]
    };
    (0..120 * 90).map(pixel).collect()
}

/// A LiDAR with 32 beams from `low` to `high` (radians).
fn lidar(low: f64, high: f64) -> Vec<Vec3> {
    scenes::lidar(32, 720, low, high)
}

fn corridor() -> Scene {
    Scene { rooms: vec![[[-200.0, -1.2, 0.0], [200.0, 1.2, 2.6]]], ..Default::default() }
}

fn room() -> Scene {
    let boxes = [
        [[0.3, 0.2, 0.0], [1.7, 0.9, 0.75]],
        [[0.4, 0.3, 0.75], [0.8, 0.7, 1.2]],
        [[3.0, 3.4, 0.0], [5.4, 4.4, 0.45]],
        [[3.0, 4.2, 0.45], [5.4, 4.4, 1.0]],
        [[5.3, 0.1, 0.0], [5.95, 1.3, 1.9]],
        [[2.4, 1.6, 0.0], [3.3, 2.1, 0.72]],
        [[2.6, 1.7, 0.72], [2.8, 1.95, 1.0]],
        [[4.2, 1.9, 0.0], [4.5, 2.2, 0.45]],
    ];
    Scene { boxes: boxes.to_vec(), rooms: vec![[[0.0; 3], [6.0, 4.5, 2.6]]], ..Default::default() }
}

/// Points on an object about 1 across, whose place and turn about z follow from the seed.
fn object(count: usize, seed: u64) -> Vec<Point> {
    let parts = [
        [[-0.3, -0.1, 0.0], [0.3, 0.1, 0.15]],
        [[0.1, -0.05, 0.15], [0.2, 0.05, 0.6]],
        [[-0.25, -0.03, 0.5], [0.2, 0.03, 0.56]],
        [[-0.3, 0.1, 0.0], [-0.2, 0.4, 0.05]],
    ];
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let (sin, cos) = (seed as f32).sin_cos();
    let mut point = || {
        let [low, high]: [Vec3; 2] = parts[[0, 0, 0, 1, 1, 2, 2, 3][rng.random_range(0..8)]];
        let mut p: Vec3 = std::array::from_fn(|axis| rng.random_range(low[axis]..high[axis]));
        let axis = rng.random_range(0..3);
        p[axis] = if rng.random_bool(0.5) { low[axis] } else { high[axis] };
        let [x, y, z] = p.map(|v| v as f32);
        [cos * x - sin * y + 1.0, sin * x + cos * y, z - 0.4]
    };
    (0..count).map(|_| point()).collect()
}

/// A cloud whose frame has its origin elsewhere.
fn at_site(cloud: Vec<Point>, site: Vec3) -> Vec<Point> {
    cloud.into_iter().map(|point| std::array::from_fn(|axis| point[axis] + site[axis] as f32)).collect()
}

/// Whether `make test-full` runs, which tests whole grids.
fn is_full() -> bool {
    std::env::var_os("SNAKE_FULL").is_some()
}

fn run(source: &[Point], target: &[Point]) -> Option<Registration> {
    register(source, target, &RegisterOptions::default()).ok()
}

#[test]
fn corridors_and_tunnels_are_open_along_their_axis() {
    let tunnel = || Scene { tunnel: Some(2.0), ..Default::default() };
    let wide = lidar(-0.7, 0.7);
    for (name, scene, rays, most, noise) in [
        ("corridor, camera", corridor(), camera(0.0), 12.0, 0.002),
        ("corridor, exact camera", corridor(), camera(0.0), 12.0, 0.0),
        ("corridor, noisy camera", corridor(), camera(0.1), 12.0, 0.01),
        ("corridor, LiDAR", corridor(), wide.clone(), 20.0, 0.02),
        ("corridor, narrow LiDAR", corridor(), lidar(-0.26, 0.26), 30.0, 0.02),
        ("tunnel, camera", tunnel(), camera(0.0), 12.0, 0.005),
        ("tunnel, LiDAR", tunnel(), wide, 20.0, 0.02),
    ] {
        for &along in if is_full() { &[0.4, 1.0, 2.5][..] } else { &[1.0] } {
            let height = if scene.tunnel.is_some() { -0.4 } else { 1.4 };
            let (a, b) = ([0.0, 0.0, height], [along, 0.1, height]);
            let (source, target) = (scene.seen(a, &rays, most, noise, 1), scene.seen(b, &rays, most, noise, 2));
            let Some(Registration { verdict, .. }) = run(&source, &target) else { continue };
            let is_named = verdict.notes.iter().any(|note| note.contains("translation along (1.00,"));
            assert!(is_named && verdict.confidence == 0.0 && verdict.is_ambiguous, "{name}, {along}: {verdict:?}");
        }
    }
}

/// A stairwell of equal storeys, two flights each.
fn stairwell() -> Scene {
    let mut boxes = Vec::new();
    for flight in -4..10 {
        let (is_second, z) = (flight % 2 != 0, 1.5 * f64::from(flight));
        let landing = if is_second { 3.8 } else { 0.0 };
        boxes.push([[0.0, landing, z - 0.16], [2.6, landing + 1.2, z]]);
        boxes.extend((0..9).map(f64::from).map(|k| {
            let (low, step) = (z + k / 6.0, 0.29 * k);
            let [x, y] = if is_second { [1.35, 3.505 - step] } else { [0.05, 1.205 + step] };
            [[x, y, low], [x + 1.2, y + 0.29, low + 1.0 / 6.0]]
        }));
    }
    Scene { boxes, rooms: vec![[[0.0, 0.0, -6.0], [2.6, 5.0, 9.0]]], ..Default::default() }
}

#[test]
fn a_storey_of_a_stairwell_may_be_any() {
    let rays = scenes::lidar(64, 240, -1.4, 1.4);
    for (x, seed) in [(1.0, 1), (1.6, 3)] {
        let [source, target] =
            [(1.3, 4.4), (x, 7.4)].map(|(x, z)| stairwell().seen([x, 0.6, z], &rays, 30.0, 0.006, seed));
        let verdict = run(&source, &target).unwrap().verdict;
        assert!(!verdict.is_reliable && verdict.notes[0].contains("itself"), "{verdict:?}");
    }
}

/// A wall at y = 9 with windows before it, every `period` along x, from `start` on.
fn facade(period: f64, start: f64) -> Scene {
    let ground = [[-40.0, -15.0, -0.2], [40.0, 15.0, 0.0]];
    let wall = [[start - 1.0, 8.85, 0.0], [40.0, 9.15, 12.0]];
    let count = ((40.0 - start) / period) as i32;
    let windows = (0..count).flat_map(|i| {
        let x = start + period * f64::from(i);
        [2.0, 5.0, 8.0].map(|z| [[x, 8.55, z - 0.75], [x + 0.7 * period, 8.85, z + 0.75]])
    });
    Scene { boxes: windows.chain([ground, wall]).collect(), ..Default::default() }
}

#[test]
fn windows_that_repeat_are_named_and_the_other_places_returned() {
    let rays = lidar(-0.785, 0.785);
    for (period, along) in [(4.0, 1.4), (2.5, 3.5)] {
        let seen = |x: f64, seed| facade(period, -39.0).seen([x, 0.0, 1.4], &rays, 14.0, 0.008, seed);
        let (source, target) = (seen(0.0, 1), seen(along, 2));
        let pair_options = PairOptions::default().with_hypotheses(8);
        let control = Control::default();
        let options = RegisterOptions::default();
        let registration = register_with(&source, &target, None, &options, &pair_options, &control).unwrap();
        let verdict = &registration.verdict;
        assert!(!verdict.is_reliable && verdict.is_ambiguous && verdict.confidence < 0.5, "{verdict:?}");
        assert!(verdict.notes[0].contains("repeats itself every"), "{verdict:?}");
        assert!(registration.hypotheses.len() > 1, "{registration:?}");
        // A guess decides.
        let truth = IsometryMatrix3::translation(-along, 0.0, 0.0).into();
        let guided = PairOptions::default().with_initial(Some(truth));
        let notes = register_with(&source, &target, None, &options, &guided, &control).unwrap().verdict.notes;
        assert!(notes.iter().all(|note| !note.contains("repeats itself every")), "{notes:?}");
    }
}

/// Clouds whose 16 nearest points are nowhere a planar patch: points in a bulky volume, and wires.
fn clouds_without_patches() -> [(&'static str, Vec<Point>); 2] {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let volume = (0..6000).map(|_| [(); 3].map(|()| rng.random_range(-1.0..1.0_f32)));
    // The height varies over the ground.
    let volume = volume.map(|[x, y, z]| [x, 0.8 * y, 0.5 * z * (1.2 + (2.0 * x).sin() + y)]).collect();
    let wire = |i: i32| {
        let (k, t) = ((i % 9) as f32, (i / 9) as f32 / 400.0);
        [t * (1.0 + 0.1 * k) - 0.02 * k * k, 0.25 * k + 0.2 * (t * (3.0 + k)).sin(), 0.15 * (k * t).cos() * k]
    };
    [("volume", volume), ("wires", (0..3600).map(wire).collect())]
}

#[test]
fn exact_copies_of_clouds_without_planar_patches_are_reliable() {
    for (name, source) in clouds_without_patches() {
        let target: Vec<Point> = source.iter().map(|[x, y, z]| [3.0 - y, *x, *z]).collect();
        let registration = run(&source, &target).unwrap();
        let truth = IsometryMatrix3::new(Vector3::x() * 3.0, Vector3::z() * FRAC_PI_2).into();
        let (angle, distance) = registration.t_target_source.angle_and_distance_to(&truth);
        assert!(registration.verdict.is_reliable && angle.max(distance) < 1e-3, "{name}: {registration:?}");
    }
}

#[test]
fn things_that_are_not_there_are_not_found_and_not_joined() {
    let places = [[1.0, 1.2, 1.4], [1.5, 1.0, 1.5]].into_iter().zip(0..);
    let views: Vec<_> = places.map(|(at, seed)| room().seen(at, &camera(0.6), 12.0, 0.003, seed)).collect();
    for seed in 0..if is_full() { 6 } else { 2 } {
        if let Some(registration) = run(&object(4000, seed), &views[seed as usize % 2]) {
            assert!(!registration.verdict.is_reliable, "{seed}: {registration:?}");
        }
    }
    let street = street(&mut ChaCha8Rng::seed_from_u64(5)).seen([0.0, 0.5, 1.8], &lidar(-0.43, 0.1), 80.0, 0.02, 5);
    let clouds = [views[0].clone(), views[1].clone(), object(4000, 1), object(4000, 2), street];
    let parts = align(&clouds, &RegisterOptions::default()).unwrap().parts;
    let kind = |cloud: usize| [0, 0, 1, 1, 2][cloud];
    assert!(parts.iter().all(|part| part.iter().all(|&cloud| kind(cloud) == kind(part[0]))), "{parts:?}");
    // Clouds of one kind have the voxels of their size.
    assert_eq!(parts.len(), 3, "{parts:?}");
}

#[test]
fn missing_returns_make_no_wrong_answer_reliable() {
    let (at, b) = ([1.0, 1.2, 1.4], [1.5, 1.0, 1.5]);
    let truth = [0, 1, 2].map(|axis| at[axis] - b[axis]);
    for distance in [0.0, 20.0, 30.0, 65.535, 1e4] {
        let seen = |at: Vec3, seed| {
            let points = room().seen(at, &camera(0.6), 12.0, 0.003, seed).into_iter().zip(camera(0.6));
            let lost = |i: usize| (30..80).contains(&(i % 120)) && (20..60).contains(&(i / 120));
            let missing = |ray: Vec3| ray.map(|v| (distance * v) as f32);
            let points = points.enumerate().map(|(i, (point, ray))| if lost(i) { missing(ray) } else { point });
            points.collect::<Vec<Point>>()
        };
        let registration = run(&seen(at, 1), &seen(b, 2)).unwrap();
        let t = registration.t_target_source.to_matrix();
        let error = (0..3).map(|axis| (t[axis][3] - truth[axis]).powi(2)).sum::<f64>().sqrt();
        assert!(registration.verdict.is_reliable && error < 0.05, "{distance}: {error} {registration:?}");
        let is_noted = registration.verdict.notes[0].contains("2000 of 10800 points");
        assert!(is_noted && registration.clouds.iter().all(|cloud| cloud.num_skipped == 2000), "{registration:?}");
    }
}

/// Two sweeps in a street with houses, cars and poles, so far apart (metres), and their transform. Both
/// sensors have any heading and are up to 2 degrees out of level.
fn sweeps(apart: f64, seed: u64) -> ([Vec<Point>; 2], RigidTransform) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let scene = street(&mut rng);
    let rays = lidar(-0.43, 0.05);
    let mut sweep = |x: f64, seed| {
        let heading = Vector3::z() * rng.random_range(-3.1..3.1);
        let tilt = [(); 2].map(|()| rng.random_range(-2.0..2.0_f64).to_radians());
        let place = Vector3::new(x, rng.random_range(-1.5..1.5), 1.8);
        let rotation = Rotation3::new(heading) * Rotation3::new(Vector3::new(tilt[0], tilt[1], 0.0));
        let pose = IsometryMatrix3::from_parts(place.into(), rotation);
        (scene.scan(&pose, &rays, 80.0, 0.02, &mut ChaCha8Rng::seed_from_u64(seed)), pose)
    };
    let ((source, source_pose), (target, target_pose)) = (sweep(0.0, seed + 100), sweep(apart, seed + 200));
    ([source, target], (target_pose.inverse() * source_pose).into())
}

#[test]
fn a_second_look_at_sweeps_finds_more_and_leaves_reliable_answers() {
    let mut counts = [0; 2];
    for seed in 20..23 {
        let ([source, target], truth) = sweeps(13.0, seed);
        let default = RegisterOptions::default();
        let second = register(&source, &target, &default).unwrap();
        // A length that is given is kept: there is no second look.
        let size = prepare(&[&source, &target], &[], None, &default, &Control::default()).unwrap().lengths.voxel_size;
        let first = register(&source, &target, &default.with_voxel_size(Some(Length::Units(size)))).unwrap();
        if first.verdict.is_reliable {
            assert_eq!(second.t_target_source, first.t_target_source);
        }
        for (count, result) in counts.iter_mut().zip([&first, &second]) {
            let (_, metres) = result.t_target_source.angle_and_distance_to(&truth);
            assert!(metres < 0.3 || !result.verdict.is_reliable, "{seed}: {result:?}");
            *count += usize::from(result.verdict.is_reliable);
        }
    }
    assert!(counts[1] > counts[0], "{counts:?}");
}

#[test]
fn sparse_clouds_have_no_reliable_transform() {
    let dense = room().seen([2.0, 1.0, 1.4], &lidar(-1.0, 1.0), 12.0, 0.003, 1);
    let dense: Vec<Point> = (0..8).flat_map(|i| dense.iter().map(move |p| p.map(|v| v + 1e-3 * i as f32))).collect();
    for count in [2, 30, 100] {
        let sparse: Vec<Point> = dense.iter().step_by(dense.len() / count).copied().collect();
        for (source, target) in [(&sparse, &dense), (&dense, &sparse)] {
            assert!(run(source, target).is_none_or(|registration| !registration.verdict.is_reliable), "{count}");
        }
    }
}

/// What a sensor on a motorway sees before it moved by `along`, with vehicles that keep pace with it up to `drift`, or
/// after. Rails and ground are the same everywhere, posts stand still.
fn motorway(along: f64, drift: f64, seed: u64) -> Vec<Point> {
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    let mut boxes = vec![[[-300.0, -60.0, -1.0], [300.0, 60.0, 0.0]]];
    boxes.extend([-11.0, 11.0].map(|y| [[-300.0, y - 0.1, 0.0], [300.0, y + 0.1, 0.8]]));
    for _ in 0..40 {
        let (x, y) = (rng.random_range(-70.0..95.0) - along, if rng.random_bool(0.5) { 12.5 } else { -12.5 });
        boxes.push([[x - 0.12, y - 0.12, 0.0], [x + 0.12, y + 0.12, 6.0]]);
    }
    for (x, y, size) in [
        (9.0, 1.8, [4.5, 1.8, 1.5]),
        (-25.0, 1.8, [12.0, 2.5, 3.8]),
        (18.0, -5.2, [4.5, 1.8, 1.5]),
        (-12.0, -5.2, [12.0, 2.5, 3.8]),
        (30.0, -1.8, [12.0, 2.5, 3.8]),
        (-9.0, 5.2, [4.5, 1.8, 1.5]),
        (24.0, 5.2, [4.5, 1.8, 1.5]),
    ] {
        let x = x + drift * f64::sin(10.0 * x);
        boxes.push([[x, y - size[1] / 2.0, 0.0], [x + size[0], y + size[1] / 2.0, size[2]]]);
    }
    Scene { boxes, ..Default::default() }.seen([0.0, -1.8, 1.9], &lidar(-0.43, 0.17), 90.0, 0.01, seed)
}

#[test]
fn posts_that_stand_still_beside_traffic_that_keeps_pace_make_it_ambiguous() {
    let registration = run(&motorway(0.0, 0.0, 1), &motorway(17.0, 0.0, 2)).unwrap();
    assert!(registration.verdict.is_ambiguous && !registration.verdict.is_reliable, "{registration:?}");
    let note = registration.verdict.notes.iter().find(|note| note.contains("as a whole")).unwrap();
    assert!(note.contains("moved by 17.") || note.contains("moved by 16.9"), "{note}");
    // Vehicles that drift lie apart.
    let apart = |note: &String| note.contains("lie apart");
    let registration = run(&motorway(0.0, 0.0, 1), &motorway(17.0, 0.5, 2)).unwrap();
    assert!(!registration.verdict.is_reliable && registration.verdict.notes.iter().any(apart), "{registration:?}");
    // If the sensor did stand still, nothing moved as a whole, and nothing lies apart.
    let registration = run(&motorway(0.0, 0.0, 1), &motorway(0.0, 0.0, 2)).unwrap();
    let moved = |note: &String| note.contains("as a whole") || apart(note);
    assert!(!registration.verdict.notes.iter().any(moved), "{registration:?}");
}

#[test]
fn sensors_are_found_in_the_coordinates_of_a_site_and_nothing_wrong_is_reliable() {
    let rays = lidar(-1.0, 1.0);
    let eyes = [[2.0, 1.5, 1.4], [4.6, 2.9, 1.3]];
    let scans = |seed| eyes.map(|at| room().seen(at, &rays, 30.0, 0.004, seed));
    for site in [[30.0, -20.0, 5.0], [0.0; 3]] {
        let placed = |scan, eye: Vec3| at_site(scan, std::array::from_fn(|axis| site[axis] + eye[axis]));
        let [source, target] = scans(1);
        let (source, target) = (placed(source, eyes[0]), placed(target, eyes[1]));
        let registration = run(&source, &target).unwrap();
        for (cloud, eye) in registration.clouds.iter().zip(eyes) {
            let position = cloud.position.unwrap();
            let off = (0..3).map(|axis| (position[axis] - site[axis] - eye[axis]).powi(2)).sum::<f64>().sqrt();
            assert!(cloud.viewpoint == ViewpointUsed::Found && off < 0.1 && cloud.visible > Some(0.9), "{cloud:?}");
        }
        let (angle, distance) = registration.t_target_source.angle_and_distance_to(&RigidTransform::identity());
        assert!((angle < 0.03 && distance < 0.1) || !registration.verdict.is_reliable, "{registration:?}");
        // No sensor is known for both scans as one cloud.
        let merged: Vec<Point> = [source.clone(), target].concat();
        assert_eq!(run(&source, &merged).unwrap().clouds[1].position, None);
    }
}

/// What a sensor 1.6 m above flat ground sees of a block of 8 x 6 x 4 m, with a porch and boxes about it.
fn block(x: f64, y: f64, seed: u64) -> Vec<Point> {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut boxes = vec![
        [[-60.0, -60.0, -1.0], [60.0, 60.0, 0.0]],
        [[0.0; 3], [8.0, 6.0, 4.0]],
        [[1.0, 6.0, 0.0], [2.2, 6.8, 2.0]],
    ];
    for _ in 0..12 {
        let (x, y) = (rng.random_range(-8.0..16.0), rng.random_range(-9.0..15.0));
        let [width, depth, height] = std::array::from_fn(|_| rng.random_range(0.4..1.5));
        boxes.push([[x, y, 0.0], [x + width, y + depth, height]]);
    }
    Scene { boxes, ..Default::default() }.seen([x, y, 1.6], &lidar(-1.0, 1.0), 25.0, 0.003, seed)
}

#[test]
fn a_block_seen_from_opposite_corners_is_not_turned_by_half() {
    let front = block(-5.0, -6.0, 1);
    let opposite = run(&block(13.0, 12.0, 2), &front).unwrap().verdict;
    assert!(opposite.is_ambiguous && !opposite.is_reliable, "{opposite:?}");
    let same = run(&block(-3.0, -8.0, 3), &front).unwrap();
    assert!(same.verdict.is_reliable, "{same:?}");
}

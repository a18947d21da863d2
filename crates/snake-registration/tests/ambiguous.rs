//! Clouds without a unique answer: planes, spheres, cylinders, mirror images, periodic structures,
//! different units.

use std::f32::consts::TAU;

use chacha20::ChaCha8Rng;
use rand::{RngExt, SeedableRng};
use snake_core::{Control, Point, Result, RigidTransform};
use snake_registration::{PairOptions, RegisterOptions, Registration, register, register_with};

/// A surface that is sampled at random.
type Sampler = fn(&mut ChaCha8Rng) -> Point;

fn plane(rng: &mut ChaCha8Rng) -> Point {
    [rng.random_range(-2.0..2.0), rng.random_range(-2.0..2.0), 0.0]
}

fn sphere(rng: &mut ChaCha8Rng) -> Point {
    let (z, angle): (f32, f32) = (rng.random_range(-1.0..1.0), rng.random_range(0.0..TAU));
    let radius = (1.0 - z * z).sqrt();
    [radius * angle.cos(), radius * angle.sin(), z]
}

fn cylinder(rng: &mut ChaCha8Rng) -> Point {
    let angle: f32 = rng.random_range(0.0..TAU);
    [angle.cos(), angle.sin(), rng.random_range(-3.0..3.0)]
}

/// A point of the surface of a box from 0 to `size`.
fn box_point(rng: &mut ChaCha8Rng, size: Point) -> Point {
    let mut point: Point = size.map(|side| rng.random_range(0.0..side));
    let areas = [size[1] * size[2], size[0] * size[2], size[0] * size[1]];
    let at = rng.random_range(0.0..areas.iter().sum::<f32>());
    let axis = usize::from(at > areas[0]) + usize::from(at > areas[0] + areas[1]);
    point[axis] = if rng.random_bool(0.5) { 0.0 } else { size[axis] };
    point
}

fn cube(rng: &mut ChaCha8Rng) -> Point {
    box_point(rng, [2.0; 3])
}

/// Eight equal pillars in a row on a floor.
fn pillars(rng: &mut ChaCha8Rng) -> Point {
    let pillar = rng.random_range(0..8) as f32;
    match rng.random_range(0..3) {
        0 => [rng.random_range(0.0..8.0), rng.random_range(-1.0..1.0), 0.0],
        _ => {
            let [x, y, z] = box_point(rng, [0.4, 0.4, 1.0]);
            [x + pillar + 0.3, y - 0.2, z]
        }
    }
}

/// A room with three boxes of different sizes.
fn room(rng: &mut ChaCha8Rng) -> Point {
    let (low, size) = match rng.random_range(0..8) {
        0..4 => ([-2.0, -2.0, 0.0], [4.0, 4.0, 2.5]),
        4..6 => ([-1.0, -1.5, 0.0], [1.0, 1.0, 0.8]),
        6 => ([0.7, 0.5, 0.0], [0.5, 1.2, 1.2]),
        _ => ([-1.8, 1.0, 0.0], [0.6, 0.8, 0.5]),
    };
    let point = box_point(rng, size);
    [0, 1, 2].map(|axis| point[axis] + low[axis])
}

fn sample(surface: Sampler, count: usize, seed: u64, noise: f32) -> Vec<Point> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let noisy =
        |rng: &mut ChaCha8Rng| surface(rng).map(|v| if noise > 0.0 { v + rng.random_range(-noise..noise) } else { v });
    (0..count).map(|_| noisy(&mut rng)).collect()
}

fn run(source: &[Point], target: &[Point]) -> Result<Registration> {
    register(source, target, &RegisterOptions::default())
}

/// Two samples of a surface. The target is rotated by 1 about x.
fn two_samples(surface: Sampler, count: usize, noise: f32) -> Result<Registration> {
    let (sin, cos) = 1.0_f32.sin_cos();
    let rotated =
        sample(surface, count, 2, noise).into_iter().map(|[x, y, z]| [x, cos * y - sin * z, sin * y + cos * z]);
    run(&sample(surface, count, 1, noise), &rotated.collect::<Vec<_>>())
}

#[test]
fn open_directions_are_named() {
    // The axes are in the target's frame. Edges of a plane may give no matches at all.
    for (name, surface, names) in [
        ("plane", plane as Sampler, "(0.00, -0.84, 0.54)"),
        ("sphere", sphere, "any rotation"),
        ("cylinder", cylinder, "translation along (0.00, -0.84, 0.54), rotation about (0.00, -0.84, 0.54)"),
    ] {
        // The largest component of a named axis is positive.
        let names = names.replace("-0.84, 0.54", "0.84, -0.54");
        match two_samples(surface, 20_000, 0.0) {
            Ok(Registration { verdict, .. }) => {
                let is_open = verdict.is_ambiguous && !verdict.is_reliable && verdict.confidence == 0.0;
                assert!(is_open && verdict.notes[0].contains(&names), "{name}: {verdict:?}");
            }
            Err(error) => assert!(error.to_string().contains("can move along its own surface"), "{name}: {error}"),
        }
    }
}

#[test]
fn symmetric_and_periodic_clouds_are_ambiguous() {
    for (name, surface, noise) in [
        ("cube", cube as Sampler, 0.0),
        ("pillars", pillars, 0.0),
        ("noisy pillars", pillars, 0.01),
        ("noisy sphere", sphere, 0.01),
        ("noisy cylinder", cylinder, 0.01),
    ] {
        let verdict = two_samples(surface, 8000, noise).unwrap().verdict;
        assert!(verdict.is_ambiguous && !verdict.is_reliable && verdict.confidence < 0.5, "{name}: {verdict:?}");
        assert!(verdict.notes.iter().any(|note| note.starts_with("ambiguous")), "{name}: {verdict:?}");
    }
}

#[test]
fn a_mirror_image_has_no_reliable_transform_and_the_room_itself_has_one() {
    let (source, target) = (sample(room, 8000, 1, 0.0), sample(room, 8000, 2, 0.0));
    let verdict = run(&source, &target).unwrap().verdict;
    assert!(verdict.is_reliable && !verdict.is_ambiguous && verdict.notes.is_empty(), "{verdict:?}");
    let mirrored: Vec<Point> = target.iter().map(|[x, y, z]| [-x, *y, *z]).collect();
    let registration = run(&source, &mirrored).unwrap();
    assert!(!registration.verdict.is_reliable && registration.verdict.confidence < 0.4, "{registration:?}");
}

/// The same room with other things in it, which has no corner of its own.
fn emptied_room(rng: &mut ChaCha8Rng) -> Point {
    let (low, size) = match rng.random_range(0..8) {
        0..6 => ([-2.0, -2.0, 0.0], [4.0, 4.0, 2.5]),
        6 => ([0.2, -1.4, 0.0], [0.7, 0.4, 0.9]),
        _ => ([-0.6, 0.9, 0.0], [0.5, 0.5, 1.3]),
    };
    let point = box_point(rng, size);
    [0, 1, 2].map(|axis| point[axis] + low[axis])
}

#[test]
fn walls_alone_fit_at_four_headings() {
    let (source, target) = (sample(room, 8000, 1, 0.0), sample(emptied_room, 8000, 2, 0.0));
    let registration = run(&source, &target).unwrap();
    assert!(!registration.verdict.is_reliable, "{registration:?}");
}

#[test]
fn millimetres_beside_metres_are_asked_about() {
    let (source, target) = (sample(room, 8000, 1, 0.0), sample(room, 8000, 2, 0.0));
    let millimetres: Vec<Point> = source.iter().map(|point| point.map(|v| 1000.0 * v)).collect();
    for (from, to) in [(&millimetres, &target), (&target, &millimetres)] {
        match run(from, to) {
            Ok(registration) => {
                assert!(registration.verdict.notes.iter().any(|note| note.contains("units")), "{registration:?}")
            }
            Err(error) => assert!(error.to_string().contains("times as large"), "{error}"),
        }
    }
}

#[test]
fn a_source_of_another_scale_is_noted() {
    let (source, target) = (sample(room, 8000, 1, 0.0), sample(room, 8000, 2, 0.0));
    for (scale, expected) in [(1.0 / 1.05, Some("1.05")), (1.0 / 0.97, Some("0.97")), (1.0, None)] {
        let scaled: Vec<Point> = source.iter().map(|point| point.map(|v| scale * v)).collect();
        let notes = run(&scaled, &target).unwrap().verdict.notes;
        let note = notes.iter().find(|note| note.contains("times as large"));
        assert_eq!(note.is_some(), expected.is_some(), "{scale}: {notes:?}");
        assert!(expected.is_none_or(|factor| note.is_some_and(|note| note.contains(factor))), "{scale}: {notes:?}");
    }
}

#[test]
fn a_source_of_unknown_scale_is_registered() {
    let (source, target) = (sample(room, 6000, 1, 0.0), sample(room, 6000, 2, 0.0));
    let scaled: Vec<Point> = source.iter().map(|point| point.map(|v| v / 1.3)).collect();
    let run = |pair_options| {
        register_with(&scaled, &target, None, &RegisterOptions::default(), &pair_options, &Control::default())
    };
    let unknown = PairOptions::default().with_estimate_scale(true);
    let registration = run(unknown).unwrap();
    assert!((registration.scale - 1.3).abs() < 0.01 && registration.verdict.is_reliable, "{registration:?}");
    let (angle, distance) = registration.t_target_source.angle_and_distance_to(&RigidTransform::identity());
    assert!(angle < 0.02 && distance < 0.05, "{registration:?}");
    let written = serde_json::to_value(&registration).unwrap();
    assert_eq!(written["scale"], registration.scale);
    // Between points with their origins added the similarity maps as before.
    let far = registration.clone().between_origins([10.0, 0.0, 0.0], [0.0, 5.0, 0.0]);
    let [from, near] = [[11.0, 2.0, 3.0], [1.0, 2.0, 3.0]].map(|p: Point| p.map(|v| registration.scale as f32 * v));
    let [from, near] = [far.t_target_source.apply(from), registration.t_target_source.apply(near)];
    assert!((0..3).all(|axis| (from[axis] - near[axis] - [0.0, 5.0, 0.0][axis]).abs() < 1e-3), "{from:?} {near:?}");
    let guess = unknown.with_initial(Some(RigidTransform::identity()));
    assert!(run(guess).unwrap_err().to_string().contains("`estimate_scale`"));
}

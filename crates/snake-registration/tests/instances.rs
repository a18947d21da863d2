//! Equal parts in a bin, seen by one depth camera from above: each shows about half of its surface.

use std::f64::consts::{FRAC_PI_2, TAU};
use std::num::NonZeroUsize;

use nalgebra::{IsometryMatrix3, Rotation3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use snake_core::{Control, Point, RigidTransform};
use snake_geometry::{Neighbors, vector};
use snake_registration::{Instance, PairOptions, RegisterOptions, Registration, register_with};

type Vector = Vector3<f64>;

/// The part: an angle with a boss and a lip, boxes from a low to a high corner. No turn maps it onto
/// itself.
const PART: [[[f64; 3]; 2]; 4] = [
    [[0.0, 0.0, 0.0], [1.0, 0.6, 0.15]],
    [[0.0, 0.0, 0.15], [0.15, 0.6, 0.7]],
    [[0.55, 0.1, 0.15], [0.8, 0.35, 0.4]],
    [[0.9, 0.3, 0.15], [1.0, 0.6, 0.3]],
];

/// The whole surface of the part, sampled at random.
fn part(count: usize, seed: u64) -> Vec<Point> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let is_inside = |p: &[f64; 3]| {
        let is_in = |[low, high]: &[[f64; 3]; 2]| (0..3).all(|axis| low[axis] < p[axis] && p[axis] < high[axis]);
        PART.iter().any(is_in)
    };
    let mut points = Vec::new();
    while points.len() < count {
        // Random lines cross a surface in proportion to its area.
        let mut vector = || Vector::from_fn(|_, _| rng.random_range(-1.0..1.0));
        let (ray, at) = (vector(), vector() + Vector::new(0.5, 0.3, 0.35));
        if ray.norm() > 1.0 {
            continue;
        }
        for ends in PART.iter().filter_map(|part| crossings(part, &(at - 9.0 * ray.normalize()), &ray.normalize())) {
            for range in [ends.0 - 1e-6, ends.1 + 1e-6] {
                let hit: [f64; 3] = (at + (range - 9.0) * ray.normalize()).into();
                if !is_inside(&hit) {
                    points.push(hit.map(|v| v as f32));
                }
            }
        }
    }
    points.truncate(count);
    points
}

/// Where a ray enters and leaves a box.
fn crossings([low, high]: &[[f64; 3]; 2], at: &Vector, ray: &Vector) -> Option<(f64, f64)> {
    let (mut near, mut far) = (f64::NEG_INFINITY, f64::INFINITY);
    for axis in 0..3 {
        let (a, b) = ((low[axis] - at[axis]) / ray[axis], (high[axis] - at[axis]) / ray[axis]);
        (near, far) = (near.max(a.min(b)), far.min(a.max(b)));
    }
    (near < far && near > 0.0).then_some((near, far))
}

/// What a camera at the origin sees of a floor 5 below it with up to six parts, and their poses. Each
/// part lies on one of three sides, tilted by up to `max_tilt` radians about two axes.
fn bin(seed: u64, count: i32, max_tilt: f64) -> (Vec<Point>, Vec<RigidTransform>) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let poses: Vec<_> = (0..count)
        .map(|place| {
            let side = [Vector::zeros(), FRAC_PI_2 * Vector::x(), -FRAC_PI_2 * Vector::y()][rng.random_range(0..3)];
            let mut angle = || rng.random_range(-max_tilt..max_tilt);
            let tilt = Vector::new(angle(), angle(), 0.0);
            let heading = rng.random_range(0.0..TAU) * Vector::z();
            let rotation = Rotation3::new(heading) * Rotation3::new(tilt) * Rotation3::new(side);
            let center = rotation * Vector::new(0.5, 0.3, 0.3);
            let corners = PART.iter().flat_map(|[low, high]| {
                (0..8).map(move |i| Vector::from_fn(|axis, _| if i >> axis & 1 == 0 { low[axis] } else { high[axis] }))
            });
            let lowest = corners.map(|corner| (rotation * corner).z).fold(f64::INFINITY, f64::min);
            let mut jitter = || rng.random_range(-0.1..0.1);
            let at = Vector::new(
                1.2 * f64::from(place % 3 - 1) + jitter() - center.x,
                1.2 * (f64::from(place / 3) - 0.5) + jitter() - center.y,
                -5.0 - lowest,
            );
            IsometryMatrix3::from_parts(at.into(), rotation)
        })
        .collect();
    let inverses: Vec<_> = poses.iter().map(IsometryMatrix3::inverse).collect();
    let mut seen = Vec::new();
    for pixel in 0..260 * 180 {
        let ray = Vector::new(f64::from(pixel % 260 - 130) / 333.0, f64::from(pixel / 260 - 90) / 333.0, -1.0);
        let hits = inverses.iter().flat_map(|inverse| {
            let (at, ray) = (inverse.translation.vector, inverse.rotation * ray);
            PART.iter().filter_map(move |part| Some(crossings(part, &at, &ray)?.0))
        });
        let range = hits.fold(5.0, f64::min) + 0.002 * rng.random_range(-1.7..1.7);
        seen.push((range * ray).map(|v| v as f32).into());
    }
    (seen, poses.into_iter().map(RigidTransform::from).collect())
}

/// The registration of the part to what is seen of a bin, for at most so many instances.
fn instances(seen: &[Point], count: usize) -> Registration {
    let (options, pair_options) = (RegisterOptions::default(), PairOptions::default().with_instances(count));
    register_with(&part(10_000, 1), seen, None, &options, &pair_options, &Control::default()).unwrap()
}

/// Whether one of the poses is this one, to within 5 degrees and two voxels.
fn is_right(instance: &Instance, poses: &[RigidTransform]) -> bool {
    let differences = poses.iter().map(|pose| instance.t_target_source.angle_and_distance_to(pose));
    let (max_angle, max_distance) = (5_f64.to_radians(), 2.0 * instance.fit.voxel_size);
    differences.into_iter().any(|(angle, distance)| angle < max_angle && distance < max_distance)
}

#[test]
fn most_of_six_equal_parts_in_a_bin_are_found() {
    let (seen, poses) = bin(7, 6, 0.2);
    let registration = instances(&seen, 6);
    let [right, wrong] = [true, false].map(|expected| {
        let reliable = registration.instances.iter().filter(|instance| instance.verdict.is_reliable);
        reliable.filter(|instance| is_right(instance, &poses) == expected).count()
    });
    assert!(right >= 4 && wrong == 0, "{right} right, {wrong} wrong: {registration:?}");
    assert_eq!(registration.t_target_source, registration.instances[0].t_target_source);
    let confidences: Vec<f64> = registration.instances.iter().map(|instance| instance.verdict.confidence).collect();
    assert!(confidences.is_sorted_by(|a, b| a >= b), "{confidences:?}");
}

#[test]
fn fewer_instances_than_asked_for_are_noted_and_threads_do_not_matter() {
    let (mut seen, poses) = bin(2, 2, 0.2);
    // Most of the floor is far from both.
    seen.retain(|[x, y, _]| *x < 0.6 && *y < 0.1);
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| instances(&seen, 3))
    };
    let registration = run(1);
    let reliable = registration.instances.iter().filter(|instance| instance.verdict.is_reliable);
    assert!(reliable.clone().count() == 2 && reliable.clone().all(|one| is_right(one, &poses)), "{registration:?}");
    let note = "2 reliable instances of 3 were found";
    assert!(registration.verdict.notes.iter().any(|words| words == note), "{registration:?}");
    assert_eq!(registration.instances, run(3).instances);
}

#[test]
fn a_guess_leads_to_one_instance() {
    let guessed = PairOptions::default().with_instances(2).with_initial(Some(RigidTransform::identity()));
    let seen = part(500, 1);
    let error = register_with(&seen, &seen, None, &RegisterOptions::default(), &guessed, &Control::default());
    assert!(error.unwrap_err().to_string().contains("`instances`"));
}

/// The share of the part's surface that is seen at a pose.
fn seen_share(seen: &Neighbors, pose: &RigidTransform) -> f64 {
    let surface = part(4000, 2);
    let distance = |point: &Point| seen.nearest(&vector(pose.apply(*point)), NonZeroUsize::MIN)[0].1;
    surface.iter().filter(|point| distance(point) < 0.02).count() as f64 / surface.len() as f64
}

/// How many are found in eight bins of parts that lie, and in eight of parts that lean:
/// `cargo test --release --test instances -- --ignored --nocapture`.
#[test]
#[ignore = "takes minutes"]
fn table() {
    for (max_tilt, seeds) in [(0.2, 0..8), (0.8, 0..8)] {
        for seed in seeds {
            let (seen, poses) = bin(seed, 6, max_tilt);
            let registration = instances(&seen, 6);
            let reliable: Vec<_> = registration.instances.iter().filter(|one| one.verdict.is_reliable).collect();
            let is_found = |pose: &RigidTransform| reliable.iter().any(|one| is_right(one, std::slice::from_ref(pose)));
            let seen = Neighbors::new(seen.iter().copied().map(vector).collect()).unwrap();
            let parts: Vec<(f64, bool)> = poses.iter().map(|pose| (seen_share(&seen, pose), is_found(pose))).collect();
            let wrong = reliable.iter().filter(|one| !is_right(one, &poses)).count();
            println!(
                "tilt {max_tilt} seed {seed}: {} right and reliable, {wrong} wrong, {:.2} s; share seen and whether found: \
                 {parts:.2?}",
                parts.iter().filter(|(_, is_found)| *is_found).count(),
                registration.seconds
            );
        }
    }
}

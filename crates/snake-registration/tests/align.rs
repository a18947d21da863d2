//! Poses of many clouds: sweeps in a made street, and storeys of a made house.

use chacha20::ChaCha8Rng;
use nalgebra::{IsometryMatrix3, Vector3};
use rand::{RngExt, SeedableRng};
use snake_core::{Control, Length, Point, RigidTransform};
use snake_registration::steps::prepare;
use snake_registration::{AlignOptions, AlignPriors, Alignment, Contradiction, RegisterOptions, align, align_with};

use self::scenes::{Scene, lidar, street};

mod scenes;

/// Sweeps of a LiDAR with 32 beams at these places of a street, and its poses.
fn sweeps(places: &[f64], seed: u64) -> (Vec<Vec<Point>>, Vec<IsometryMatrix3<f64>>) {
    let rays = lidar(32, 720, -0.43, 0.05);
    let (scene, mut rng) = (street(&mut ChaCha8Rng::seed_from_u64(seed)), ChaCha8Rng::seed_from_u64(seed + 100));
    let sweep = |x: &f64| {
        let place = Vector3::new(*x, rng.random_range(-1.5..1.5), 1.8);
        let pose = IsometryMatrix3::new(place, Vector3::z() * rng.random_range(-3.1..3.1));
        (scene.scan(&pose, &rays, 80.0, 0.02, &mut rng), pose)
    };
    places.iter().map(sweep).unzip()
}

/// The largest error of a pose in the frame of the first cloud, in metres.
fn error(alignment: &Alignment, poses: &[IsometryMatrix3<f64>]) -> f64 {
    let errors = alignment.poses.iter().zip(poses).map(|(pose, truth)| {
        let truth = RigidTransform::from(poses[0].inverse() * truth);
        pose.t_part_cloud.angle_and_distance_to(&truth).1
    });
    errors.fold(0.0, f64::max)
}

#[test]
fn poses_of_sweeps_are_refined_on_their_points() {
    let (clouds, poses) = sweeps(&[0.0, 5.0, 9.0], 1);
    let alignment = align(&clouds, &RegisterOptions::default()).unwrap();
    assert_eq!(alignment.parts, [[0, 1, 2]]);
    assert!(error(&alignment, &poses) < 0.02, "{} m", error(&alignment, &poses));
}

#[test]
fn sweeps_that_the_first_look_leaves_apart_are_joined() {
    for seed in [9, 15] {
        let (clouds, poses) = sweeps(&[0.0, 13.0], seed);
        let joined = align(&clouds, &RegisterOptions::default()).unwrap();
        assert!(joined.parts.len() == 1 && error(&joined, &poses) < 0.02, "seed {seed}: {joined:?}");
        // A length that is given is kept: there is no second look.
        let points: Vec<&[Point]> = clouds.iter().map(Vec::as_slice).collect();
        let usual = prepare(&points, &[], None, &RegisterOptions::default(), &Control::default()).unwrap();
        let side = Some(Length::Units(usual.lengths.voxel_size));
        let apart = align(&clouds, &RegisterOptions::default().with_voxel_size(side)).unwrap();
        assert_eq!(apart.parts.len(), 2, "seed {seed}");
    }
}

/// What a scanner on each of three storeys of a house sees, 3 m apart, with one floor plan; the
/// poses of the storeys.
fn storeys() -> (Vec<Vec<Point>>, Vec<IsometryMatrix3<f64>>) {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let boxes = [
        [[-6.0, -4.0, -0.2], [7.0, 4.0, 0.0]],
        [[-6.0, -4.0, 2.6], [7.0, 4.0, 2.8]],
        [[-6.2, -4.0, 0.0], [-6.0, 4.0, 2.6]],
        [[7.0, -4.0, 0.0], [7.2, 4.0, 2.6]],
        [[-6.0, -4.2, 0.0], [7.0, -4.0, 2.6]],
        [[-6.0, 4.0, 0.0], [7.0, 4.2, 2.6]],
        [[1.5, -4.0, 0.0], [1.7, 0.5, 2.6]],
        [[-3.0, 1.5, 0.0], [-2.8, 4.0, 2.6]],
        [[3.0, 1.0, 0.0], [4.2, 1.8, 0.8]],
        [[-5.0, -3.5, 0.0], [-3.0, -2.5, 1.9]],
        [[-1.0, -1.8, 0.0], [-0.4, -0.6, 1.1]],
        [[5.5, -3.8, 0.0], [6.8, -3.0, 2.1]],
    ];
    let house = Scene { boxes: boxes.to_vec(), ..Default::default() };
    let rays = lidar(101, 240, -1.5, 1.5);
    let scan = |storey: u32| {
        let place = Vector3::new(rng.random_range(-0.5..0.5), rng.random_range(-0.3..0.8), 1.5);
        let heading = Vector3::z() * rng.random_range(-3.1..3.1);
        let in_storey = IsometryMatrix3::new(place, heading);
        let points = house.scan(&in_storey, &rays, f64::INFINITY, 0.005, &mut rng);
        (points, IsometryMatrix3::new(place + Vector3::z() * 3.0 * f64::from(storey), heading))
    };
    (0..3).map(scan).unzip()
}

#[test]
fn initial_poses_keep_storeys_with_one_floor_plan_apart() {
    let (clouds, poses) = storeys();
    let run = |poses: Vec<Option<RigidTransform>>, tolerance: Option<f64>| {
        let known = AlignPriors::default().with_initial_poses(poses);
        let options = AlignOptions::default().with_pose_tolerance(tolerance.map(Length::Units));
        align_with(&clouds, &known, None, &RegisterOptions::default(), &options, &Control::default()).unwrap()
    };
    // Off by some decimetres and degrees, as of a plan.
    let rough = IsometryMatrix3::new(Vector3::new(0.3, -0.4, 0.2), Vector3::new(0.0, 0.02, 0.05));
    let priors: Vec<Option<RigidTransform>> =
        poses.iter().enumerate().map(|(i, pose)| Some((if i == 1 { pose * rough } else { *pose }).into())).collect();
    assert_eq!(run(vec![], None).parts, [[0, 1, 2]]);
    let told = run(priors.clone(), None);
    assert_eq!(told.parts, [[0], [1], [2]]);
    let noted = |at: &Contradiction| at.distance > 2.5 && at.tolerance < 2.0 && at.source > at.target;
    assert!(!told.contradictions.is_empty() && told.contradictions.iter().all(noted), "{:?}", told.contradictions);
    assert!(told.notes[0].contains("reliable registrations contradict the initial poses"), "{:?}", told.notes);
    // A greater tolerance allows them, and clouds without poses are placed by the others.
    assert_eq!(run(priors, Some(9.0)).parts, [[0, 1, 2]]);
}

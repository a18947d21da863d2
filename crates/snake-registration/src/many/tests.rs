//! Tests of alignment as a whole.

use chacha20::ChaCha8Rng;
use nalgebra::{IsometryMatrix3, Translation3};
use rand::SeedableRng;

use super::*;
use crate::Detector;
use crate::rigid::tests::{random_points, random_transform, sample};
use crate::rigid::transform_points;
use snake_core::CancelFlag;
use snake_geometry::{RigidTransform, Vector};

/// Three samplings of the sample, each moved; a closed surface that fits none of them is cloud 1.
fn clouds() -> (Vec<Vec<Point>>, Vec<RigidTransform>) {
    let points = sample();
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let poses: Vec<RigidTransform> = (0..4).map(|_| random_transform(&mut rng).into()).collect();
    let sampling = |start: usize| points.iter().skip(start).step_by(2).copied().collect::<Vec<Point>>();
    let mut box_points = random_points(&mut rng, 2000);
    box_points.iter_mut().enumerate().for_each(|(i, p)| p[i % 3] = if i % 2 == 0 { 1.0 } else { -1.0 });
    let all = [sampling(0), box_points, sampling(1), points[..2500].to_vec()];
    (all.iter().zip(&poses).map(|(points, pose)| transform_points(pose, points)).collect(), poses)
}

fn run(clouds: &[Vec<Point>], align_options: &AlignOptions) -> Result<Alignment> {
    align_with(clouds, &AlignPriors::default(), None, &RegisterOptions::default(), align_options, &Control::default())
}

#[test]
fn clouds_of_one_shape_are_one_part_and_others_another() {
    let (clouds, poses) = clouds();
    let alignment = run(&clouds, &AlignOptions::default()).unwrap();
    assert_eq!(alignment.parts, [vec![0, 2, 3], vec![1]]);
    assert_eq!(alignment.num_pairs, 6);
    assert_eq!(alignment.poses[0].t_part_cloud, RigidTransform::identity());
    assert_eq!(alignment.poses[1].t_part_cloud, RigidTransform::identity());
    for cloud in [2, 3] {
        let truth = poses[0] * poses[cloud].inverse();
        let (angle, _) = alignment.poses[cloud].t_part_cloud.angle_and_distance_to(&truth);
        let residuals = clouds[cloud].iter().map(|&p| {
            let (a, b) = (alignment.poses[cloud].t_part_cloud.apply(p), truth.apply(p));
            (0..3).map(|axis| (a[axis] - b[axis]).abs()).fold(0.0, f32::max)
        });
        assert!(angle < 0.02 && residuals.fold(0.0, f32::max) < 0.03, "{alignment:?}");
        assert!(alignment.poses[cloud].covariance[3][3] > 0.0 && alignment.poses[cloud].part == 0);
    }
    let pairs: Vec<_> = alignment.edges.iter().map(|edge| (edge.source, edge.target)).collect();
    assert_eq!(pairs, [(2, 0), (3, 0), (3, 2)]);
    assert!(alignment.edges.iter().all(|edge| edge.belief >= edge.confidence && edge.residual < 0.05));
}

#[test]
fn threads_do_not_matter() {
    let (clouds, _) = clouds();
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let options = AlignOptions::default().with_max_partners(1);
        Alignment { seconds: 0.0, ..pool.install(|| run(&clouds, &options).unwrap()) }
    };
    let one = run(1);
    assert!(one.num_pairs < 6 && one.num_pairs >= 3, "{one:?}");
    assert_eq!(one, run(3));
}

#[test]
fn origins_far_from_zero_are_added_to_the_transforms() {
    let (clouds, _) = clouds();
    let alignment = run(&clouds, &AlignOptions::default()).unwrap();
    let origins: Vec<[f64; 3]> = (0..4).map(|i| [1e5 * f64::from(i), 2e6, -3.0]).collect();
    let far = alignment.clone().between_origins(&origins);
    let at = |cloud: usize, point: [f64; 3]| {
        let whole = std::array::from_fn(|axis| point[axis] + origins[cloud][axis]);
        far.poses[cloud].t_part_cloud.apply_vector(&Vector::from(whole))
    };
    let near = alignment.poses[2].t_part_cloud.apply_vector(&Vector::new(0.1, 0.2, 0.3));
    assert!((at(2, [0.1, 0.2, 0.3]) - (near + Vector::from(origins[0]))).norm() < 1e-6);
}

#[test]
fn bad_clouds_and_options_are_refused() {
    let (clouds, _) = clouds();
    let refused = |clouds: &[Vec<Point>], viewpoints: &[Option<[f64; 3]>], options: &RegisterOptions| {
        let align_options = AlignOptions::default();
        let known = AlignPriors::default().with_viewpoints(viewpoints.to_vec());
        let alignment = align_with(clouds, &known, None, options, &align_options, &Control::default());
        alignment.unwrap_err().to_string()
    };
    let default = RegisterOptions::default();
    assert!(refused(&clouds[..1], &[], &default).contains("2 to 500"));
    let error = refused(&[clouds[0].clone(), clouds[1].clone(), vec![[1.0; 3]; 3]], &[], &default);
    assert!(error.contains("cloud 2 (from 0)") && error.contains("two different"), "{error}");
    assert!(refused(&clouds, &[None], &default).contains("viewpoints"));
    assert!(refused(&clouds, &[Some([f64::NAN; 3]); 4], &default).contains("-1e15 to 1e15"));
    let far = [None, Some([0.0, 0.0, 1e200]), None, None];
    assert!(refused(&clouds, &far, &default).contains("-1e15 to 1e15"));
    assert!(refused(&clouds, &[], &default.with_max_matches(1)).contains("max_matches"));
    assert!(refused(&clouds, &[], &default.with_detector(Detector::Snake)).contains("model"));
    let none = run(&clouds, &AlignOptions::default().with_max_partners(0)).unwrap_err().to_string();
    assert!(none.contains("max_partners"), "{none}");
    let flag = CancelFlag::default();
    flag.cancel();
    let control = Control::new().cancel(&flag);
    let stopped = align_with(&clouds, &AlignPriors::default(), None, &default, &AlignOptions::default(), &control);
    assert!(matches!(stopped, Err(Error::Cancelled)));
}

#[test]
fn a_cloud_in_other_units_is_asked_about() {
    let (mut clouds, _) = clouds();
    clouds[2].as_flattened_mut().iter_mut().for_each(|v| *v *= 1000.0);
    let notes = run(&clouds, &AlignOptions::default()).unwrap().notes;
    assert!(notes[0].starts_with("cloud 2 (from 0)") && notes[0].contains("units"), "{notes:?}");
    // The box fits no cloud, which is said once.
    let left_out = |note: &&String| note.contains(" 1 (from 0) are left out: ") || note.contains("clouds 1 and");
    assert_eq!(notes.iter().filter(left_out).count(), 1, "{notes:?}");
}

#[test]
fn poses_that_put_clouds_elsewhere_are_explained() {
    let (clouds, poses) = clouds();
    let check = |poses: Vec<RigidTransform>, words: &str| {
        let known = AlignPriors::default().with_initial_poses(poses.into_iter().map(Some).collect());
        let (options, align_options) = Default::default();
        let aligned = align_with(&clouds, &known, None, &options, &align_options, &Control::default()).unwrap();
        assert!(aligned.notes[0].contains(words), "{:?}", aligned.notes);
    };
    let changed = |change: fn(usize, &Vector) -> Vector| {
        let one = |(cloud, pose): (usize, &RigidTransform)| {
            let pose = pose.inverse();
            let at = Translation3::from(change(cloud, &pose.isometry().translation.vector));
            IsometryMatrix3::from_parts(at, pose.isometry().rotation).into()
        };
        poses.iter().enumerate().map(one).collect()
    };
    check(changed(|_, at| 1000.0 * at), "in the unit of the clouds they fit");
    check(changed(|cloud, at| at.add_scalar(if cloud == 3 { 50.0 } else { 0.0 })), "all are of cloud 3");
    check(poses.clone(), "their inverses fit");
}

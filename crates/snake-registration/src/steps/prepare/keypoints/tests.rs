use super::*;
use crate::options::Descriptor;
use crate::rigid::tests::sample;
use crate::steps::prepare::Lengths;
use Detector::{Fps, Harris3d, Iss, Random, Sift3d, Snake, SurfaceVariation, Voxels};
use snake_core::{Builtin, Field, Model};
use snake_geometry::{Neighbors, vector};

fn with_model(cloud: VoxelCloud, model: &Model) -> VoxelCloud {
    let options = VoxelCloud::default_options(model, cloud.voxel_size);
    cloud.with_model(model, options)
}

/// The voxels of a cloud, without a model.
fn voxel_cloud(points: &[Point], voxel_size: f64) -> VoxelCloud {
    VoxelCloud::new(points, &Lengths::from_spacing(voxel_size, voxel_size), &Control::default()).unwrap()
}

fn with_compact(points: &[Point], voxel_size: f64) -> VoxelCloud {
    with_model(voxel_cloud(points, voxel_size), &Model::builtin(Builtin::Compact))
}

/// Keypoints of a cloud with the seed 0.
fn keypoints(cloud: &VoxelCloud, detector: Detector, count: usize) -> Vec<Point> {
    cloud.keypoints(detector, count, 0, &Control::default()).unwrap()
}

#[test]
fn every_detector_has_keypoints_of_its_own_on_the_cloud_best_first() {
    let cloud = with_compact(&sample(), 0.02);
    let mut earlier: Vec<Vec<Point>> = Vec::new();
    for detector in [Voxels, Snake, Iss, Harris3d, Sift3d, SurfaceVariation, Fps, Random] {
        let keypoints = |count, seed| cloud.keypoints(detector, count, seed, &Control::default()).unwrap();
        let chosen = keypoints(100, 0);
        assert!((5..=100).contains(&chosen.len()), "{detector:?}: {}", chosen.len());
        let drawn = [Voxels, Random].contains(&detector);
        assert!(detector == Voxels || keypoints(5, 0) == chosen[..5], "{detector:?}");
        assert_eq!(keypoints(100, 1) == chosen, !drawn, "{detector:?}");
        assert!(chosen.iter().all(|&point| cloud.voxels.distance(&vector(point)) < 0.1), "{detector:?}");
        assert!(!earlier.contains(&chosen), "{detector:?}");
        earlier.push(chosen);
    }
    let sparse: Vec<Point> = sample().into_iter().step_by(20).collect();
    let sparse_cloud = with_compact(&sparse, 1e-3);
    assert_eq!(keypoints(&sparse_cloud, Snake, 100_000).len(), sparse.len());
    let error = cloud.keypoints(Iss, 0, 0, &Control::default()).unwrap_err().to_string();
    assert!(error.contains("count"), "{error}");
}

#[test]
fn spread_keypoints_have_the_wanted_number_and_cover_the_cloud() {
    let cloud = with_compact(&sample(), 0.02);
    let uncovered = |keypoints: &[Point]| {
        let tree = Neighbors::new(keypoints.iter().map(|&point| vector(point)).collect()).unwrap();
        cloud.voxels.points.iter().map(|voxel| tree.distance(voxel)).sum::<f64>()
    };
    for detector in [Voxels, Snake, Random, Fps] {
        let spread = |count, seed| cloud.spread_keypoints(detector, count, seed, &Control::default()).unwrap();
        let (chosen, best) = (spread(60, 0), keypoints(&cloud, detector, 60));
        assert_eq!(chosen.len(), 60, "{detector:?}");
        let [spread_out, clustered] = [&chosen, &best].map(|keypoints| uncovered(keypoints));
        let most = if detector == Fps { 1.0 } else { 0.9 };
        assert!(spread_out <= most * clustered, "{detector:?}: {spread_out} {clustered}");
        assert_eq!(spread(60, 1) == chosen, ![Voxels, Random].contains(&detector), "{detector:?}");
    }
    // ISS finds fewer than are wanted.
    let all = keypoints(&cloud, Iss, 5000);
    assert_eq!(cloud.spread_keypoints(Iss, 5000, 0, &Control::default()).unwrap(), all);
}

#[test]
fn the_model_runs_only_for_what_asks_for_its_field_and_once() {
    for name in Model::NAMES {
        let cloud = with_model(voxel_cloud(&sample(), 0.05), &Model::named(name).unwrap());
        keypoints(&cloud, Iss, 10);
        cloud.descriptors(&sample()[..3], Descriptor::Fpfh, &Control::default()).unwrap();
        assert!(cloud.encoded_field().is_none(), "{name}");
        keypoints(&cloud, Snake, 10);
        cloud.descriptors(&sample()[..3], Descriptor::Field, &Control::default()).unwrap();
        let first: *const Field = cloud.encoded_field().unwrap();
        cloud.descriptors(&sample()[..3], Descriptor::Field, &Control::default()).unwrap();
        assert!(std::ptr::eq(first, cloud.encoded_field().unwrap()), "{name}");
    }
}

#[test]
fn a_cloud_without_a_model_has_neither_its_keypoints_nor_its_descriptors() {
    let cloud = voxel_cloud(&sample(), 0.05);
    let refused = [
        cloud.keypoints(Snake, 10, 0, &Control::default()).err(),
        cloud.spread_keypoints(Snake, 10, 0, &Control::default()).err(),
        cloud.descriptors(&sample()[..3], Descriptor::Field, &Control::default()).err(),
        cloud.dimension(Descriptor::Field).err(),
    ];
    for error in refused {
        let error = error.unwrap().to_string();
        assert!(error.contains("`model` is none"), "{error}");
    }
}

#[test]
fn descriptors_are_rows_of_the_voxel_nearest_to_each_point() {
    let cloud = with_compact(&sample(), 0.05);
    let voxels: Vec<Point> = cloud.voxels.points.iter().map(|point| point.map(|v| v as f32).into()).collect();
    for descriptor in [Descriptor::Fpfh, Descriptor::Field] {
        let all = cloud.descriptors(&voxels, descriptor, &Control::default()).unwrap();
        let dimension = cloud.dimension(descriptor).unwrap();
        assert_eq!(all.len(), voxels.len() * dimension);
        let two = cloud.descriptors(&voxels[7..9], descriptor, &Control::default()).unwrap();
        assert_eq!(two, all[7 * dimension..9 * dimension]);
        assert!(cloud.descriptors(&[[f32::NAN; 3]], descriptor, &Control::default()).is_err());
        assert!(cloud.descriptors(&[], descriptor, &Control::default()).unwrap().is_empty());
    }
    let beside = voxels[3].map(|v| v + 1e-4);
    let fpfh = |points: &[Point]| cloud.descriptors(points, Descriptor::Fpfh, &Control::default()).unwrap();
    assert_eq!(fpfh(&[beside]), fpfh(&voxels[3..4]));
}

use std::collections::HashSet;
use std::path::Path;

use safetensors::SafeTensors;

use super::{Encoder, EncoderMemory};
use crate::control::{Control, Counter};
use crate::lattice::Lattice;
use crate::network::volume::Volume;
use crate::{Builtin, DetectOptions, EncodeOptions, Field, Keypoint, Length, Model};
use snake_geometry::{Cloud, Normalization, Point};

fn folder() -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/golden/scene")
}

fn model() -> Model {
    Model::load(folder().join("weights.safetensors")).unwrap()
}

fn floats(file: &SafeTensors, name: &str) -> Vec<f32> {
    file.tensor(name).unwrap().data().as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)).collect()
}

fn points(file: &SafeTensors, name: &str) -> Vec<Point> {
    floats(file, name).as_chunks::<3>().0.to_vec()
}

fn nodes(file: &SafeTensors, name: &str) -> Vec<[i32; 3]> {
    let data = file.tensor(name).unwrap();
    let values: Vec<i32> = data.data().as_chunks().0.iter().map(|b| i32::from_le_bytes(*b)).collect();
    values.as_chunks::<3>().0.to_vec()
}

fn encode(points: &[Point], voxel_size: f64) -> Field {
    let options = EncodeOptions::default().with_voxel_size(Some(Length::Units(voxel_size)));
    model().encode(points, &options).unwrap()
}

#[test]
fn volume_and_fields_equal_pytorch() {
    let bytes = std::fs::read(folder().join("io.safetensors")).unwrap();
    let file = SafeTensors::deserialize(&bytes).unwrap();
    // PyTorch's lattice begins at the origin.
    let lattice = Normalization { center: [0.0; 3], scale: 0.1 };
    let network = model().network().clone();
    let field = Field::normalized(network, points(&file, "points"), lattice, &Control::default()).unwrap();
    let volume = field.volume();
    let Lattice::Blocks(grid, _) = &volume.lattice else { panic!("a scene") };
    let occupied: HashSet<[i32; 3]> = nodes(&file, "scatter_nodes").into_iter().collect();
    let expected = floats(&file, "volume_values");
    // Only nodes beside occupied ones are exact: farther out, the last convolutions lack blocks.
    let is_exact = |node: [i32; 3]| {
        let steps = (0..27).map(|i| [i % 3 - 1, i / 3 % 3 - 1, i / 9 - 1]);
        steps.clone().any(|step| occupied.contains(&std::array::from_fn(|axis| node[axis] + step[axis])))
    };
    for (node, expected) in nodes(&file, "volume_nodes").into_iter().zip(expected.chunks(volume.channels)) {
        let features = &volume.values[grid.node(node) as usize * volume.channels..][..volume.channels];
        // Fourteen layers sum in float32 in another order; values are up to 10.
        let is_close = features.iter().zip(expected).all(|(f, e)| (f - e).abs() < 3e-4);
        assert!(is_close || !is_exact(node), "{node:?} {features:?} {expected:?}");
    }
    let queries = points(&file, "queries");
    let has_exact_nodes = |query: &Point| {
        let low = query.map(|v| (v / 0.1).floor() as i32);
        (0..8).all(|n| is_exact([low[0] + (n & 1), low[1] + (n >> 1 & 1), low[2] + (n >> 2)]))
    };
    assert!(queries.iter().filter(|query| has_exact_nodes(query)).count() > queries.len() / 2);
    for (name, found) in
        [("occupancy", field.occupancy(&queries).unwrap()), ("saliency", field.saliency(&queries).unwrap())]
    {
        for ((query, found), expected) in queries.iter().zip(found).zip(floats(&file, name)) {
            assert!(!has_exact_nodes(query) || (found - expected).abs() < 1e-4, "{name} {query:?} {found} {expected}");
        }
    }
}

/// A room's corner and a post, in steps of 2^-10.
fn room() -> Vec<Point> {
    let step = |i: usize, factor: usize, size: usize| (i * factor % size) as f32 / 1024.0;
    let point = |i: usize| match i % 4 {
        0 => [step(i, 7919, 4096), step(i, 104_729, 3072), 0.0],
        1 => [step(i, 7919, 4096), 0.0, step(i, 15_485_863, 2048)],
        2 => [0.0, step(i, 7919, 3072), step(i, 15_485_863, 2048)],
        _ => [2.0 + step(i, 7919, 256), 1.5 + step(i, 104_729, 256), step(i, 15_485_863, 1536)],
    };
    (0..16_000).map(point).collect()
}

fn detected(points: &[Point], voxel_size: f64) -> Vec<Keypoint> {
    let detect = DetectOptions::default()
        .with_refine_steps(0)
        .with_occupancy_threshold(0.0)
        .with_surface_threshold(0.0)
        .with_saliency_threshold(0.0)
        .with_mode_radius(Some(Length::Voxels(2.0)))
        .with_nms_radius(Some(Length::Voxels(4.0)));
    encode(points, voxel_size).detect(&detect).unwrap().keypoints
}

#[test]
fn a_scene_moved_by_any_part_of_a_voxel_has_the_same_keypoints() {
    let voxel = 0.125;
    let here = detected(&room(), voxel);
    assert!(here.len() > 20);
    // Steps by which no coordinate is rounded.
    for step in [[128, 0, 0], [64, 64, 64], [40, -79, 15], [-2048, 4096 + 51, 1]] {
        let step: Point = step.map(|i| i as f32 / 1024.0);
        let moved = |p: Point| std::array::from_fn(|axis| p[axis] + step[axis]);
        let there = detected(&room().into_iter().map(moved).collect::<Vec<_>>(), voxel);
        assert_eq!(there.len(), here.len());
        for (here, there) in here.iter().zip(&there) {
            // Positions are rounded after the last step.
            assert_eq!((here.saliency, here.nearest_index), (there.saliency, there.nearest_index));
            let back: Point = std::array::from_fn(|axis| there.position[axis] - step[axis]);
            assert!((0..3).all(|axis| (back[axis] - here.position[axis]).abs() < 1e-5), "{here:?} {there:?}");
        }
    }
}

#[test]
fn a_scene_far_from_its_origin_has_the_keypoints_of_the_scene_near_it() {
    let model = Model::builtin(Builtin::Scenes);
    let detect = |offset: [f64; 3]| {
        let positions = room().into_iter().map(|p| std::array::from_fn(|axis| f64::from(p[axis]) + offset[axis]));
        let cloud = Cloud::from_positions(positions.collect::<Vec<[f64; 3]>>().into_iter());
        let mut options = *model.recommended();
        options.detect.min_confidence = None;
        let detection = model.detect(&cloud.points, &options).unwrap();
        let place = |k: &Keypoint| -> [f64; 3] {
            std::array::from_fn(|axis| f64::from(k.position[axis]) + cloud.origin[axis] - offset[axis])
        };
        (detection.keypoints.iter().map(place).collect::<Vec<_>>(), detection.voxel_size.unwrap())
    };
    let (near, voxel_size) = detect([0.0; 3]);
    let (far, same_size) = detect([500_000.37, 5_400_000.11, 203.7]);
    assert_eq!(voxel_size, same_size);
    let half = f64::from(voxel_size) / 2.0;
    let is_kept = |place: &&[f64; 3]| {
        far.iter().any(|other| (0..3).map(|axis| (place[axis] - other[axis]).powi(2)).sum::<f64>() < half * half)
    };
    let kept = near.iter().filter(is_kept).count();
    assert!(near.len() > 20 && kept * 100 >= near.len() * 95, "{kept} of {}", near.len());
}

#[test]
fn blocks_equal_the_whole_box() {
    let model = model();
    let Encoder::Blocks(encoder) = &model.network().encoder else { panic!("a scene") };
    let points: Vec<Point> = room().into_iter().map(|p| p.map(|v| v * 8.0 - 3.7)).collect();
    let volume = |more: &[[i32; 3]]| {
        encoder.encode_also(&points, more, &mut EncoderMemory::default(), &Counter::default()).unwrap()
    };
    let all: Vec<[i32; 3]> = (0..60 * 60 * 60).map(|i| [i % 60 - 14, i / 60 % 60 - 14, i / 3600 - 14]).collect();
    let [sparse, dense] = [volume(&[]), volume(&all)];
    assert!(dense.values.len() > 2 * sparse.values.len());
    let features = |volume: &Volume| {
        let mut features = vec![0.0; points.len() * volume.channels];
        volume.interpolate(&volume.lattice, &points, &mut features);
        features
    };
    // A Winograd tile rounds differently where a voxel at its border is missing.
    for (sparse, dense) in features(&sparse).into_iter().zip(features(&dense)) {
        assert!((sparse - dense).abs() < 1e-4, "{sparse} {dense}");
    }
}

#[test]
fn units_do_not_matter_and_hopeless_sizes_are_refused() {
    let options = |model: &Model| *model.recommended();
    let model = model();
    let mut options = options(&model);
    options.detect = options.detect.with_refine_steps(0).with_saliency_threshold(0.0).with_occupancy_threshold(0.0);
    options.detect = options.detect.with_surface_threshold(0.0).with_nms_radius(Some(Length::Voxels(4.0)));
    // No point lies on the border of a voxel.
    let room: Vec<Point> = room().into_iter().map(|p| p.map(|v| v + 0.000_37)).collect();
    let metres = model.detect(&room, &options).unwrap().keypoints;
    let millimetres: Vec<Point> = room.iter().map(|p| p.map(|v| v * 1000.0)).collect();
    let scaled = model.detect(&millimetres, &options).unwrap().keypoints;
    assert!(metres.len() > 20 && metres.len() == scaled.len());
    for (metres, scaled) in metres.iter().zip(&scaled) {
        assert!((0..3).all(|axis| (scaled.position[axis] / 1000.0 - metres.position[axis]).abs() < 1e-4));
    }
    let refused = |size: Length| {
        let options = EncodeOptions::default().with_voxel_size(Some(size));
        model.encode(&room, &options).unwrap_err().to_string()
    };
    assert!(refused(Length::Units(1e-9)).contains("voxels wide"));
    assert!(refused(Length::Voxels(2.0)).contains("voxel_size"));
    let compact = Model::builtin(Builtin::Compact);
    let given = EncodeOptions::default().with_voxel_size(Some(Length::Units(0.1)));
    assert!(compact.encode(&room, &given).unwrap_err().to_string().contains("scene model"));
    let one_place = model.encode(&[[1.0; 3]; 50], &EncodeOptions::default()).unwrap_err().to_string();
    assert!(one_place.contains("two different points"), "{one_place}");
}

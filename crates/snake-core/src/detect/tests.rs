//! Detection as a whole.

use super::corners::ranks;
use super::localize::Place;
use super::*;
use crate::{Builtin, EncodeOptions, Model, Preference};
use snake_geometry::{Keypoint, Length};

/// A cylinder's points and its field by the built-in model.
pub(crate) fn cylinder() -> (Vec<Point>, Field) {
    let points: Vec<Point> = (0..2000)
        .map(|i| {
            let angle = i as f32 * 0.1;
            [angle.cos(), angle.sin(), (i % 40) as f32 * 0.02]
        })
        .collect();
    let field = Model::builtin(Builtin::Compact).encode(&points, &EncodeOptions::default()).unwrap();
    (points, field)
}

#[test]
fn detections_read_back_from_json() {
    let (points, _) = cylinder();
    let model = Model::builtin(Builtin::Compact);
    let detection = model.detect(&points, model.recommended()).unwrap();
    let text = serde_json::to_string(&detection).unwrap();
    assert_eq!(serde_json::from_str::<Detection>(&text).unwrap(), detection);
    let value: serde_json::Value = serde_json::from_str(&text).unwrap();
    let keys: Vec<&String> = value["keypoints"][0].as_object().unwrap().keys().collect();
    assert_eq!(keys, ["confidence", "covariance", "nearest_index", "occupancy", "saliency", "x", "y", "z"]);
    assert!(value["timing_seconds"]["encode"].as_f64().unwrap() > 0.0);
}

#[test]
fn corners_come_first_where_they_are_preferred() {
    let (points, field) = cylinder();
    let options =
        DetectOptions { nms_radius: Some(0.2.into()), refine_steps: 0, saliency_threshold: 0.0, ..Default::default() };
    let preferring = |prefer| field.detect(&options.with_prefer(prefer)).unwrap().keypoints;
    let corners = preferring(Preference::Corners);
    let places: Vec<Place> = corners.iter().map(|keypoint| Place::unknown(keypoint.position)).collect();
    let ranks = ranks(&field, &places, &corners.iter().map(|k| k.saliency).collect::<Vec<_>>()).unwrap();
    assert!(corners.len() > 5 && ranks.is_sorted_by(|a, b| a >= b), "{ranks:?}");
    assert_ne!(corners, preferring(Preference::Salient));
    let of = |prefer, radius: f64| {
        let options = options.with_prefer(prefer).with_mode_radius(Some(radius.into()));
        options.radii(&points, field.voxel_size(), None).unwrap().mode
    };
    assert_eq!(of(Preference::Corners, 0.4), of(Preference::Salient, 0.2));
}

#[test]
fn modes_of_a_scene_reach_two_voxels_and_farther_where_points_are_sparse() {
    let points: Vec<Point> = (0..400).map(|i| [(i % 20) as f32, (i / 20) as f32, 0.0]).collect();
    let options = DetectOptions::default().with_mode_radius(Some(Length::Resolutions(3.5)));
    let mode = |voxel_size, diagonal| options.radii(&points, voxel_size, diagonal).unwrap().mode;
    for (voxel_size, expected) in [(0.9, 3.5), (1.6, 3.5), (2.0, 4.0), (4.0, 8.0)] {
        assert_eq!([mode(voxel_size, Some(30.0)), mode(voxel_size, None)], [Some(expected), Some(3.5)]);
    }
}

#[test]
fn preferred_corners_of_a_box_are_its_corners_and_no_edges() {
    let sides = [1.0, 0.7, 0.5];
    let golden = |i: usize, k: f64| (i as f64 * k).fract() as f32;
    let on_side = |i: usize| {
        let mut point = [golden(i, 0.819_172_5), golden(i, 0.671_043_6), golden(i, 0.549_700_5)];
        point[i % 3] = (i / 3 % 2) as f32;
        std::array::from_fn(|axis| sides[axis] * point[axis])
    };
    let points: Vec<Point> = (0..8000).map(on_side).collect();
    let model = Model::builtin(Builtin::Compact);
    let mut options = *model.recommended();
    options.detect.prefer = Preference::Corners;
    let keypoints = model.detect(&points, &options).unwrap().keypoints;
    assert!(keypoints.len() <= 10, "{}", keypoints.len());
    for corner in (0..8).map(|i| [0, 1, 2].map(|axis| sides[axis] * (i >> axis & 1) as f32)) {
        let distance = |k: &Keypoint| (0..3).map(|axis| (k.position[axis] - corner[axis]).powi(2)).sum::<f32>().sqrt();
        assert!(keypoints.iter().any(|keypoint| distance(keypoint) < 0.05), "{corner:?}");
    }
}

#[test]
fn points_that_are_not_finite_are_skipped_and_indices_are_those_of_the_whole_cloud() {
    let (clean, _) = cylinder();
    // Each third point is missing.
    let mut whole = Vec::new();
    for pair in clean.chunks(2) {
        whole.extend(pair);
        whole.push([pair[0][0], f32::NAN, f32::INFINITY]);
    }
    let model = Model::builtin(Builtin::Compact);
    for max_points in [None, Some(700)] {
        let mut preset = *model.recommended();
        preset.encode.max_points = max_points;
        let (whole_detection, clean_detection) =
            (model.detect(&whole, &preset).unwrap(), model.detect(&clean, &preset).unwrap());
        assert_eq!((whole_detection.num_skipped, clean_detection.num_skipped), (1000, 0));
        assert!(whole_detection.keypoints.len() > 5);
        let mapped = clean_detection
            .keypoints
            .iter()
            .map(|k| Keypoint { nearest_index: k.nearest_index / 2 * 3 + k.nearest_index % 2, ..*k });
        assert_eq!(whole_detection.keypoints, mapped.collect::<Vec<_>>());
    }
    let error = model.detect(&[[f32::NAN; 3]; 9], model.recommended()).unwrap_err().to_string();
    assert_eq!(error, "points: none of the 9 points is finite");
}

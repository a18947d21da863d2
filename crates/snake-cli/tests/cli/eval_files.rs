//! `snake-cli eval registration` with keypoints and descriptors from files.

use std::path::Path;
use std::process::Output;

use nalgebra::{IsometryMatrix3, Vector3};
use serde_json::Value;
use snake_core::{Control, Point, RigidTransform};
use snake_registration::steps::{Lengths, VoxelCloud};
use snake_registration::{Descriptor, Detector};

use super::eval_registration::{between, fragments, scenes};
use super::{assert_refused, snake, stderr, write_npz};

/// The number of keypoints of a fragment.
const COUNT: usize = 60;

/// Farthest points of a fragment with FPFH, as `eval registration` computes them.
fn described(points: &[Point]) -> (Vec<Point>, Vec<f32>) {
    let size = 0.03;
    let lengths =
        Lengths { voxel_size: size, normal_radius: 2.0 * size, feature_radius: 7.0 * size, inlier_distance: 0.05 };
    let cloud = VoxelCloud::new(points, &lengths, &Control::default()).unwrap();
    let keypoints = cloud.keypoints(Detector::Fps, COUNT, 0, &Control::default()).unwrap();
    let descriptors = cloud.descriptors(&keypoints, Descriptor::Fpfh, &Control::default()).unwrap();
    (keypoints, descriptors)
}

/// Writes the keypoints of a fragment, moved by an offset, in a mixed order, which their scores undo.
fn write(folder: &Path, fragment: usize, keypoints: &[Point], descriptors: Option<&[f32]>, offset: [f64; 3]) {
    let number = keypoints.len();
    let order: Vec<usize> = (0..number).map(|i| i * 7 % number).collect();
    assert!(!number.is_multiple_of(7));
    let mixed: Vec<[f64; 3]> = order.iter().map(|&i| snake_core::add_origin(keypoints[i], offset)).collect();
    let scores: Vec<f64> = order.iter().map(|&i| 1.0 / (1.0 + i as f64)).collect();
    let all = descriptors.unwrap_or_default();
    let length = all.len() / number;
    let rows: Vec<f64> = order.iter().flat_map(|&i| &all[i * length..(i + 1) * length]).map(|&v| v.into()).collect();
    let (point_shape, row_shape) = ([number, 3], [number, length]);
    let mut arrays =
        vec![("keypoints", &point_shape[..], mixed.as_flattened()), ("scores", &point_shape[..1], &scores)];
    arrays.extend(descriptors.map(|_| ("descriptors", &row_shape[..], &rows[..])));
    write_npz(&folder.join(format!("room__{fragment:02}.npz")), &arrays);
}

fn run(data: &Path, words: &[&str]) -> Output {
    let data = data.display().to_string();
    snake(&[&["eval", "registration", &data, "--max-keypoints", "60,20"], words].concat())
}

/// The rows of a report, each as its method and its figures.
fn rows(data: &Path, words: &[&str]) -> Vec<(String, Value)> {
    let results = tempfile::tempdir().unwrap();
    let output = run(data, &[words, &["-o", &results.path().display().to_string()]].concat());
    assert!(output.status.success(), "{}", stderr(&output));
    let report = std::fs::read(results.path().join("registration.json")).unwrap();
    let report: Value = serde_json::from_slice(&report).unwrap();
    let text = |value: &Value| value.as_str().unwrap().to_owned();
    let row = |row: &Value| {
        let name = text(&row["detector"]) + " " + &text(&row["descriptor"]);
        (name, serde_json::json!([row["keypoints"], row["mean"], row["scenes"]]))
    };
    report["rows"].as_array().unwrap().iter().map(row).collect()
}

#[test]
fn fpfh_from_files_has_the_row_of_the_built_in() {
    let data = scenes(&[[0, 1], [0, 2], [1, 3]]);
    let folder = data.path().join("found");
    for (fragment, points) in fragments().iter().enumerate() {
        let (keypoints, descriptors) = described(points);
        write(&folder, fragment, &keypoints, Some(&descriptors), [0.0; 3]);
    }
    let external = format!("mine={}", folder.display());
    let all = rows(data.path(), &["--detectors", "fps", "--descriptors", "fpfh,mine", "--external", &external]);
    let names: Vec<&str> = all.iter().map(|(name, _)| &name[..]).collect();
    let expected = ["fps fpfh", "fps mine", "mine fpfh", "mine mine"].map(|name| [name; 2]);
    assert_eq!(names, expected.as_flattened());
    for row in all.chunks(2) {
        assert_eq!([&row[0].1, &row[1].1], [&all[0].1, &all[1].1], "{}", row[0].0);
    }
    assert!(all[0].1[1]["inlier_ratio"].as_f64().unwrap() > 0.1 && all[0].1 != all[1].1, "{all:?}");
    // Without being named, descriptors of files belong to the keypoints of these files.
    let own = rows(data.path(), &["--detectors", "fps", "--descriptors", "fpfh", "--external", &external]);
    assert_eq!(own, [&all[..2], &all[4..]].concat());
    // Suppression is of the keypoints of files as of others.
    let apart = ["--detectors", "fps", "--descriptors", "fpfh", "--nms-radius", "0.3", "--external", &external];
    let apart = rows(data.path(), &apart);
    assert_eq!(apart[4].1, apart[2].1);
    assert!(apart[4].1[1]["found"].as_f64() < own[2].1[1]["found"].as_f64() && apart[0].1 != own[0].1, "{apart:?}");
}

#[test]
fn files_of_far_clouds_are_in_the_frame_of_the_clouds() {
    let near = scenes(&[[0, 2]]);
    let far = tempfile::tempdir().unwrap();
    let offset = [500_000.0, 5_000_000.0, 100.0];
    let moved: RigidTransform = IsometryMatrix3::new(Vector3::from(offset), Vector3::zeros()).into();
    for (fragment, points) in fragments().iter().enumerate() {
        let path = far.path().join(format!("room__{fragment:02}.ply"));
        snake_io::write_points(&path, points, offset).unwrap();
        let (keypoints, descriptors) = described(points);
        write(&near.path().join("found"), fragment, &keypoints, Some(&descriptors), [0.0; 3]);
        write(&far.path().join("found"), fragment, &keypoints, Some(&descriptors), offset);
    }
    let t = moved * between(0, 2) * moved.inverse();
    let pairs = serde_json::json!([{"source": "room__02", "target": "room__00", "T": t}]);
    std::fs::write(far.path().join("pairs.json"), pairs.to_string()).unwrap();
    let figures = |data: &Path| {
        let external = format!("mine={}", data.join("found").display());
        let rows_of_files = rows(data, &["--detectors", "fps", "--descriptors", "fpfh", "--external", &external]);
        rows_of_files.iter().map(|(_, figures)| figures[1]["inlier_ratio"].as_f64().unwrap()).collect::<Vec<_>>()
    };
    let (near, far) = (figures(near.path()), figures(far.path()));
    // The voxels of a moved cloud are others; what comes from files is the same.
    assert!(near[4..] == far[4..] && near[4] > 0.1, "{near:?} {far:?}");
}

#[test]
fn files_that_cannot_be_used_are_named_with_the_reason() {
    let data = scenes(&[[0, 2]]);
    let folder = data.path().join("found");
    let described = fragments().map(|points| described(&points));
    let external = format!("mine={}", folder.display());
    let refused = |words: &[&str], message: &str| {
        assert_refused(&run(data.path(), &[&["--detectors", "fps"], words].concat()), message);
    };
    let with = ["--descriptors", "fpfh", "--external", &external];
    refused(&with, "room__02.npz");
    refused(&["--descriptors", "fpfh,shot", "--external", &external], "names shot: allowed is field, fpfh, mine");
    refused(&["--external", &external, "--external", &external], "name mine twice");
    refused(&["--descriptors", "fpfh,fpfh"], "name fpfh twice");
    refused(&["--external", "fpfh=x"], "fpfh is a method of its own");
    for fragment in [0, 2] {
        write(&folder, fragment, &described[fragment].0, None, [0.0; 3]);
    }
    refused(&["--descriptors", "mine", "--external", &external], "--external mine: no `descriptors` in the file");
    // One cloud with descriptors and one without, then of other lengths.
    write(&folder, 2, &described[2].0, Some(&described[2].1), [0.0; 3]);
    refused(&with, "no `descriptors` in the file");
    write(&folder, 0, &described[0].0, Some(&described[0].1[..COUNT * 10]), [0.0; 3]);
    refused(&with, "descriptors of 33 numbers and of 10");
    let npz = folder.join("room__00.npz");
    let points: Vec<f64> = described[0].0.as_flattened().iter().map(|&v| v.into()).collect();
    let points = &points[..];
    for (arrays, message) in [
        (vec![("points", &[COUNT, 3][..], points)], "`keypoints`: not in the file"),
        (vec![("keypoints", &[COUNT * 3], points)], "needed is (K, 3)"),
        (
            vec![("keypoints", &[COUNT, 3], points), ("scores", &[COUNT, 1], &points[..COUNT])],
            "scores have the shape [60, 1]",
        ),
        (
            vec![("keypoints", &[COUNT, 3], points), ("descriptors", &[COUNT], &points[..COUNT])],
            "descriptors have the shape [60]",
        ),
        (vec![("keypoints", &[1, 3], &[0.0, f64::NAN, 0.0])], "not finite"),
    ] {
        write_npz(&npz, &arrays);
        refused(&with, message);
    }
    // A cloud without keypoints has no matches, which is no error.
    for fragment in [0, 2] {
        let npz = folder.join(format!("room__{fragment:02}.npz"));
        write_npz(&npz, &[("keypoints", &[0, 3], &[]), ("descriptors", &[0, 33], &[])]);
        let none = rows(data.path(), &[&["--detectors", "fps"], &with[..]].concat());
        assert!(none.len() == 6 && none[5].0 == "mine mine" && none[5].1[1]["correspondences"] == 0.0, "{none:?}");
    }
}

#[test]
fn the_preset_has_the_papers_values() {
    let data = scenes(&[[0, 2]]);
    let folder = data.path().join("found");
    for (fragment, points) in fragments().iter().enumerate() {
        write(&folder, fragment, &described(points).0, None, [0.0; 3]);
    }
    let external = format!("mine={}", folder.display());
    let settings = |words: &[&str]| -> (Value, Vec<(String, Value)>) {
        let results = tempfile::tempdir().unwrap();
        let output = ["--detectors", "snake,fps", "--descriptors", "fpfh", "-o", &results.path().display().to_string()];
        let output = run(data.path(), &[&output[..], words, &["--external", &external]].concat());
        assert!(output.status.success(), "{}", stderr(&output));
        let report = std::fs::read(results.path().join("registration.json")).unwrap();
        let report: Value = serde_json::from_slice(&report).unwrap();
        let counts = |row: &Value| (row["detector"].to_string(), row["mean"]["found"].clone());
        (
            report["settings"]["models"][0]["options"].clone(),
            report["rows"].as_array().unwrap().iter().map(counts).collect(),
        )
    };
    let (own, paper) = (settings(&[]), settings(&["--preset", "3dmatch"]));
    let detect = |(options, _): &(Value, _), name: &str| options["detect"][name].clone();
    assert_eq!((detect(&own, "saliency_threshold"), detect(&own, "nms_radius")), (0.0.into(), 0.03.into()));
    let values = ["saliency_threshold", "nms_radius", "refine_steps", "snap"].map(|name| detect(&paper, name));
    assert!((values[0].as_f64().unwrap() - 0.4).abs() < 1e-6, "{values:?}");
    assert_eq!(values[1..], [Value::from(0.05), 10.into(), true.into()]);
    assert_eq!(paper.0["encode"]["max_points"], Value::Null);
    // The options are those that detect: fewer keypoints that are farther apart, and none above a threshold that no saliency reaches.
    let sparse = settings(&["--preset", "3dmatch", "--set", "nms_radius=0.4"]);
    assert!(sparse.1[0].1.as_f64() < paper.1[0].1.as_f64(), "{:?} {:?}", sparse.1, paper.1);
    assert_eq!(settings(&["--set", "saliency_threshold=1"]).1[0].1, 0.0);
    let given = settings(&["--preset", "3dmatch", "--set", "nms_radius=0.2"]);
    assert_eq!(detect(&given, "nms_radius"), 0.2);
    // Keypoints of files are as far apart as the paper's, those of other detectors are not suppressed.
    let wide = settings(&["--preset", "3dmatch", "--nms-radius", "0.4"]);
    assert_eq!(detect(&wide, "nms_radius"), 0.4);
    assert!(wide.1[2].1.as_f64() < paper.1[2].1.as_f64(), "{:?}", wide.1);
}

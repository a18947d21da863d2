//! The command line as a person uses it.

use std::path::{Path, PathBuf};
use std::process::Output;

use assert_cmd::Command;
use serde_json::Value;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

fn sample() -> String {
    root().join("samples/plane.ply").display().to_string()
}

fn snake(arguments: &[&str]) -> Output {
    Command::cargo_bin("snake-cli").unwrap().args(arguments).output().unwrap()
}

fn json_lines(output: &Output) -> Vec<Value> {
    String::from_utf8_lossy(&output.stdout).lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into()
}

#[test]
fn keypoints_of_the_sample_lie_on_it() {
    let output = snake(&["detect", &sample(), "--json"]);
    assert!(output.status.success(), "{}", stderr(&output));
    let report = &json_lines(&output)[0];
    assert_eq!(report["num_points"], 4096);
    let scale = report["normalization"]["scale"].as_f64().unwrap();
    assert!(scale > 0.0 && report["normalization"]["center"].as_array().unwrap().len() == 3);
    for step in ["read", "encode", "occupancy", "refine", "nms", "total"] {
        assert!(report["timing_seconds"][step].as_f64().unwrap() >= 0.0, "{step}");
    }
    let count = |name: &str| report["counts"][name].as_u64().unwrap();
    assert_eq!(count("queries"), 64 * 64 * 64);
    assert!(count("queries") > count("occupied") && count("occupied") > count("above_threshold"));

    let points = snake_core::io::read_points(Path::new(&sample())).unwrap();
    let keypoints = report["keypoints"].as_array().unwrap();
    assert_eq!(keypoints.len() as u64, count("keypoints"));
    assert!(keypoints.len() >= 10);
    let mut last = 1.0;
    for keypoint in keypoints {
        let number = |key: &str| keypoint[key].as_f64().unwrap();
        let nearest = points[keypoint["nearest_index"].as_u64().unwrap() as usize];
        let axes = ["x", "y", "z"].map(number);
        let distance = (0..3).map(|axis| (axes[axis] - f64::from(nearest[axis])).powi(2)).sum::<f64>().sqrt();
        // Two voxels of the 32³ volume, each 0.035 of the cloud's scale.
        assert!(distance < 0.07 * scale, "{keypoint} is {distance} from the cloud");
        assert!(number("saliency") <= last && number("occupancy") > 0.8);
        last = number("saliency");
    }
}

#[test]
fn options_reach_the_detector() {
    let count = |extra: &[&str], name: &str| {
        let output = snake(&[&["detect", &sample(), "--json"], extra].concat());
        assert!(output.status.success(), "{}", stderr(&output));
        json_lines(&output)[0]["counts"][name].as_u64().unwrap()
    };
    assert_eq!(count(&["--query-resolution", "20"], "queries"), 8000);
    assert_eq!(count(&["--max-keypoints", "5"], "keypoints"), 5);
    assert!(count(&["--nms-radius", "0.5"], "keypoints") < 10);
    assert_eq!(count(&["--saliency-threshold", "1"], "keypoints"), 0);
    assert_eq!(count(&["--occupancy-threshold", "1"], "occupied"), 0);
    assert_eq!(count(&["--preset", "redwood"], "queries"), 1_000_000);
    let snapped = snake(&["detect", &sample(), "--json", "--snap", "--max-keypoints", "3"]);
    let points = snake_core::io::read_points(Path::new(&sample())).unwrap();
    for keypoint in json_lines(&snapped)[0]["keypoints"].as_array().unwrap() {
        let nearest = points[keypoint["nearest_index"].as_u64().unwrap() as usize];
        assert_eq!(keypoint["x"].as_f64().unwrap() as f32, nearest[0]);
    }
}

#[test]
fn every_output_format_holds_the_keypoints() {
    let folder = tempfile::tempdir().unwrap();
    for (name, is_cloud) in [("k.ply", true), ("k.npy", true), ("k.csv", true), ("k.json", false)] {
        let path = folder.path().join(name);
        let output = snake(&["detect", &sample(), "--max-keypoints", "7", "-o", path.to_str().unwrap()]);
        assert!(output.status.success(), "{}", stderr(&output));
        if is_cloud {
            assert_eq!(snake_core::io::read_points(&path).unwrap().len(), 7, "{name}");
        } else {
            let value: Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
            assert_eq!(value["keypoints"].as_array().unwrap().len(), 7);
        }
    }
    assert_eq!(folder.path().read_dir().unwrap().count(), 4, "no temporary file is left");
}

#[test]
fn one_bad_file_does_not_stop_the_rest() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::copy(sample(), folder.path().join("b.ply")).unwrap();
    std::fs::copy(sample(), folder.path().join("c.ply")).unwrap();
    std::fs::write(folder.path().join("a.xyz"), "1 2 3\n1 2 potato\n").unwrap();
    std::fs::write(folder.path().join("notes.md"), "not a cloud").unwrap();
    let results = folder.path().join("results");
    let (input, out) = (folder.path().to_str().unwrap(), results.to_str().unwrap());
    let output = snake(&["detect", input, "-o", out, "--format", "csv", "--json"]);
    assert_eq!(output.status.code(), Some(1));
    assert!(
        stderr(&output).contains("potato") && stderr(&output).contains("1 of 3 inputs failed"),
        "{}",
        stderr(&output)
    );
    assert_eq!(json_lines(&output).len(), 2);
    let mut written: Vec<_> =
        results.read_dir().unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    written.sort();
    assert_eq!(written, ["b.keypoints.csv", "c.keypoints.csv"]);
}

#[test]
fn mistakes_get_one_line_that_says_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str, content: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, content).unwrap();
        path.display().to_string()
    };
    let (one, same) = (file("one.xyz", "1 2 3\n"), file("same.xyz", &"1 2 3\n".repeat(9)));
    let (nan, empty, weights) =
        (file("nan.xyz", "1 2 3\nnan 0 0\n"), file("empty.xyz", ""), file("w.safetensors", "junk"));
    let two = file("two.xyz", "0 0 0\n1 0 0\n");
    let nothing = folder.path().join("none").display().to_string();
    let cases: &[(&[&str], &str)] = &[
        (&["detect", "nowhere.ply"], "nowhere.ply"),
        (&["detect", &one], "at least two different points"),
        (&["detect", &same], "at least two different points"),
        (&["detect", &nan], "not finite"),
        (&["detect", &empty], "no points"),
        (&["detect", &weights], "extension"),
        (&["detect", &sample(), "-o", "k.docx"], "k.docx"),
        (&["detect", &sample(), "-o", &sample()], "is the input"),
        (&["detect", &sample(), "--model", &weights], "safetensors"),
        (&["detect", &sample(), "--preset", "kitti"], "modelnet40"),
        (&["detect", &sample(), "--refine-method", "newton"], "gradient-descent"),
        (&["detect", &sample(), "--query-resolution", "0"], "1 to 1024"),
        (&["detect", &sample(), "--saliency-threshold", "nan"], "0 to 1"),
        (&["detect", &sample(), "--nms-radius", "inf"], "0 or more"),
        (&["detect", &sample(), "--max-points", "0"], "1 or more"),
        (&["detect", &nothing], "none"),
        (&["register", &sample()], "<TARGET>"),
        (&["register", "nowhere.ply", &sample()], "nowhere.ply"),
        (&["register", &sample(), &one], "at least two different points"),
        (&["register", &same, &sample()], "at least two different points"),
        (&["register", &nan, &sample()], "source: 1 of 2 points are not finite"),
        (&["register", &sample(), &empty], "target: no points"),
        (&["register", &two, &two], "do the clouds overlap"),
        (&["register", &sample(), &sample(), "-o", "t.ply"], ".json, .txt"),
        (&["register", &sample(), &sample(), "--aligned", "a.csv"], ".ply"),
        (&["register", &sample(), &sample(), "--aligned", &sample()], "is an input"),
        (&["register", &sample(), &sample(), "--model", &weights], "safetensors"),
        (&["register", &sample(), &sample(), "--descriptor", "shot"], "fpfh"),
        (&["register", &sample(), &sample(), "--voxel-size", "0"], "voxel_size"),
        (&["register", &sample(), &sample(), "--inlier-distance", "nan"], "inlier_distance"),
        (&["model", &weights], "safetensors"),
    ];
    for (arguments, expected) in cases {
        let output = snake(arguments);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}");
        assert!(stderr(&output).contains(expected), "{arguments:?}: {}", stderr(&output));
        assert!(!stderr(&output).contains("panicked"), "{arguments:?}: {}", stderr(&output));
    }
}

#[test]
fn the_same_bits_for_any_number_of_threads() {
    let keypoints = |threads: &str| {
        let output = snake(&["detect", &sample(), "--json", "--threads", threads]);
        assert!(output.status.success(), "{}", stderr(&output));
        json_lines(&output)[0]["keypoints"].to_string()
    };
    let one = keypoints("1");
    assert!(one.len() > 1000);
    assert_eq!(one, keypoints("2"));
    assert_eq!(one, keypoints("7"));
}

#[test]
fn sub_sampling_is_seeded_and_said() {
    let report = |seed: &str| {
        let output = snake(&["detect", &sample(), "--json", "--max-points", "1500", "--seed", seed]);
        json_lines(&output)[0]["keypoints"].to_string()
    };
    assert_eq!(report("1"), report("1"));
    assert_ne!(report("1"), report("2"));
    let output = snake(&["detect", &sample(), "--max-points", "1500"]);
    assert!(String::from_utf8_lossy(&output.stdout).contains("(1500 encoded)"));
}

/// The sample, turned by a quarter about z and moved by (3, 0, -1), as a file; every second point of it.
fn turned_sample(folder: &Path) -> String {
    let points = snake_core::io::read_points(Path::new(&sample())).unwrap();
    let turned: Vec<_> = points.iter().step_by(2).map(|p| [3.0 - p[1], p[0], p[2] - 1.0]).collect();
    let path = folder.join("turned.ply");
    snake_core::io::write_points(&path, &turned).unwrap();
    path.display().to_string()
}

#[test]
fn register_prints_and_writes_the_transform() {
    let folder = tempfile::tempdir().unwrap();
    let turned = turned_sample(folder.path());
    let file = |name: &str| folder.path().join(name).display().to_string();
    let (text, aligned, json) = (file("t.txt"), file("aligned.ply"), file("t.json"));
    let output = snake(&["register", &sample(), &turned, "--json", "-o", &text, "--aligned", &aligned]);
    assert!(output.status.success(), "{}", stderr(&output));
    let report = &json_lines(&output)[0];
    let keys: Vec<&String> = report.as_object().unwrap().keys().collect();
    assert_eq!(keys, ["num_correspondences", "num_inliers", "rmse", "seconds", "t_target_source"]);
    let (inliers, all) = (report["num_inliers"].as_u64().unwrap(), report["num_correspondences"].as_u64().unwrap());
    assert!(3 <= inliers && inliers <= all && report["rmse"].as_f64().unwrap() < 0.1);

    let rows: Vec<Vec<f64>> = serde_json::from_value(report["t_target_source"].clone()).unwrap();
    let expected = [[0.0, -1.0, 0.0, 3.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, -1.0], [0.0, 0.0, 0.0, 1.0]];
    for (row, expected) in rows.iter().flatten().zip(expected.iter().flatten()) {
        assert!((row - expected).abs() < 0.03, "{rows:?}");
    }
    let written = std::fs::read_to_string(&text).unwrap();
    assert_eq!(written.lines().count(), 4);
    for (line, row) in written.lines().zip(&rows) {
        let numbers: Vec<f64> = line.split(' ').map(|v| v.parse().unwrap()).collect();
        // serde_json may be off by the last bit.
        assert!(numbers.len() == 4 && numbers.iter().zip(row).all(|(a, b)| (a - b).abs() < 1e-12), "{line}");
    }
    let points = snake_core::io::read_points(Path::new(&sample())).unwrap();
    let moved = snake_core::io::read_points(Path::new(&aligned)).unwrap();
    assert_eq!(moved.len(), points.len());
    for (p, q) in points.iter().zip(&moved) {
        let truth = [3.0 - p[1], p[0], p[2] - 1.0];
        assert!((0..3).all(|axis| (q[axis] - truth[axis]).abs() < 0.05), "{p:?} {q:?}");
    }

    let output = snake(&["register", &sample(), &turned, "-o", &json, "--max-keypoints", "400", "--refine-steps", "5"]);
    let printed = String::from_utf8_lossy(&output.stdout).into_owned();
    let report: Value = serde_json::from_slice(&std::fs::read(&json).unwrap()).unwrap();
    assert!(printed.contains("t_target_source") && printed.contains(&json), "{printed}");
    assert!(printed.contains(&format!("of {} correspondences", report["num_correspondences"])), "{printed}");
    assert!(report["num_correspondences"].as_u64().unwrap() < all.min(400));
}

#[test]
fn register_does_not_depend_on_threads_but_on_its_options() {
    let folder = tempfile::tempdir().unwrap();
    let turned = turned_sample(folder.path());
    let report = |extra: &[&str]| {
        let output = snake(&[&["register", &sample(), &turned, "--json", "--max-keypoints", "300"], extra].concat());
        assert!(output.status.success(), "{}", stderr(&output));
        let mut report = json_lines(&output).remove(0);
        report["seconds"] = Value::Null;
        report
    };
    let one = report(&["--threads", "1"]);
    assert_eq!(one, report(&["--threads", "2"]));
    assert_eq!(one, report(&["--threads", "5"]));
    for extra in [
        ["--descriptor", "field"],
        ["--voxel-size", "0.1"],
        ["--normal-radius", "0.2"],
        ["--feature-radius", "0.5"],
        ["--inlier-distance", "0.2"],
        ["--refine-steps", "0"],
    ] {
        assert_ne!(one, report(&extra), "{extra:?}");
    }
}

#[test]
fn the_model_command_shows_shape_and_metadata() {
    let output = snake(&["model"]);
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(text.contains("343874 parameters") && text.contains("32 x 32 x 32") && text.contains("digest"), "{text}");
}

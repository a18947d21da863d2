//! The command line as a person uses it.

use std::path::{Path, PathBuf};
use std::process::Output;

use assert_cmd::Command;
use nalgebra::{IsometryMatrix3, Vector3};
use serde_json::Value;
use snake_core::RigidTransform;
use tempfile::TempDir;

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

    let points = snake_io::read_points(Path::new(&sample())).unwrap();
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
fn timing_goes_to_stderr_and_leaves_stdout_alone() {
    let rows = |output: &Output| -> Vec<(String, Vec<f64>)> {
        let text = stderr(output);
        let cells = |line: &str| line[10..].split_whitespace().map(|cell| cell.parse().unwrap()).collect();
        let stages = text.lines().skip_while(|line| !line.starts_with("load model"));
        stages.map(|line| (line[..10].trim().to_owned(), cells(line))).collect()
    };
    let one = snake(&["detect", &sample(), "--json", "--timing"]);
    let timing = &json_lines(&one)[0]["timing_seconds"];
    let found = rows(&one);
    let names: Vec<&str> = found.iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(names, ["load model", "read", "encode", "occupancy", "refine", "nms", "total"]);
    for (name, cells) in &found[1..] {
        assert_eq!(cells.len(), 1);
        assert!((cells[0] - timing[name].as_f64().unwrap()).abs() <= 5.1e-5, "{name}");
    }

    let several = snake(&["detect", &sample(), &sample(), "nowhere.ply", "--json", "--timing"]);
    assert!(stderr(&several).contains("seconds over 2 clouds"), "{}", stderr(&several));
    assert_eq!(json_lines(&several).len(), 2);
    for (name, cells) in &rows(&several)[1..] {
        assert!(cells.len() == 3 && cells[0] <= cells[1] && cells[1] <= cells[2] + 5e-5, "{name}: {cells:?}");
    }
    assert_eq!(stderr(&snake(&["detect", &sample()])), "", "only where asked for");
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
    let points = snake_io::read_points(Path::new(&sample())).unwrap();
    for keypoint in json_lines(&snapped)[0]["keypoints"].as_array().unwrap() {
        let nearest = points[keypoint["nearest_index"].as_u64().unwrap() as usize];
        assert_eq!(keypoint["x"].as_f64().unwrap() as f32, nearest[0]);
    }
}

#[test]
fn every_output_format_holds_the_keypoints() {
    let folder = tempfile::tempdir().unwrap();
    for (name, is_cloud) in [("k.ply", true), ("k.pcd", true), ("k.npy", true), ("k.csv", true), ("k.json", false)] {
        let path = folder.path().join(name);
        let output = snake(&["detect", &sample(), "--max-keypoints", "7", "-o", path.to_str().unwrap()]);
        assert!(output.status.success(), "{}", stderr(&output));
        if is_cloud {
            assert_eq!(snake_io::read_points(&path).unwrap().len(), 7, "{name}");
        } else {
            let value: Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
            assert_eq!(value["keypoints"].as_array().unwrap().len(), 7);
        }
    }
    assert_eq!(folder.path().read_dir().unwrap().count(), 5, "no temporary file is left");
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
        (file("nan.xyz", "nan nan nan\nnan 0 0\n"), file("empty.xyz", ""), file("w.safetensors", "junk"));
    let two = file("two.xyz", "0 0 0\n1 0 0\n");
    let nothing = folder.path().join("none").display().to_string();
    let cases: &[(&[&str], &str)] = &[
        (&["detect", "nowhere.ply"], "nowhere.ply"),
        (&["detect", &one], "at least two different"),
        (&["detect", &same], "at least two different"),
        (&["detect", &nan], "none of the 2 points is finite"),
        (&["detect", &file("far.xyz", "0 0 0\n1e38 0 0\n")], "allowed is 1e-15 to 1e15"),
        (&["detect", &sample(), "--sample", "100", "--input-format", "xyz"], "--columns x,y,z"),
        (&["detect", &same, "--sample", "100"], "no faces"),
        (&["detect", &sample(), "--sample", "0"], "1..=100000000"),
        (&["detect", &sample(), "--input-format", "doc"], "known are ply"),
        (&["detect", &sample(), &sample(), "-o", "-"], "one input"),
        (&["detect", "-", "-"], "only one of the inputs"),
        (&["detect", "-"], "give --input-format"),
        (&["register", "-", "-"], "only one of the inputs"),
        (&["detect", &empty], "no points"),
        (&["detect", &weights], "extension"),
        (&["detect", &sample(), "-o", "k.docx"], "k.docx"),
        (&["detect", &sample(), "-o", &sample()], "is an input"),
        (&["detect", &sample(), "--model", &weights], "safetensors"),
        (&["detect", &sample(), "--preset", "kitti"], "modelnet40"),
        (&["detect", &sample(), "--refine-method", "newton"], "gradient-descent"),
        (&["detect", &sample(), "--query-resolution", "0"], "1 to 256"),
        (&["detect", &sample(), "--query-resolution", "1024"], "1 to 256"),
        (&["detect", &sample(), "--refine-steps", "10000"], "(refine_steps + 1) × rotations up to"),
        (
            &["detect", &sample(), "--refine-steps", "100", "--rotations", "64"],
            "64, with 100 refine_steps and 64 rotations",
        ),
        (&["detect", &sample(), "--threads", "65535"], "--threads is 65535: allowed is 1 to"),
        (&["detect", &sample(), "--saliency-threshold", "nan"], "0 to 1"),
        (&["detect", &sample(), "--nms-radius", "inf"], "0 or more"),
        (&["detect", &sample(), "--max-points", "0"], "1 or more"),
        (&["detect", &nothing], "none"),
        (&["register", &sample()], "<TARGET>"),
        (&["register", "nowhere.ply", &sample()], "nowhere.ply"),
        (&["register", &sample(), &one], "at least two different"),
        (&["register", &same, &sample()], "at least two different"),
        (&["register", &nan, &sample()], "source: none of the 2 points is finite"),
        (&["register", &sample(), &empty], "target: no points"),
        (&["register", &two, &two], "do the clouds overlap"),
        (&["register", &sample(), &sample(), "-o", "t.ply"], ".json, .txt"),
        (&["register", &sample(), &sample(), "--aligned", "a.txt"], ".ply"),
        (&["register", &sample(), &sample(), "--aligned", &sample()], "is an input"),
        (&["register", &sample(), &sample(), "--model", &weights], "safetensors"),
        (&["register", &sample(), &sample(), "--descriptor", "shot"], "fpfh"),
        (&["register", &sample(), &sample(), "--detector", "orb"], "harris3d"),
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
    let output = snake(&["detect", &sample(), "--max-points", "1500", "--json"]);
    assert_eq!(
        (&json_lines(&output)[0]["num_encoded"], &json_lines(&output)[0]["num_points"]),
        (&1500.into(), &4096.into())
    );
}

#[test]
fn a_cloud_may_be_seen_through_windows() {
    let whole = json_lines(&snake(&["detect", &sample(), "--json"])).remove(0);
    let radius = (whole["normalization"]["scale"].as_f64().unwrap() / 4.0).to_string();
    let options = ["detect", &sample(), "--window-radius", &radius, "--saliency-threshold", "0.2"];
    let report = json_lines(&snake(&[&options[..], &["--json"]].concat())).remove(0);
    let windows = report["counts"]["windows"].as_u64().unwrap();
    assert!(windows > 3 && report["normalization"].is_null());
    assert_eq!((&whole["counts"]["windows"], &report["num_encoded"]), (&1.into(), &4096.into()));
    assert_eq!(report["keypoints"].as_array().unwrap().len() as u64, report["counts"]["keypoints"]);
    assert!(report["counts"]["keypoints"].as_u64().unwrap() > 10);
    let table = String::from_utf8(snake(&options).stdout).unwrap();
    assert!(table.contains(&format!("from 4096 points through {windows} windows in ")), "{table}");
    for wrong in ["0", "1e-60", "1e60", "0r"] {
        let refused = snake(&["detect", &sample(), "--window-radius", wrong]);
        assert_eq!(refused.status.code(), Some(2));
        assert!(stderr(&refused).contains("window_radius"), "{}", stderr(&refused));
    }
}

/// 60 MB of coordinates: the file and the cloud are 120 MB, the cloud, a copy and the points by voxels 160 MB, and each
/// thread reserves 64 MB.
#[cfg(unix)]
#[test]
fn five_million_points_take_memory_in_proportion() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("large.npy");
    let values: Vec<f32> = (0..15_000_000_u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 8) as f32 / 1e7).collect();
    write_npy(&path, &[5_000_000, 3], &values);
    let program = Command::cargo_bin("snake-cli").unwrap();
    let output = Command::new("sh")
        .args(["-c", "ulimit -v 600000; exec \"$0\" detect \"$1\" --json --threads 2"])
        .args([program.get_program(), path.as_os_str()])
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    let report = &json_lines(&output)[0];
    assert_eq!((&report["num_points"], &report["num_encoded"]), (&5_000_000.into(), &5_000_000.into()));
}

#[test]
fn a_pipe_carries_only_the_keypoints() {
    let bytes = std::fs::read(sample()).unwrap();
    let run = |extra: &[&str], stdin: &[u8]| {
        let arguments = [&["detect", "-", "-o", "-"], extra].concat();
        Command::cargo_bin("snake-cli").unwrap().args(arguments).write_stdin(stdin.to_vec()).output().unwrap()
    };
    let output = run(&[], &bytes);
    assert!(output.status.success(), "{}", stderr(&output));
    assert!(output.stdout.starts_with(b"ply\nformat binary_little_endian"));
    assert!(stderr(&output).starts_with("-: ") && stderr(&output).contains("keypoints from 4096 points"));
    // The same as from a file to a file, and of text once it is named.
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("k.csv");
    assert!(snake(&["detect", &sample(), "-o", path.to_str().unwrap()]).status.success());
    let csv = std::fs::read(&path).unwrap();
    assert_eq!(run(&["--format", "csv", "--json"], &bytes).stdout, csv);
    let points = snake_io::read_points(Path::new(&sample())).unwrap();
    let text: String = points.iter().map(|[x, y, z]| format!("{x} {y} {z}\n")).collect();
    assert_eq!(run(&["--format", "csv", "--input-format", "xyz"], text.as_bytes()).stdout, csv);
    assert_eq!(run(&[], text.as_bytes()).status.code(), Some(2));
}

#[test]
fn points_that_are_not_finite_are_skipped_and_counted() {
    let folder = tempfile::tempdir().unwrap();
    let points = snake_io::read_points(Path::new(&sample())).unwrap();
    let text: String = points.iter().map(|[x, y, z]| format!("nan nan nan\n{x} {y} {z}\n")).collect();
    let path = folder.path().join("organized.xyz");
    std::fs::write(&path, text).unwrap();
    let path = path.display().to_string();
    let (clean, with_nan) = (snake(&["detect", &sample(), "--json"]), snake(&["detect", &path, "--json"]));
    let (clean, with_nan) = (&json_lines(&clean)[0], &json_lines(&with_nan)[0]);
    assert_eq!((&with_nan["num_points"], &with_nan["num_skipped"]), (&8192.into(), &4096.into()));
    assert_eq!(clean["num_skipped"], 0);
    let pairs = clean["keypoints"].as_array().unwrap().iter().zip(with_nan["keypoints"].as_array().unwrap());
    for (clean, with_nan) in pairs {
        assert_eq!((&clean["x"], &clean["saliency"]), (&with_nan["x"], &with_nan["saliency"]));
        let index = |keypoint: &Value| keypoint["nearest_index"].as_u64().unwrap();
        assert_eq!(index(with_nan), 2 * index(clean) + 1);
    }
    assert!(
        String::from_utf8_lossy(&snake(&["detect", &path]).stdout)
            .contains("from 8192 points (4096 not finite, skipped)")
    );
    let output = snake(&["register", &path, &sample(), "--max-keypoints", "300"]);
    assert!(
        String::from_utf8_lossy(&output.stdout).contains("skipped 4096 points of the source"),
        "{}",
        stderr(&output)
    );
}

#[test]
fn georeferenced_clouds_keep_their_digits() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name).display().to_string();
    let points = snake_io::read_points(Path::new(&sample())).unwrap();
    let far = [691_000.0, 5_336_000.0, 512.0];
    snake_io::write_points(Path::new(&file("far.pcd")), &points, far).unwrap();
    let report = |input: &str| json_lines(&snake(&["detect", input, "--json"])).remove(0);
    let (near, found) = (report(&sample()), report(&file("far.pcd")));
    let best = |report: &Value| ["x", "y", "z"].map(|axis| report["keypoints"][0][axis].as_f64().unwrap());
    assert!(found["origin"][1].as_f64().unwrap() > 5e6 && near["origin"][1] == 0.0);
    assert_eq!(near["keypoints"].as_array().unwrap().len(), found["keypoints"].as_array().unwrap().len());
    for ((near, found), far) in best(&near).into_iter().zip(best(&found)).zip(far) {
        assert!((near + far - found).abs() < 1e-3, "{near} {found}");
    }
    let (transform, aligned) = (file("t.json"), file("aligned.csv"));
    let output = snake(&["register", &sample(), &file("far.pcd"), "-o", &transform, "--aligned", &aligned]);
    assert!(output.status.success(), "{}", stderr(&output));
    let value: Value = serde_json::from_slice(&std::fs::read(&transform).unwrap()).unwrap();
    for (axis, far) in far.into_iter().enumerate() {
        assert!((value["t_target_source"][axis][3].as_f64().unwrap() - far).abs() < 0.01, "{value}");
    }
    let moved = snake_io::read_cloud(Path::new(&aligned), &Default::default()).unwrap();
    for axis in 0..3 {
        let found = f64::from(moved.points[7][axis]) + moved.origin[axis];
        assert!((found - f64::from(points[7][axis]) - far[axis]).abs() < 0.01, "{found}");
    }
}

#[test]
fn meshes_are_sampled_and_keypointnet_is_written() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("02691156")).unwrap();
    let (mesh, marks) = (folder.path().join("02691156/cube.off"), folder.path().join("cube.keypointnet.json"));
    let corners: String = (0..8).map(|i| format!("{} {} {}\n", i & 1, i >> 1 & 1, i >> 2)).collect();
    let faces = "4 0 1 3 2\n4 4 5 7 6\n4 0 1 5 4\n4 2 3 7 6\n4 0 2 6 4\n4 1 3 7 5\n";
    std::fs::write(&mesh, format!("OFF\n8 6 12\n{corners}{faces}")).unwrap();
    let (mesh, marks) = (mesh.display().to_string(), marks.display().to_string());
    let run = |extra: &[&str]| {
        let output = snake(&[&["detect", &mesh, "--json", "--max-keypoints", "8"], extra].concat());
        assert!(output.status.success(), "{}", stderr(&output));
        json_lines(&output).remove(0)
    };
    assert_eq!(run(&[])["num_points"], 8);
    let report = run(&["--sample", "4000", "-o", &marks]);
    assert_eq!(report["num_points"], 4000);
    assert_ne!(report["keypoints"], run(&["--sample", "4000", "--seed", "3"])["keypoints"]);
    let shapes: Value = serde_json::from_slice(&std::fs::read(&marks).unwrap()).unwrap();
    assert_eq!((&shapes[0]["class_id"], &shapes[0]["model_id"]), (&"02691156".into(), &"cube".into()));
    for (marked, keypoint) in
        shapes[0]["keypoints"].as_array().unwrap().iter().zip(report["keypoints"].as_array().unwrap())
    {
        assert_eq!(marked["pcd_info"]["point_index"], keypoint["nearest_index"]);
    }
    assert!(!shapes[0]["keypoints"].as_array().unwrap().is_empty());
}

/// The sample, turned by a quarter about z and moved by (3, 0, -1), as a file; every second point of it.
fn turned_sample(folder: &Path) -> String {
    let points = snake_io::read_points(Path::new(&sample())).unwrap();
    let turned: Vec<_> = points.iter().step_by(2).map(|p| [3.0 - p[1], p[0], p[2] - 1.0]).collect();
    let path = folder.join("turned.ply");
    snake_io::write_points(&path, &turned, [0.0; 3]).unwrap();
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
    let of_ransac = ["inlier_distance", "num_correspondences", "num_inliers"];
    let expected =
        [&["fitness", "fitness_rmse"], &of_ransac[..], &["num_skipped", "rmse", "seconds", "t_target_source"]];
    assert_eq!(keys, expected.concat());
    let number = |key: &str| report[key].as_f64().unwrap();
    assert!(number("fitness") > 0.95 && number("fitness_rmse") < 0.03 && number("inlier_distance") > 0.02, "{report}");
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
    let points = snake_io::read_points(Path::new(&sample())).unwrap();
    let moved = snake_io::read_points(Path::new(&aligned)).unwrap();
    assert_eq!(moved.len(), points.len());
    for (p, q) in points.iter().zip(&moved) {
        let truth = [3.0 - p[1], p[0], p[2] - 1.0];
        assert!((0..3).all(|axis| (q[axis] - truth[axis]).abs() < 0.05), "{p:?} {q:?}");
    }

    let output = snake(&["register", &sample(), &turned, "-o", &json, "--max-keypoints", "400", "--refine-steps", "5"]);
    let printed = String::from_utf8_lossy(&output.stdout).into_owned();
    let report: Value = serde_json::from_slice(&std::fs::read(&json).unwrap()).unwrap();
    assert!(printed.contains("t_target_source") && printed.contains(&json), "{printed}");
    // What each number is of.
    let inliers = format!("RANSAC: {} of {} correspondences", report["num_inliers"], report["num_correspondences"]);
    assert!(printed.contains(&inliers) && printed.contains("% of the source's voxels within"), "{printed}");
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
        ["--detector", "fps"],
        ["--detector", "random"],
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

#[test]
fn models_are_found_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let named = |name: &str| {
        let mut command = Command::cargo_bin("snake-cli").unwrap();
        command.args(["model", name]).env("SNAKE_MODELS", folder.path()).output().unwrap()
    };
    let missing = named("mine");
    assert_eq!(missing.status.code(), Some(2));
    let place = folder.path().display().to_string();
    assert!(stderr(&missing).contains("no model `mine`") && stderr(&missing).contains(&place), "{}", stderr(&missing));
    std::fs::copy(root().join("tests/golden/tiny/weights.safetensors"), folder.path().join("mine.safetensors"))
        .unwrap();
    let found = named("mine");
    assert!(String::from_utf8_lossy(&found.stdout).contains("volume: 16 x 16 x 16 voxels"), "{}", stderr(&found));
    // The built-in models have names too, and a path is no name.
    assert_eq!(named("compact").stdout, snake(&["model"]).stdout);
    assert!(String::from_utf8_lossy(&named("rooms").stdout).starts_with("rooms, built-in: 343874 parameters"));
    let path = named("nowhere/mine");
    assert!(stderr(&path).contains("cannot load the model nowhere/mine"), "{}", stderr(&path));
}

/// Writes an array of f32 as NumPy would.
fn write_npy(path: &Path, shape: &[usize], values: &[f32]) {
    let shape: String = shape.iter().map(|length| format!("{length}, ")).collect();
    let header = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({shape}), }}\n");
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.as_bytes());
    bytes.extend(values.iter().flat_map(|v| v.to_le_bytes()));
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    std::fs::write(path, bytes).unwrap();
}

/// A folder in the corpus format: `number` copies of the sample, each of `size` of its points.
fn corpus(number: usize, size: usize) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let points = snake_io::read_points(Path::new(&sample())).unwrap();
    write_npy(&folder.path().join("points.npy"), &[number, size, 3], points[..number * size].as_flattened());
    let index: Vec<_> = (0..number).map(|i| serde_json::json!({"name": format!("part {i}"), "faces": 1})).collect();
    std::fs::write(folder.path().join("index.json"), serde_json::to_string(&index).unwrap()).unwrap();
    folder
}

/// `eval repeatability` with settings that take a second.
fn eval(data: &Path, extra: &[&str]) -> Output {
    let data = data.display().to_string();
    let small = ["--methods", "snake,iss,random", "--downsample", "1,2", "--noise", "0,0.1", "--num-points", "600"];
    snake(&[&["eval", "repeatability", &data], &small[..], extra].concat())
}

#[test]
fn an_evaluation_goes_on_where_it_was_interrupted() {
    let data = corpus(4, 1000);
    let results = tempfile::tempdir().unwrap();
    let run = |name: &str, extra: &[&str]| {
        let folder = results.path().join(name);
        let output = eval(data.path(), &[&["-o", &folder.display().to_string()], extra].concat());
        assert!(output.status.success(), "{}", stderr(&output));
        let files = ["jsonl", "csv", "json", "md", "svg"]
            .map(|e| std::fs::read(folder.join(format!("repeatability.{e}"))).unwrap());
        (output.stdout, files)
    };
    let whole = run("whole", &["--threads", "1"]);
    assert_eq!(run("whole", &[]), whole, "nothing was left to do");

    // Interrupted in the middle of a line; the results were not yet written.
    let record = results.path().join("interrupted/repeatability.jsonl");
    std::fs::create_dir(record.parent().unwrap()).unwrap();
    std::fs::write(&record, &whole.1[0][..whole.1[0].len() * 2 / 3]).unwrap();
    assert_eq!(run("interrupted", &["--threads", "2"]), whole);

    let report: Value = serde_json::from_slice(&whole.1[2]).unwrap();
    assert_eq!((&report["pairs"], report["rows"].as_array().unwrap().len()), (&4.into(), 9));
    for row in report["rows"].as_array().unwrap() {
        let shares: Vec<f64> = row["repeatability"].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect();
        assert!(shares.len() == 8 && shares.windows(2).all(|pair| pair[0] <= pair[1]), "{row}");
        assert!((0.0..=1.0).contains(&shares[0]) && row["coverage"].as_f64().unwrap() > 0.0);
    }
    assert_eq!(report["rows"][2]["method"], "random");
    assert_eq!(report["rows"][2]["keypoints"], 64.0);
    let text = String::from_utf8_lossy(&whole.0);
    assert!(text.contains("over 4 pairs") && text.contains("At ε 0.04, over down-sampling"), "{text}");
    let curves = String::from_utf8_lossy(&whole.1[4]);
    // Three methods in three panels, and in the legend.
    assert_eq!((curves.matches("<g ").count(), curves.matches("<polyline").count()), (3, 12), "{curves}");

    // Two seeds: the first with the same figures, and deviations over both.
    let seeds = run("seeds", &["--seeds", "2"]);
    let [both, one] = [&seeds, &whole].map(|(_, files)| String::from_utf8_lossy(&files[0]));
    assert_eq!(both.lines().count(), 9);
    assert!(both.lines().skip(1).take(4).eq(one.lines().skip(1)) && both.lines().nth(5) != one.lines().nth(1));
    assert!(String::from_utf8_lossy(&seeds.0).contains("over 4 pairs ± standard deviation over 2 seeds"));
    let record = results.path().join("seeds/repeatability.jsonl");
    std::fs::write(&record, &seeds.1[0][..seeds.1[0].len() * 4 / 5]).unwrap();
    assert_eq!(run("seeds", &["--seeds", "2", "--threads", "1"]), seeds);

    let refused = eval(data.path(), &["--seed", "1", "-o", &results.path().join("whole").display().to_string()]);
    assert_eq!(refused.status.code(), Some(2));
    assert!(stderr(&refused).contains("is of a run with other settings"), "{}", stderr(&refused));
}

#[test]
fn real_pairs_are_evaluated_in_their_units() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::copy(sample(), folder.path().join("a.ply")).unwrap();
    // The second view is the first moved by 10 along x.
    let points = snake_io::read_points(Path::new(&sample())).unwrap();
    let moved: String = points.iter().map(|[x, y, z]| format!("{} {y} {z}\n", x - 10.0)).collect();
    std::fs::write(folder.path().join("b.xyz"), moved).unwrap();
    let t_target_source = [[1, 0, 0, 10], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]];
    let pairs = serde_json::json!([{"source": "b", "target": "a.ply", "T": t_target_source, "overlap": 1.0}]);
    std::fs::write(folder.path().join("pairs.json"), pairs.to_string()).unwrap();
    let results = tempfile::tempdir().unwrap();
    let output = results.path().display().to_string();
    let all_points =
        ["--methods", "iss,fps", "--num-points", "99999", "--downsample", "1", "--noise", "0", "--epsilon", "0.001"];
    let data = folder.path().display().to_string();
    let found = snake(&[&["eval", "repeatability", &data, "-o", &output], &all_points[..]].concat());
    assert!(found.status.success(), "{}", stderr(&found));
    let csv = std::fs::read_to_string(results.path().join("repeatability.csv")).unwrap();
    // All points of both views, so the same keypoints, but for the rounding of the shifted coordinates.
    let shares = csv.lines().skip(1).map(|line| line.split(',').nth(4).unwrap().parse::<f64>().unwrap());
    assert!(shares.clone().count() == 2 && shares.clone().all(|share| share > 0.9), "{csv}");
}

#[test]
fn two_files_and_their_transform_are_a_pair() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    // Ten times as large, and the second moved by 100 along x.
    let points = snake_io::read_points(Path::new(&sample())).unwrap();
    let rows =
        |shift: f32| points.iter().map(move |p| format!("{} {} {}\n", 10.0 * p[0] - shift, 10.0 * p[1], 10.0 * p[2]));
    std::fs::write(path("target.xyz"), rows(0.0).collect::<String>()).unwrap();
    std::fs::write(path("source.xyz"), rows(100.0).collect::<String>()).unwrap();
    std::fs::write(path("t.txt"), "1 0 0 100\n0 1 0 0\n0 0 1 0\n0 0 0 1\n").unwrap();
    let t_target_source = [[1, 0, 0, 100], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]];
    std::fs::write(path("t.json"), serde_json::json!({"t_target_source": t_target_source, "rmse": 0}).to_string())
        .unwrap();
    let [source, target] = ["source.xyz", "target.xyz"].map(path);
    let run = |transform: &str| {
        let small = ["--methods", "snakex2,fps", "--num-points", "4096", "--downsample", "1", "--noise", "0"];
        let transform = path(transform);
        snake(&[&["eval", "repeatability", &source, &target, "--transform", &transform], &small[..]].concat())
    };
    let (text, json) = (run("t.txt"), run("t.json"));
    assert!(text.status.success(), "{}", stderr(&text));
    assert_eq!(text.stdout, json.stdout);
    let shown = String::from_utf8_lossy(&text.stdout).into_owned();
    assert!(shown.contains("over 1 pairs"), "{shown}");
    // Both views are the whole cloud: farthest points are the same, and the model's nearly so.
    for (method, least) in [("fps", 0.95), ("snakex2", 0.6)] {
        let row = shown.lines().find(|line| line.starts_with(method)).unwrap();
        assert!(row.split_whitespace().nth(8).unwrap().parse::<f64>().unwrap() > least, "{shown}");
    }
    std::fs::write(path("t.txt"), "1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1 7").unwrap();
    assert!(stderr(&run("t.txt")).contains("t.txt: expected four rows of four numbers"));
    // Matrices that are not rigid are refused here and by `view`.
    for rows in ["2 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1", "1 0 0 0\n0 -1 0 0\n0 0 1 0\n0 0 0 1"] {
        std::fs::write(path("t.txt"), rows).unwrap();
        let view = snake(&["view", &target, &source, "--transform", &path("t.txt"), "-o", &path("pair.html")]);
        for refused in [run("t.txt"), view] {
            assert!(stderr(&refused).contains("t.txt: rigid transform: expected"), "{}", stderr(&refused));
        }
    }
    assert!(stderr(&run("nowhere.json")).contains("cannot read"));
    let one = snake(&["eval", "repeatability", &source, "--transform", &path("t.json")]);
    assert!(stderr(&one).contains("--transform is for two clouds"), "{}", stderr(&one));
}

/// From the sample to fragment k of a scene: turned about z and moved.
fn pose(k: usize) -> RigidTransform {
    IsometryMatrix3::new(Vector3::new(k as f64, 0.0, -0.5), Vector3::z() * 0.1 * k as f64).into()
}

/// From fragment j to fragment i.
fn between(i: usize, j: usize) -> RigidTransform {
    pose(i) * pose(j).inverse()
}

/// Fragments 0 to 3 of a scene: the sample, each without every fourth point and in its own frame.
fn fragments() -> [Vec<[f32; 3]>; 4] {
    let points = snake_io::read_points(Path::new(&sample())).unwrap();
    std::array::from_fn(|k| {
        let seen: Vec<_> = points.iter().enumerate().filter(|(i, _)| i % 4 != k).map(|(_, p)| *p).collect();
        snake_registration::transform_points(&pose(k), &seen)
    })
}

/// Pairs (i, j) of [`fragments`] in our format.
fn scenes(pairs: &[[usize; 2]]) -> TempDir {
    let (folder, clouds) = (tempfile::tempdir().unwrap(), fragments());
    for (k, cloud) in clouds.iter().enumerate() {
        snake_io::write_points(&folder.path().join(format!("room__{k:02}.ply")), cloud, [0.0; 3]).unwrap();
    }
    let row = |&[i, j]: &[usize; 2]| serde_json::json!({"source": format!("room__{j:02}"), "target": format!("room__{i:02}"), "T": between(i, j)});
    let rows: Vec<Value> = pairs.iter().map(row).collect();
    std::fs::write(folder.path().join("pairs.json"), serde_json::to_string(&rows).unwrap()).unwrap();
    folder
}

/// Pairs (i, j) of [`fragments`] as a scene of the 3DMatch benchmark, its truth in a folder beside it, 0.05 m off
/// along z. Squared errors along z count `weight` times.
fn benchmark_scene(folder: &Path, name: &str, pairs: &[[usize; 2]], weight: f64) {
    let clouds = fragments();
    let (scene, truth) = (folder.join(name), folder.join(format!("{name}-evaluation")));
    std::fs::create_dir(&scene).unwrap();
    std::fs::create_dir(&truth).unwrap();
    for (k, cloud) in clouds.iter().enumerate() {
        snake_io::write_points(&scene.join(format!("cloud_bin_{k}.ply")), cloud, [0.0; 3]).unwrap();
    }
    let (mut log, mut info) = (String::new(), String::new());
    for &[i, j] in pairs {
        let rows = |rows: Vec<Vec<f64>>| -> String {
            let line = |row: &Vec<f64>| row.iter().map(|v| format!("{v:.8e}\t")).collect::<String>() + "\n";
            format!("{i}\t {j}\t 4\n") + &rows.iter().map(line).collect::<String>()
        };
        let mut truth = between(i, j).to_matrix();
        truth[2][3] += 0.05;
        log += &rows(truth.iter().map(|row| row.to_vec()).collect());
        let mut information = snake_eval::information_matrix(&clouds[j]).unwrap();
        information[2][2] *= weight;
        info += &rows(information.iter().map(|row| row.to_vec()).collect());
    }
    std::fs::write(truth.join("gt.log"), log).unwrap();
    std::fs::write(truth.join("gt.info"), info).unwrap();
}

/// `eval registration` with settings that take a second.
fn eval_scenes(data: &Path, extra: &[&str]) -> Output {
    let data = data.display().to_string();
    snake(&[&["eval", "registration", &data, "--keypoints", "400,50"], extra].concat())
}

#[test]
fn an_evaluation_of_registration_goes_on_where_it_was_interrupted() {
    let data = scenes(&[[0, 1], [0, 2], [1, 3], [0, 3]]);
    let detectors = ["--detectors", "snake,fps"];
    let results = tempfile::tempdir().unwrap();
    let run = |name: &str, extra: &[&str]| {
        let folder = results.path().join(name);
        let output = eval_scenes(data.path(), &[&detectors, &["-o", &folder.display().to_string()], extra].concat());
        assert!(output.status.success(), "{}", stderr(&output));
        let files =
            ["jsonl", "csv", "json", "md"].map(|e| std::fs::read(folder.join(format!("registration.{e}"))).unwrap());
        (output.stdout, files)
    };
    let whole = run("whole", &["--threads", "1"]);
    assert_eq!(run("whole", &[]), whole, "nothing was left to do");
    for part in [0, 1, 3] {
        let name = format!("interrupted {part}");
        std::fs::create_dir(results.path().join(&name)).unwrap();
        let record = results.path().join(&name).join("registration.jsonl");
        std::fs::write(&record, &whole.1[0][..whole.1[0].len() * part / 4]).unwrap();
        assert_eq!(run(&name, &["--threads", "2"]), whole);
    }
    let report: Value = serde_json::from_slice(&whole.1[2]).unwrap();
    let rows = report["rows"].as_array().unwrap();
    assert_eq!((&report["pairs"], &report["scenes"], rows.len()), (&4.into(), &serde_json::json!(["room"]), 8));
    // FPFH of farthest points registers each of the pairs.
    let fps = &rows[6];
    assert_eq!(
        ["detector", "descriptor", "keypoints"].map(|key| fps[key].clone()),
        ["fps".into(), "fpfh".into(), Value::from(400)]
    );
    assert_eq!((&fps["mean"]["registration_recall"], &fps["mean"]["found"]), (&1.0.into(), &400.0.into()), "{fps}");
    assert_eq!((&fps["mean"]["feature_matching_recall"], &fps["mean"]), (&1.0.into(), &fps["scenes"][0]), "{fps}");
    assert_eq!(rows[7]["mean"]["found"], 50.0);

    let refused = |extra: &[&str]| {
        let folder = results.path().join("whole").display().to_string();
        let output = eval_scenes(data.path(), &[&detectors, &["-o", &folder], extra].concat());
        assert!(stderr(&output).contains("is of a run with other settings"), "{extra:?}: {}", stderr(&output));
    };
    for extra in [["--seed", "1"], ["--limit", "2"], ["--descriptors", "fpfh"]] {
        refused(&extra);
    }
}

#[test]
fn scenes_of_the_benchmark_are_evaluated_by_its_ground_truth() {
    let data = tempfile::tempdir().unwrap();
    benchmark_scene(data.path(), "a room", &[[0, 1], [0, 2], [1, 3]], 1.0);
    // 0.05² counts as 0.5² here, which is beyond 0.2²; and one pair is of consecutive fragments.
    benchmark_scene(data.path(), "b room", &[[0, 1], [0, 2]], 100.0);
    let figures = |path: &Path| -> Value {
        let results = tempfile::tempdir().unwrap();
        let output = results.path().display().to_string();
        let found = eval_scenes(path, &["--detectors", "fps", "--descriptors", "fpfh", "-o", &output]);
        assert!(found.status.success(), "{}", stderr(&found));
        serde_json::from_slice(&std::fs::read(results.path().join("registration.json")).unwrap()).unwrap()
    };
    let both = figures(data.path());
    assert_eq!((&both["scenes"], &both["pairs"]), (&serde_json::json!(["a room", "b room"]), &5.into()));
    let row = &both["rows"][0];
    assert_eq!(row["scenes"][0]["registration_recall"], 1.0, "{row}");
    assert_eq!(
        (&row["scenes"][1]["registration_recall"], &row["mean"]["registration_recall"]),
        (&0.0.into(), &0.5.into())
    );
    // One of the scenes, and its truth beside the fragments.
    let one = figures(&data.path().join("a room"));
    assert_eq!(one["rows"][0]["mean"], row["scenes"][0]);
    for file in ["gt.log", "gt.info"] {
        let from = data.path().join("a room-evaluation").join(file);
        std::fs::rename(from, data.path().join("a room").join(file)).unwrap();
    }
    assert_eq!(figures(&data.path().join("a room"))["rows"], one["rows"]);
}

#[test]
fn scenes_that_cannot_be_evaluated_are_refused() {
    let refused = |path: &Path, extra: &[&str], message: &str| {
        let output = eval_scenes(path, extra);
        assert_eq!(output.status.code(), Some(2), "{message}");
        assert!(stderr(&output).contains(message), "{message}: {}", stderr(&output));
    };
    let data = scenes(&[[0, 2]]);
    for (extra, message) in [
        (["--detectors", "orb"], "harris3d"),
        (["--descriptors", "shot"], "fpfh"),
        (["--keypoints", "100,0"], "--keypoints must be 1 or more"),
        (["--limit", "0"], "--limit must be 1 or more"),
    ] {
        let data = data.path().display().to_string();
        let output = snake(&[&["eval", "registration", &data], &extra[..]].concat());
        assert!(output.status.code() == Some(2) && stderr(&output).contains(message), "{}", stderr(&output));
    }
    std::fs::write(data.path().join("room__02.ply"), std::fs::read(data.path().join("room__00.ply")).unwrap()).unwrap();
    let far = r#"[{"source": "room__02", "target": "room__00", "T": [[1, 0, 0, 99], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}]"#;
    std::fs::write(data.path().join("pairs.json"), far).unwrap();
    refused(data.path(), &[], "the clouds do not overlap under the given transform");
    std::fs::remove_file(data.path().join("room__02.ply")).unwrap();
    refused(data.path(), &[], "no such cloud");

    let data = tempfile::tempdir().unwrap();
    refused(data.path(), &[], "no pairs (looked for pairs.json, gt.log, and folders with gt.log)");
    refused(&data.path().join("nowhere"), &[], "cannot list");
    benchmark_scene(data.path(), "room", &[[0, 2], [1, 3]], 1.0);
    let truth = data.path().join("room-evaluation");
    let (log, info) = (std::fs::read_to_string(truth.join("gt.log")).unwrap(), truth.join("gt.info"));
    let whole = std::fs::read_to_string(&info).unwrap();
    std::fs::write(&info, whole.lines().take(7).collect::<Vec<_>>().join("\n")).unwrap();
    refused(data.path(), &[], "nothing on the pair 1 3 of gt.log");
    std::fs::write(&info, whole.lines().take(9).collect::<Vec<_>>().join("\n")).unwrap();
    refused(data.path(), &[], "gt.info: ends within an entry");
    std::fs::remove_file(&info).unwrap();
    refused(data.path(), &[], "gt.info");
    std::fs::write(&info, whole).unwrap();
    std::fs::write(truth.join("gt.log"), log.replacen("e", "x", 1)).unwrap();
    refused(data.path(), &[], "gt.log: entry 0: `");
    std::fs::write(truth.join("gt.log"), log).unwrap();
    std::fs::write(data.path().join("room/cloud_bin_2.ply"), "junk").unwrap();
    refused(data.path(), &[], "cloud_bin_2.ply");
}
/// The points of the sample in a frame of their own: turned by a quarter about z, moved by (3, 0, -1), with the 3x4
/// transform that takes them back.
fn turned_view() -> (Vec<[f32; 3]>, [f32; 12]) {
    let points = snake_io::read_points(Path::new(&sample())).unwrap();
    let turned = points.iter().map(|p| [3.0 - p[1], p[0], p[2] - 1.0]).collect();
    (turned, [0.0, 1.0, 0.0, 0.0, -1.0, 0.0, 0.0, 3.0, 0.0, 0.0, 1.0, 1.0])
}

#[test]
fn usips_layouts_are_pairs_with_their_transforms() {
    let folder = tempfile::tempdir().unwrap();
    let points = snake_io::read_points(Path::new(&sample())).unwrap();
    let (turned, back) = turned_view();
    let shape = [points.len(), 3];
    let (modelnet, redwood) = (folder.path().join("modelnet"), folder.path().join("redwood"));
    for i in 0..2 {
        write_npy(&modelnet.join(format!("original/{i}.npy")), &shape, points.as_flattened());
        write_npy(&modelnet.join(format!("rotated/{i}.npy")), &shape, turned.as_flattened());
    }
    write_npy(&redwood.join("office1/4.npy"), &shape, points.as_flattened());
    write_npy(&redwood.join("office1/5.npy"), &shape, turned.as_flattened());
    std::fs::write(redwood.join("redwood_pair.txt"), "office1 4 5\noffice1 5 4\n").unwrap();
    // The second pair's transform is wrong: nothing may be found again there.
    let mut two = [back, back].concat();
    two[15] += 100.0;
    for data in [&modelnet, &redwood] {
        write_npy(&data.join("transform.npy"), &[2, 3, 4], &two);
        let output = folder.path().join("results");
        let all = ["--methods", "fps", "--num-points", "99999", "--downsample", "1", "--noise", "0", "--paper", "-o"];
        let (data, out) = (data.display().to_string(), output.display().to_string());
        let found = snake(&[&["eval", "repeatability", &data], &all[..], &[&out]].concat());
        assert!(found.status.success(), "{}", stderr(&found));
        let record = std::fs::read_to_string(output.join("repeatability.jsonl")).unwrap();
        let pairs: Vec<Value> = record.lines().skip(1).map(|line| serde_json::from_str(line).unwrap()).collect();
        let share = |pair: usize| pairs[pair]["rows"][0]["repeatability"][7].as_f64().unwrap();
        assert!(share(0) > 0.9 && share(1) == 0.0, "{record}");
        std::fs::remove_dir_all(&output).unwrap();
        let (epsilon, paper) = if data.ends_with("modelnet") { ("ε 0.04", "0.864") } else { ("ε 0.2", "0.393") };
        let text = String::from_utf8_lossy(&found.stdout);
        assert!(text.contains(epsilon) && text.contains(paper), "{text}");
    }
    let refused = |message: &str| {
        let output = eval(&redwood, &[]);
        assert_eq!(output.status.code(), Some(2));
        assert!(stderr(&output).contains(message), "{}", stderr(&output));
    };
    write_npy(&redwood.join("transform.npy"), &[1, 3, 4], &back);
    refused("2 pairs in redwood_pair.txt, but 1 transforms");
    std::fs::write(redwood.join("redwood_pair.txt"), "office1 4\n").unwrap();
    refused("expected a scene and two numbers, found `office1 4`");
    std::fs::write(redwood.join("redwood_pair.txt"), "office1 4 6\n").unwrap();
    refused("6.npy: no such cloud");
    write_npy(&redwood.join("transform.npy"), &[3, 4], &back);
    refused("needed is (S, 3, 4)");
}

#[test]
fn evaluations_that_make_no_sense_are_refused() {
    let data = corpus(1, 100);
    for (extra, message) in [
        (&["--methods", "iss,orb"][..], "allowed is iss, harris3d, sift3d, fps or random"),
        (&["--epsilon", "0.1,0.2", "--table-epsilon", "0.3"], "--table-epsilon 0.3 is none of --epsilon"),
        (&["--noise", "nan"], "--noise NaN: must be 0 or more"),
        (&["--downsample", "0"], "must be 1 or more"),
        (&["--limit", "0"], "--limit must be 1 or more"),
        (&["--count", "0"], "--count must be 1 or more"),
        (&["--epsilon=-1"], "option `epsilon` is -1"),
        (&["--preset", "kitti"], "option `preset` is kitti"),
    ] {
        let output = eval(data.path(), extra);
        assert_eq!(output.status.code(), Some(2), "{extra:?}");
        assert!(stderr(&output).contains(message), "{extra:?}: {}", stderr(&output));
    }
    std::fs::write(data.path().join("index.json"), "[]").unwrap();
    let output = eval(data.path(), &[]);
    assert!(stderr(&output).contains("index.json has 0 rows, points.npy 1 clouds"), "{}", stderr(&output));
    assert!(stderr(&eval(corpus(0, 100).path(), &["--limit", "1"])).contains("no clouds in points.npy"));
    let empty = tempfile::tempdir().unwrap();
    assert!(stderr(&eval(empty.path(), &[])).contains("no point clouds in it"));
    std::fs::write(empty.path().join("pairs.json"), "[]").unwrap();
    assert!(stderr(&eval(empty.path(), &[])).contains("no pairs in pairs.json"));
    let pair = r#"[{"source": "a", "target": "a", "T": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}]"#;
    std::fs::write(empty.path().join("pairs.json"), pair).unwrap();
    assert!(stderr(&eval(empty.path(), &[])).contains("a to a: "));
    std::fs::write(empty.path().join("a.xyz"), "").unwrap();
    assert!(stderr(&eval(empty.path(), &[])).contains("a to a: a cloud without points"));
}

/// A folder in the layout of KeypointNet: three shapes of 600 points of the sample; on the two chairs the marked points
/// are the first five of farthest-point sampling, on the table one that is not among them.
fn keypointnet() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let points = &snake_io::read_points(Path::new(&sample())).unwrap()[..600];
    let found: Vec<usize> = snake_registration::detectors::farthest_points(points, 5)
        .unwrap()
        .iter()
        .map(|response| response.index)
        .collect();
    let other = (0..600).find(|index| !found.contains(index)).unwrap();
    let rows: String = points.iter().map(|[x, y, z]| format!("{x} {y} {z} 1\n")).collect();
    let header = "FIELDS x y z rgb\nSIZE 4 4 4 4\nTYPE F F F F\nWIDTH 600\nHEIGHT 1\nPOINTS 600\nDATA ascii\n";
    let annotation = |class: &str, model: &str, marked: &[usize]| {
        let path = folder.path().join("pcds").join(class).join(format!("{model}.pcd"));
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, format!("{header}{rows}")).unwrap();
        let marked: Vec<_> = marked
            .iter()
            .map(|index| serde_json::json!({"semantic_id": 0, "pcd_info": {"point_index": index, "xyz": [0, 0, 0]}}))
            .collect();
        serde_json::json!({"class_id": class, "model_id": model, "keypoints": marked})
    };
    let annotations = folder.path().join("annotations");
    std::fs::create_dir(&annotations).unwrap();
    let chairs = [annotation("03", "a", &found), annotation("03", "b", &found)];
    std::fs::write(annotations.join("chair.json"), serde_json::to_string(&chairs).unwrap()).unwrap();
    let tables = [annotation("04", "c", &[other, other])];
    std::fs::write(annotations.join("table.json"), serde_json::to_string(&tables).unwrap()).unwrap();
    std::fs::write(annotations.join("all.json"), "not read").unwrap();
    folder
}

#[test]
fn keypoints_are_compared_with_marked_ones() {
    let data = keypointnet();
    let results = tempfile::tempdir().unwrap();
    let run = |name: &str, extra: &[&str]| {
        let folder = results.path().join(name);
        let (data, out) = (data.path().display().to_string(), folder.display().to_string());
        let output = snake(&[&["eval", "semantic", &data, "-o", &out, "--threshold", "0,100"], extra].concat());
        assert!(output.status.success(), "{}", stderr(&output));
        let files =
            ["jsonl", "csv", "json", "md", "svg"].map(|e| std::fs::read(folder.join(format!("semantic.{e}"))).unwrap());
        (String::from_utf8_lossy(&output.stdout).into_owned(), files)
    };
    let rows = |files: &[Vec<u8>; 5]| -> Vec<Value> {
        let report: Value = serde_json::from_slice(&files[2]).unwrap();
        report["rows"].as_array().unwrap().clone()
    };
    let (text, files) = run("fps", &["--methods", "fps", "--count", "5", "--nms-radius", "0", "--paper"]);
    let figures: Vec<Value> = rows(&files);
    let expected = [(Value::Null, [0.5, 1.0]), ("chair".into(), [1.0, 1.0]), ("table".into(), [0.0, 1.0])];
    for (row, (class, iou)) in figures.iter().zip(expected) {
        assert_eq!((&row["class"], &row["paper"]), (&class, &serde_json::json!(iou)), "{row}");
        assert_eq!((&row["method"], &row["keypoints"]), (&"fps".into(), &5.0.into()));
    }
    assert!(text.contains("mIoU over 3 shapes of 2 classes") && text.contains("snake (paper)"), "{text}");

    // All methods, whole and interrupted; the keypoints of each are farther apart than the radius.
    let small = ["--nms-radius", "0.3", "--threads", "1"];
    let whole = run("whole", &small);
    let record = results.path().join("interrupted/semantic.jsonl");
    std::fs::create_dir(record.parent().unwrap()).unwrap();
    std::fs::write(&record, &whole.1[0][..whole.1[0].len() * 2 / 3]).unwrap();
    assert_eq!(run("interrupted", &small), whole);
    for row in rows(&whole.1) {
        let iou = |rule: &str, i: usize| row[rule][i].as_f64().unwrap();
        assert!(iou("strict", 0) <= iou("strict", 1) && (0.0..=1.0).contains(&iou("paper", 1)), "{row}");
        assert!(row["keypoints"].as_f64().unwrap() < 40.0, "{row}");
    }
    // The radius is the ranked methods' only.
    let random = run("paper", &["--methods", "iss", "--nms-radius", "0.3", "--protocol", "paper"]);
    assert_eq!(rows(&random.1)[0]["keypoints"], 64.0);

    let split = results.path().join("split.txt");
    std::fs::write(&split, "04-c\n").unwrap();
    let one = run("split", &["--methods", "random", "--split", &split.display().to_string()]);
    assert!(one.0.contains("1 shapes of 1 classes"), "{}", one.0);

    // The clouds may lie beside the annotations.
    for class in ["03", "04"] {
        std::fs::rename(data.path().join("pcds").join(class), data.path().join(class)).unwrap();
    }
    std::fs::remove_dir(data.path().join("pcds")).unwrap();
    assert_eq!(run("beside", &small).0, whole.0);
}

#[test]
fn bodies_are_compared_place_by_place() {
    let folder = tempfile::tempdir().unwrap();
    let points = snake_io::read_points(Path::new(&sample())).unwrap();
    let turned: Vec<[f32; 3]> = points.iter().map(|[x, y, z]| [-y, *x, *z]).collect();
    write_npy(&folder.path().join("body_1.npy"), &[2, 500, 3], points[..1000].as_flattened());
    write_npy(&folder.path().join("body_2.npy"), &[2, 500, 3], turned[..1000].as_flattened());
    let run = |extra: &[&str]| {
        let data = folder.path().display().to_string();
        snake(&[&["eval", "semantic", &data, "--methods", "fps,random", "--threshold", "0.001,100"], extra].concat())
    };
    let output = run(&[]);
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(text.contains("mIoU over 2 pairs"), "{text}{}", stderr(&output));
    let cells = |method: &str| -> Vec<f64> {
        let row = text.lines().find(|line| line.starts_with(method)).unwrap();
        let shares = row.split_whitespace().skip(1).filter(|cell| !cell.starts_with('±'));
        shares.map(|cell| cell.parse().unwrap()).collect()
    };
    // Farthest points are those of the turned body, random ones others.
    assert!(cells("fps")[0] > 0.8 && cells("random")[0] < 0.2 && cells("random")[1] == 1.0, "{text}");
    assert!(stderr(&run(&["--split", "x.txt"])).contains("--split is for KeypointNet"));
    write_npy(&folder.path().join("body_2.npy"), &[1, 500, 3], turned[..500].as_flattened());
    assert!(stderr(&run(&[])).contains("2 bodies in body_1.npy, 1 in body_2.npy"));
    write_npy(&folder.path().join("body_2.npy"), &[2, 400, 3], turned[..800].as_flattened());
    assert!(stderr(&run(&[])).contains("pair 0: body_2: 400 samples, but body_1 has 500"));
}

#[test]
fn body_models_are_posed_and_sampled() {
    let folder = tempfile::tempdir().unwrap();
    let model = root().join("tests/data/smpl/model.pkl");
    let run = |data: &Path, extra: &[&str]| {
        let data = data.display().to_string();
        let small = ["--methods", "fps,random", "--threshold", "0,0.1,100", "--limit", "3"];
        snake(&[&["eval", "semantic", &data], &small[..], extra].concat())
    };
    let pickled = run(&model, &["--paper"]);
    let text = String::from_utf8_lossy(&pickled.stdout).into_owned();
    assert!(text.contains("mIoU over 3 pairs") && text.contains("ukpgan (paper)"), "{text}{}", stderr(&pickled));
    // Bodies of a few metres whose poses are near each other, but not the same.
    let random = text.lines().find(|line| line.starts_with("random")).unwrap();
    let shares: Vec<&str> = random.split_whitespace().filter(|cell| !cell.starts_with('±')).collect();
    assert!(shares[1] < "0.100" && shares[3] == "1.000" && !random.contains("0.000 ±0.000"), "{text}");
    assert_eq!(run(&model.with_extension("npz"), &["--paper"]).stdout, pickled.stdout);
    assert!(run(&model, &["--paper", "--seed", "1"]).stdout != pickled.stdout);

    // A folder; the parameters of the released code: of two equal bodies all keypoints are the same.
    std::fs::copy(&model, folder.path().join("model.pkl")).unwrap();
    assert_eq!(run(folder.path(), &["--paper"]).stdout, pickled.stdout);
    write_npy(&folder.path().join("pose_test_100.npy"), &[2, 2, 3, 3], &[0.7; 36]);
    write_npy(&folder.path().join("beta_test_100.npy"), &[2, 2, 10], &[0.2; 40]);
    let equal = String::from_utf8_lossy(&run(folder.path(), &[]).stdout).into_owned();
    let fps = equal.lines().find(|line| line.starts_with("fps")).unwrap();
    assert!(equal.contains("mIoU over 2 pairs") && fps.contains("1.000 ±0.000"), "{equal}");
    write_npy(&folder.path().join("beta_test_100.npy"), &[2, 2, 9], &[0.2; 36]);
    assert!(stderr(&run(folder.path(), &[])).contains("needed are 10 numbers"));

    for (pickle, message) in [
        (&b"cos\nsystem\n(S'false'\ntR."[..], "model.pkl: byte 0: `os.system` is none of the classes of body models"),
        (b"}.", "model.pkl: no body model: it has no `v_template`"),
        (b"\x80\x02}U\nv_templateK\x01s.", "`v_template` is no array"),
        (b"\x80\x02}q\x00", "cut short"),
    ] {
        std::fs::write(folder.path().join("model.pkl"), pickle).unwrap();
        let output = run(folder.path(), &[]);
        assert_eq!(output.status.code(), Some(2));
        assert!(stderr(&output).contains(message), "{}", stderr(&output));
    }
}

#[test]
fn semantic_data_that_makes_no_sense_is_refused() {
    let data = keypointnet();
    let refused = |extra: &[&str], message: &str| {
        let folder = data.path().display().to_string();
        let output = snake(&[&["eval", "semantic", &folder, "--methods", "random"], extra].concat());
        assert_eq!(output.status.code(), Some(2), "{extra:?}");
        assert!(stderr(&output).contains(message), "{extra:?}: {}", stderr(&output));
    };
    let split = data.path().join("split.txt").display().to_string();
    std::fs::write(&split, "03-a 03-z").unwrap();
    refused(&["--split", &split], "03-z is not among the annotations");
    refused(&["--split", "nowhere.txt"], "nowhere.txt");
    refused(&["--threshold", "-1"], "unexpected argument");
    refused(&["--threshold=-1"], "option `thresholds` is -1");
    let annotations = data.path().join("annotations");
    std::fs::write(annotations.join("table.json"), r#"[{"class_id": "04", "model_id": "c"}]"#).unwrap();
    refused(&[], "table.json: missing field `keypoints`");
    let beyond = r#"[{"class_id": "04", "model_id": "c", "keypoints": [{"pcd_info": {"point_index": 600}}]}]"#;
    std::fs::write(annotations.join("table.json"), beyond).unwrap();
    refused(&[], "04-c: ground_truth: index 600 is outside a cloud of 600 points");
    std::fs::write(annotations.join("table.json"), beyond.replace("\"c\"", "\"d\"")).unwrap();
    refused(&[], "d.pcd");
    for class in ["chair", "table"] {
        std::fs::remove_file(annotations.join(format!("{class}.json"))).unwrap();
    }
    refused(&[], "no annotated shapes");
    std::fs::remove_dir_all(&annotations).unwrap();
    refused(&[], "neither annotations/ (KeypointNet) nor model.pkl");
}

#[test]
fn a_reconstruction_is_written_in_each_format() {
    let folder = TempDir::new().unwrap();
    let reconstruct = |name: &str, more: &[&str]| {
        let path = folder.path().join(name);
        let output =
            snake(&[&["reconstruct", &sample(), "-o", path.to_str().unwrap(), "--resolution", "48"], more].concat());
        assert!(output.status.success(), "{}", stderr(&output));
        (std::fs::read(path).unwrap(), output)
    };
    let (ply, output) = reconstruct("a.ply", &["--json", "--threads", "1"]);
    let report = &json_lines(&output)[0];
    let number = |key: &str| report[key].as_u64().unwrap() as usize;
    let (vertices, triangles) = (number("vertices"), number("triangles"));
    assert!(triangles > 500 && number("num_points") == 4096, "{report}");
    assert!(report["timing_seconds"]["mesh"].as_f64().unwrap() > 0.0);
    let written = snake_io::read_points(&folder.path().join("a.ply")).unwrap();
    assert_eq!(written.len(), vertices);
    let scale = report["normalization"]["scale"].as_f64().unwrap();
    // The surface of a thin shell: both sides of an object that touches the sphere of this diameter.
    let area = report["area"].as_f64().unwrap() / (scale * scale);
    assert!((0.1..3.0).contains(&area), "{area}");
    assert_eq!(reconstruct("b.ply", &["--threads", "2"]).0, ply, "the number of threads matters");

    let (stl, output) = reconstruct("c.STL", &["--outer"]);
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    let outer = (stl.len() - 84) / 50;
    assert!(outer > 100 && outer <= triangles, "{outer}");
    assert!(text.contains(&format!(" {outer} triangles")) && text.contains("written to"), "{text}");

    let (obj, _) = reconstruct("d.obj", &[]);
    let lines = |prefix: &str| String::from_utf8_lossy(&obj).lines().filter(|line| line.starts_with(prefix)).count();
    assert_eq!((lines("v "), lines("vn "), lines("f ")), (vertices, vertices, triangles));

    let (_, output) = reconstruct("e.ply", &["--level", "0.999"]);
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(text.contains("0 triangles, area 0.0") && text.contains("try a lower --level"), "{text}");
}

#[test]
fn a_reconstruction_that_cannot_be_is_refused_before_work() {
    let folder = TempDir::new().unwrap();
    let mesh = folder.path().join("mesh.ply").display().to_string();
    for (arguments, expected) in [
        (&["nowhere.ply", "-o", "mesh.xyz"][..], ".ply, .obj, .stl"),
        (&["nowhere.ply", "-o", &mesh, "--resolution", "1000000"], "allowed is 8 to 512"),
        (&["nowhere.ply", "-o", &mesh, "--level", "1"], "allowed is 0.001 to 0.999"),
        (&["nowhere.ply", "-o", &mesh], "nowhere.ply"),
    ] {
        let output = snake(&[&["reconstruct"], arguments].concat());
        assert_eq!(output.status.code(), Some(2), "{arguments:?}");
        assert!(stderr(&output).contains(expected) && stderr(&output).lines().count() == 1, "{}", stderr(&output));
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

//! `snake-cli detect`.

use std::path::Path;
use std::process::Output;

use assert_cmd::Command;
use serde_json::Value;

use super::{assert_refused, json_lines, report, root, sample, snake, stderr, succeed, write_npy};

#[test]
fn a_fault_of_the_cloud_is_a_note() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("far.xyz").display().to_string();
    let mut points = snake_io::read_points(Path::new(&sample())).unwrap();
    points.push([1e4, 0.0, 0.0]);
    snake_io::write_points(path.as_ref(), &points, [0.0; 3]).unwrap();
    let run = |extra: &[&str]| snake(&[&["detect", &path, "--json", "--set", "max_points=2000"], extra].concat());
    let (plain, quiet) = (run(&[]), run(&["--quiet"]));
    let note = "an outlier, left out";
    assert!(stderr(&plain).contains("note:") && stderr(&plain).contains(note), "{}", stderr(&plain));
    assert!(json_lines(&plain)[0]["notes"][0].as_str().unwrap().contains(note));
    assert!(!stderr(&quiet).contains(note));
    assert_eq!(json_lines(&quiet)[0]["notes"], json_lines(&plain)[0]["notes"]);
}

/// A sample of a made room.
fn room() -> String {
    let folder = root().join("samples/room");
    let mut files: Vec<_> = folder.read_dir().unwrap().map(|entry| entry.unwrap().path()).collect();
    files.sort();
    files[0].display().to_string()
}

#[test]
fn option_that_changes_the_model_of_a_cloud_has_a_note() {
    let detect = |path: &str, extra: &[&str]| {
        let run = snake(&[&["detect", path, "--json", "--max-keypoints", "5"], extra].concat());
        assert!(run.status.success(), "{}", stderr(&run));
        let line = json_lines(&run)[0].clone();
        let note = line["notes"].as_array().unwrap().iter().map(|note| note.as_str().unwrap().to_owned());
        let note = note.into_iter().find(|note| note.contains("so the model is")).unwrap_or_default();
        assert!(stderr(&run).contains(&note));
        (line["model"].as_str().unwrap().to_owned(), note)
    };
    let none = String::new;
    assert_eq!(detect(&room(), &[]), ("scenes, built-in".into(), none()));
    assert_eq!(detect(&sample(), &["--rotations", "2"]), ("compact, built-in".into(), none()));
    for (path, option, value, model, suited) in [
        (room(), "rotations", "2", "compact", "scenes"),
        (room(), "preset", "standard", "compact", "scenes"),
        (sample(), "voxel_size", "3r", "scenes", "compact"),
    ] {
        let (name, note) = detect(&path, &[&format!("--{}", option.replace('_', "-")), value]);
        assert_eq!(name, format!("{model}, built-in"));
        let expected = format!("so the model is `{model}`; without it this cloud has `{suited}`");
        assert!(note.starts_with(&format!("option `{option}` ")) && note.ends_with(&expected), "{note}");
    }
}

#[test]
fn verbose_options_are_those_of_the_model_of_the_cloud() {
    let said = stderr(&snake(&["detect", &room(), "-v"]));
    assert!(said.contains("scenes, built-in") && !said.contains("compact"), "{said}");
    assert!(said.contains(r#""nms_radius":"6.5v""#), "{said}");
}

#[test]
fn detected_keypoints_lie_on_the_cloud() {
    let report = report(&["detect", &sample(), "--json"]);
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
fn timing_is_printed_to_stderr() {
    let rows = |output: &Output| -> Vec<(String, Vec<f64>)> {
        let text = stderr(output);
        let cells = |line: &str| line[10..].split_whitespace().map(|cell| cell.parse().unwrap()).collect();
        let stages = text.lines().skip_while(|line| !line.starts_with("load model"));
        stages.map(|line| (line[..10].trim().to_owned(), cells(line))).collect()
    };
    let one = snake(&["detect", &sample(), "--json", "--timing"]);
    let timing = &json_lines(&one)[0]["timing_seconds"];
    let cells_by_name = rows(&one);
    let names: Vec<&str> = cells_by_name.iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(names, ["load model", "read", "encode", "occupancy", "refine", "nms", "total"]);
    for (name, cells) in &cells_by_name[1..] {
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
        report(&[&["detect", &sample(), "--json"], extra].concat())["counts"][name].as_u64().unwrap()
    };
    assert_eq!(count(&["--set", "query_resolution=20"], "queries"), 8000);
    assert_eq!(count(&["--max-keypoints", "5"], "keypoints"), 5);
    assert!(count(&["--nms-radius", "0.5"], "keypoints") < 10);
    assert_eq!(count(&["--saliency-threshold", "1"], "keypoints"), 0);
    assert_eq!(count(&["--set", "occupancy_threshold=1"], "occupied"), 0);
    assert_eq!(count(&["--preset", "redwood"], "queries"), 1_000_000);
    let snapped = snake(&["detect", &sample(), "--json", "--set", "snap=true", "--max-keypoints", "3"]);
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
        succeed(&["detect", &sample(), "--max-keypoints", "7", "-o", path.to_str().unwrap()]);
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
fn a_bad_file_does_not_stop_the_others() {
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
fn keypoints_are_identical_for_any_number_of_threads() {
    let keypoints =
        |threads: &str| report(&["detect", &sample(), "--json", "--threads", threads])["keypoints"].to_string();
    let one = keypoints("1");
    assert!(one.len() > 1000);
    assert_eq!(one, keypoints("2"));
    assert_eq!(one, keypoints("7"));
}

/// More than two files a thread are processed side by side.
#[test]
fn many_files_are_reported_in_order_for_any_number_of_threads() {
    let folder = tempfile::tempdir().unwrap();
    for number in 0..9 {
        let name = folder.path().join(format!("{number}.npy"));
        match number {
            4 => std::fs::write(name, "not an array").unwrap(),
            // The first files take the longest.
            _ => {
                let number_of_points = 4000 - 400 * number;
                let coordinate = |i: usize| ((i * i) as f32 * 0.37).sin() / (1 + i % 3) as f32;
                let values: Vec<f32> = (0..3 * number_of_points).map(coordinate).collect();
                write_npy(&name, &[number_of_points, 3], &values);
            }
        }
    }
    let run = |threads: &str| {
        let output =
            snake(&["detect", folder.path().to_str().unwrap(), "--json", "--max-keypoints", "9", "--threads", threads]);
        assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
        assert!(stderr(&output).contains("1 of 9 inputs failed"), "{}", stderr(&output));
        let report = |line: &Value| (line["input"].to_string(), line["keypoints"].to_string());
        json_lines(&output).iter().map(report).collect::<Vec<_>>()
    };
    let one = run("1");
    assert!(one.len() == 8 && one.is_sorted());
    assert_eq!(run("3"), one);
    assert_eq!(run("7"), one);
}

#[test]
fn subsampling_is_seeded_and_reported() {
    let sampled = |seed: &str| {
        report(&["detect", &sample(), "--json", "--set", "max_points=1500", "--set", &format!("seed={seed}")])
    };
    let first = sampled("1");
    assert_eq!(first["keypoints"], sampled("1")["keypoints"]);
    assert_ne!(first["keypoints"], sampled("2")["keypoints"]);
    assert_eq!((&first["num_encoded"], &first["num_points"]), (&1500.into(), &4096.into()));
    assert!(succeed(&["detect", &sample(), "--set", "max_points=1500"]).contains("(1500 encoded)"));
}

#[test]
fn a_flat_table_has_no_keypoints_unless_all_are_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("table.npy");
    // 1.2 by 0.8 m, flat to 2 mm.
    let at = |i: u32, step: f64, size: f64| ((f64::from(i) * step).fract() * size) as f32;
    let point = |i| [at(i, 0.754_877_666_2, 1.2), at(i, 0.569_840_290_9, 0.8), at(i, 0.618_033_988_7, 0.004)];
    let values: Vec<f32> = (0..20_000).flat_map(point).collect();
    write_npy(&path, &[20_000, 3], &values);
    let detect = |more: &[&str]| succeed(&[&["detect", path.to_str().unwrap(), "--model", "scenes"], more].concat());
    assert!(detect(&[]).contains(": 0 keypoints"));
    let said = stderr(&snake(&["detect", path.to_str().unwrap(), "--model", "scenes"]));
    assert!(
        said.contains("found again more often than chance") && said.contains("`min_confidence` 0 gives all"),
        "{said}"
    );
    let rows = detect(&["--min-confidence", "0", "--max-keypoints", "9"]);
    assert!(rows.contains(": 9 keypoints"), "{rows}");
}

/// 60 MB of coordinates: the file and the cloud are 120 MB, the cloud, a copy and the points by voxels 160 MB, and each
/// thread reserves 64 MB.
#[cfg(unix)]
#[test]
fn memory_is_proportional_to_the_number_of_points() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("large.npy");
    // A ball: its points turn by the golden angle.
    let point = |i: u32| {
        let z = 2.0 * (f64::from(i) + 0.5) / 5e6 - 1.0;
        let (flat, (sin, cos)) = ((1.0 - z * z).sqrt(), (f64::from(i) * 2.399_963_23).sin_cos());
        [flat * cos, flat * sin, z].map(|v| v as f32)
    };
    let values: Vec<f32> = (0..5_000_000).flat_map(point).collect();
    write_npy(&path, &[5_000_000, 3], &values);
    let output = Command::new("sh")
        .args(["-c", "ulimit -v 600000; exec \"$0\" detect \"$1\" --json --threads 2"])
        .args([env!("CARGO_BIN_EXE_snake-cli").as_ref(), path.as_os_str()])
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    let report = &json_lines(&output)[0];
    assert_eq!((&report["num_points"], &report["num_encoded"]), (&5_000_000.into(), &5_000_000.into()));
}

/// The points are 3.6 MB; their blocks would take gigabytes.
#[cfg(unix)]
#[test]
fn a_voxel_size_that_is_too_small_is_refused_before_its_blocks_are_made() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cube.npy");
    let at = |i: u32, step: f64| ((f64::from(i) * step).fract() * 1000.0) as f32;
    let values: Vec<f32> =
        (0..300_000).flat_map(|i| [at(i, 0.618_033_988_7), at(i, 0.754_877_666_2), at(i, 0.569_840_290_9)]).collect();
    write_npy(&path, &[300_000, 3], &values);
    assert_refused(
        &Command::new("sh")
            .args(["-c", "ulimit -v 1000000; exec \"$0\" detect \"$1\" --model scenes --voxel-size 0.01 --threads 1"])
            .args([env!("CARGO_BIN_EXE_snake-cli").as_ref(), path.as_os_str()])
            .output()
            .unwrap(),
        "times this size fits",
    );
}

#[test]
fn stdout_has_only_the_keypoints_in_a_pipe() {
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
    succeed(&["detect", &sample(), "-o", path.to_str().unwrap()]);
    let csv = std::fs::read(&path).unwrap();
    assert_eq!(run(&["--format", "csv", "--json"], &bytes).stdout, csv);
    let points = snake_io::read_points(Path::new(&sample())).unwrap();
    let text: String = points.iter().map(|[x, y, z]| format!("{x} {y} {z}\n")).collect();
    assert_eq!(run(&["--format", "csv", "--input-format", "xyz"], text.as_bytes()).stdout, csv);
    assert_eq!(run(&[], text.as_bytes()).status.code(), Some(2));
}

#[test]
fn sweeps_are_read_by_their_folder_or_by_the_named_format() {
    let folder = tempfile::tempdir().unwrap();
    let points = snake_io::read_points(Path::new(&sample())).unwrap();
    let keypoints = |name: &str, num_values: usize, arguments: &[&str]| {
        let path = folder.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        let point = |p: &[f32; 3]| [&p[..], &vec![0.5; num_values - 3]].concat();
        let bytes: Vec<u8> = points.iter().flat_map(point).flat_map(f32::to_le_bytes).collect();
        std::fs::write(&path, bytes).unwrap();
        report(&[&["detect", path.to_str().unwrap(), "--json"], arguments].concat())["keypoints"].clone()
    };
    let expected = report(&["detect", &sample(), "--json"])["keypoints"].clone();
    assert_eq!(keypoints("velodyne/000000.bin", 4, &[]), expected);
    assert_eq!(keypoints("any.bin", 4, &["--input-format", "kitti"]), expected);
    assert_eq!(keypoints("sweep.pcd.bin", 5, &[]), expected);
    assert_eq!(keypoints("any.bin", 5, &["--input-format", "nuscenes"]), expected);
    let refused = snake(&["detect", folder.path().join("any.bin").to_str().unwrap()]);
    assert!(stderr(&refused).contains("--input-format kitti"), "{}", stderr(&refused));
}

#[test]
fn points_that_are_not_finite_are_skipped_and_counted() {
    let folder = tempfile::tempdir().unwrap();
    let points = snake_io::read_points(Path::new(&sample())).unwrap();
    let text: String = points.iter().map(|[x, y, z]| format!("nan nan nan\n{x} {y} {z}\n")).collect();
    let path = folder.path().join("organized.xyz");
    std::fs::write(&path, text).unwrap();
    let path = path.display().to_string();
    let (clean, with_nan) = (report(&["detect", &sample(), "--json"]), report(&["detect", &path, "--json"]));
    assert_eq!((&with_nan["num_points"], &with_nan["num_skipped"]), (&8192.into(), &4096.into()));
    assert_eq!(clean["num_skipped"], 0);
    let pairs = clean["keypoints"].as_array().unwrap().iter().zip(with_nan["keypoints"].as_array().unwrap());
    for (clean, with_nan) in pairs {
        assert_eq!((&clean["x"], &clean["saliency"]), (&with_nan["x"], &with_nan["saliency"]));
        let index = |keypoint: &Value| keypoint["nearest_index"].as_u64().unwrap();
        assert_eq!(index(with_nan), 2 * index(clean) + 1);
    }
    assert!(succeed(&["detect", &path]).contains("from 8192 points (4096 not finite or outliers, skipped)"));
    let registered = succeed(&["register", &path, &sample(), "--set", "max_keypoints=300"]);
    assert!(registered.contains("skipped 4096 points of the source"), "{registered}");
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
    let run = |extra: &[&str]| report(&[&["detect", &mesh, "--json", "--max-keypoints", "8"], extra].concat());
    assert_eq!(run(&[])["num_points"], 8);
    let report = run(&["--sample", "4000", "-o", &marks]);
    assert_eq!(report["num_points"], 4000);
    assert_ne!(report["keypoints"], run(&["--sample", "4000", "--set", "seed=3"])["keypoints"]);
    let shapes: Value = serde_json::from_slice(&std::fs::read(&marks).unwrap()).unwrap();
    assert_eq!((&shapes[0]["class_id"], &shapes[0]["model_id"]), (&"02691156".into(), &"cube".into()));
    for (marked, keypoint) in
        shapes[0]["keypoints"].as_array().unwrap().iter().zip(report["keypoints"].as_array().unwrap())
    {
        assert_eq!(marked["pcd_info"]["point_index"], keypoint["nearest_index"]);
    }
    assert!(!shapes[0]["keypoints"].as_array().unwrap().is_empty());
}

#[test]
fn missing_returns_are_left_out_with_a_note() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("zeros.npy");
    let points = snake_io::read_points(Path::new(&sample())).unwrap();
    let points: Vec<f32> = points.into_iter().flat_map(|[x, y, z]| [x, y, z + 9.0, 0.0, 0.0, 0.0]).collect();
    write_npy(&path, &[8192, 3], &points);
    let path = path.display().to_string();
    let note = "4096 of 8192 points (50 %) are at (0, 0, 0), as missing returns are written; they are left out";
    let detected = snake(&["detect", &path, "--json"]);
    assert!(json_lines(&detected)[0]["notes"][0].as_str().unwrap().starts_with(note));
    assert_eq!(stderr(&detected).matches(note).count(), 1, "{}", stderr(&detected));
    let registered = snake(&["register", &path, &sample()]);
    assert!(
        String::from_utf8_lossy(&registered.stdout).contains(&format!("source: {note}")),
        "{}",
        stderr(&registered)
    );
    assert!(!stderr(&snake(&["detect", &path, "--quiet"])).contains(note));
}

#[test]
fn a_folder_of_sweeps_is_read_in_the_given_format() {
    let folder = tempfile::tempdir().unwrap();
    let points = snake_io::read_points(Path::new(&sample())).unwrap();
    let sweep: Vec<u8> = points.iter().flat_map(|[x, y, z]| [*x, *y, *z, 0.5]).flat_map(f32::to_le_bytes).collect();
    for name in ["000.bin", "001.bin"] {
        std::fs::write(folder.path().join(name), &sweep).unwrap();
    }
    std::fs::write(folder.path().join("calib.txt"), "P0: 1 2 3").unwrap();
    let path = folder.path().display().to_string();
    let detected = snake(&["detect", &path, "--input-format", "kitti", "--json"]);
    assert!(detected.status.success() && json_lines(&detected).len() == 2, "{}", stderr(&detected));
    assert_eq!(json_lines(&detected)[0]["num_points"], 4096);
    assert!(stderr(&detected).contains("1 of 3 files is not read: calib.txt"), "{}", stderr(&detected));
    std::fs::remove_file(folder.path().join("calib.txt")).unwrap();
    let refused = snake(&["detect", &path]);
    let expected = "2 other files: 000.bin, 001.bin; .bin files need --input-format kitti";
    assert!(!refused.status.success() && stderr(&refused).contains(expected), "{}", stderr(&refused));
}

#[test]
fn many_clouds_that_are_written_end_with_a_summary() {
    let folder = tempfile::tempdir().unwrap();
    let (input, output) = (folder.path().join("in"), folder.path().join("out"));
    std::fs::create_dir(&input).unwrap();
    for name in ["a.ply", "b.ply"] {
        std::fs::copy(sample(), input.join(name)).unwrap();
    }
    let output = output.display().to_string();
    let [input, one] = [&input, &input.join("a.ply")].map(|path| path.display().to_string());
    let summary = succeed(&["detect", &input, "-o", &output]);
    let lines: Vec<&str> = summary.lines().collect();
    assert_eq!(lines.len(), 2, "{summary}");
    assert!(lines[0].contains(" from 8192 points in 2 clouds in ") && lines[0].contains(" a cloud)"), "{summary}");
    assert_eq!(lines[1], format!("written to {output}"));
    let empty = succeed(&["detect", &input, "-o", &output, "--saliency-threshold", "0.999"]);
    assert!(empty.contains("2 without keypoints: ") && empty.contains("try a lower --saliency-threshold"), "{empty}");
    // Without files the tables are the result, and one cloud has its own.
    for arguments in [&["detect", &input][..], &["detect", &one, "-o", &output]] {
        assert!(succeed(arguments).contains("a.ply: "), "{arguments:?}");
    }
}

#[test]
fn min_confidence_keeps_the_good_keypoints() {
    let sample = root().join("samples/plane.ply").display().to_string();
    let detect = |arguments: &[&str]| {
        report(&[&["detect", &sample, "--json"], arguments].concat())["keypoints"].as_array().unwrap().clone()
    };
    let all = detect(&["--model", "compact"]);
    let confidence = |keypoint: &Value| keypoint["confidence"].as_f64().unwrap();
    assert!(all.is_sorted_by(|a, b| confidence(a) >= confidence(b)));
    let good: Vec<Value> = all.iter().filter(|keypoint| confidence(keypoint) >= 0.75).cloned().collect();
    assert!(!good.is_empty() && good.len() < all.len());
    assert_eq!(detect(&["--model", "compact", "--min-confidence", "0.75"]), good);
    assert_eq!(detect(&["--model", "compact", "--set", "min_confidence=0.75"]), good);
    assert_eq!(detect(&["--model", "compact", "--min-confidence", "0"]), all);
    let golden = root().join("tests/golden/tiny/weights.safetensors").display().to_string();
    assert!(detect(&["--model", &golden]).iter().all(|keypoint| keypoint["confidence"].is_null()));
    let refused = snake(&["detect", &sample, "--model", &golden, "--min-confidence", "0.5"]);
    assert!(!refused.status.success() && stderr(&refused).contains("no map of confidences"), "{}", stderr(&refused));
}

//! `snake-cli detect`.

use std::path::Path;
use std::process::Output;

use assert_cmd::Command;
use serde_json::Value;

use super::{assert_refused, json_lines, report, root, sample, snake, stderr, succeed, write_npy};

#[test]
fn verbose_options_are_those_of_the_model_of_the_cloud() {
    let said = stderr(&snake(&["detect", &root().join("samples/room/1.ply").display().to_string(), "-v"]));
    assert!(said.contains("scenes, built-in") && !said.contains("compact"), "{said}");
    assert!(said.contains(r#""nms_radius":"6.5v""#), "{said}");
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

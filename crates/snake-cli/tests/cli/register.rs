//! `snake-cli register`.

use std::path::Path;

use serde_json::Value;

use super::{assert_refused, json_lines, report, sample, snake, stderr};

/// The sample, rotated by a quarter about z and moved by (3, 0, -1), as a file; every second point of it.
fn rotated_sample(folder: &Path) -> String {
    let points = snake_io::read_points(Path::new(&sample())).unwrap();
    let rotated: Vec<_> = points.iter().step_by(2).map(|p| [3.0 - p[1], p[0], p[2] - 1.0]).collect();
    let path = folder.join("rotated.ply");
    snake_io::write_points(&path, &rotated, [0.0; 3]).unwrap();
    path.display().to_string()
}

#[test]
fn no_model_is_loaded_unless_the_options_run_one_or_it_is_named() {
    let loaded = |command: &str, more: &[&str]| {
        let output = snake(&[&[command, &sample(), &sample(), "-v"], more].concat());
        (output.status.success(), stderr(&output).contains("\nmodel: compact"))
    };
    for command in ["register", "align"] {
        assert_eq!(loaded(command, &[]), (true, false), "{command}");
        for options in [["--detector", "snake"], ["--set", "descriptor=field"], ["--model", "compact"]] {
            assert!(loaded(command, &options).1, "{command} {options:?}");
        }
        assert_refused(
            &snake(&[command, &sample(), &sample(), "--model", "missing.safetensors"]),
            "missing.safetensors",
        );
    }
}

#[test]
fn register_prints_and_writes_the_transform() {
    let folder = tempfile::tempdir().unwrap();
    let rotated = rotated_sample(folder.path());
    let file = |name: &str| folder.path().join(name).display().to_string();
    let (text, aligned, json) = (file("t.txt"), file("aligned.ply"), file("t.json"));
    let report = report(&["register", &sample(), &rotated, "--json", "-o", &text, "--aligned", &aligned]);
    let keys = |value: &Value| value.as_object().unwrap().keys().cloned().collect::<Vec<_>>();
    let groups = ["clouds", "fit", "hypotheses", "matches", "scale", "seconds", "t_target_source", "verdict"];
    assert_eq!(keys(&report), groups);
    assert_eq!(keys(&report["fit"]), ["fitness", "information", "inlier_distance", "rmse", "voxel_size"]);
    let (verdict, matches) = (keys(&report["verdict"]), keys(&report["matches"]));
    let evidence = ["free_space_violation", "repeat_fit", "slide_margin", "weakest_constraint"];
    assert!(evidence.iter().chain(&["confidence", "is_reliable", "notes"]).all(|key| verdict.contains(&(*key).into())));
    let counts = ["num_agreeing", "num_inliers", "num_matches", "num_rival_agreeing", "rmse", "spread"];
    assert_eq!(matches, counts);
    let unknown = serde_json::json!({"num_skipped": 0, "position": null, "viewpoint": "none", "visible": null});
    assert_eq!(report["clouds"][1], unknown);
    let fit = |key: &str| report["fit"][key].as_f64().unwrap();
    assert!(fit("fitness") > 0.95 && fit("rmse") < 0.03 && fit("inlier_distance") > 0.02, "{report}");
    let count = |key: &str| report["matches"][key].as_u64().unwrap();
    let (inliers, all) = (count("num_inliers"), count("num_matches"));
    assert!(3 <= inliers && inliers <= all && report["matches"]["rmse"].as_f64().unwrap() < 0.1);

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

    let output =
        snake(&["register", &sample(), &rotated, "-o", &json, "--set", "max_keypoints=400", "--set", "icp_steps=5"]);
    let printed = String::from_utf8_lossy(&output.stdout).into_owned();
    let report: Value = serde_json::from_slice(&std::fs::read(&json).unwrap()).unwrap();
    assert!(printed.contains("t_target_source") && printed.contains(&json), "{printed}");
    // The meaning of each number.
    let inliers =
        format!("matches: {} of {} within", report["matches"]["num_inliers"], report["matches"]["num_matches"]);
    assert!(printed.contains(&inliers) && printed.contains("% of the source's voxels within"), "{printed}");
    let side = report["fit"]["voxel_size"].as_f64().unwrap();
    let residual = report["fit"]["rmse"].as_f64().unwrap();
    let told = format!("{residual:.5} off by root mean square: {:.2} voxels of {side:.5}", residual / side);
    assert!(side > 0.0 && printed.contains(&told), "{printed}");
    assert!(report["matches"]["num_matches"].as_u64().unwrap() < all.min(801));
}

#[test]
fn register_takes_a_guess_an_axis_and_a_verdict() {
    let folder = tempfile::tempdir().unwrap();
    let rotated = rotated_sample(folder.path());
    let path = |name: &str| folder.path().join(name).display().to_string();
    let run = |extra: &[&str]| snake(&[&["register", &sample(), &rotated, "--json"], extra].concat());
    let report = |extra: &[&str]| {
        let output = run(extra);
        assert!(output.status.success(), "{}", stderr(&output));
        json_lines(&output).remove(0)
    };
    let free = report(&["-o", &path("t.json"), "--set", "hypotheses=3"]);
    assert!((1..=3).contains(&free["hypotheses"].as_array().unwrap().len()));
    let number = |value: &Value, row: usize, column: usize| value["t_target_source"][row][column].as_f64().unwrap();
    let initial = report(&["--initial", &path("t.json"), "--gravity", "z"]);
    assert!((0..12).all(|i| (number(&initial, i / 4, i % 4) - number(&free, i / 4, i % 4)).abs() < 0.05), "{initial}");
    // The nearest rotation to a guess with few digits is taken, and a note says so.
    std::fs::write(path("rounded.txt"), "0.004 -1 0.0005 3\n1 0.004 0 0\n0 0 1 -1\n0 0 0 1").unwrap();
    let guessed = report(&["--initial", &path("rounded.txt")]);
    for (i, j) in [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)] {
        let product: f64 = (0..3).map(|column| number(&guessed, i, column) * number(&guessed, j, column)).sum();
        assert!((product - f64::from(u8::from(i == j))).abs() < 1e-9, "{i} {j}: {product}");
    }
    assert!(guessed["verdict"]["notes"].to_string().contains("rounded rotation"), "{guessed}");
    // A wrong guess is kept, and not reliable.
    std::fs::write(path("wrong.txt"), "1 0 0 50\n0 1 0 50\n0 0 1 50\n0 0 0 1").unwrap();
    let wrong = report(&["--initial", &path("wrong.txt")]);
    assert!(stderr(&run(&["--initial", &path("wrong.txt")])).contains("not reliable"));
    assert!(wrong["verdict"]["is_reliable"] == false && number(&wrong, 0, 3) == 50.0, "{wrong}");
    let refused = run(&["--initial", &path("wrong.txt"), "--require-reliable"]);
    assert!(refused.status.code() == Some(1) && stderr(&refused).contains("not reliable"), "{}", stderr(&refused));
    assert_eq!(json_lines(&refused).len(), 1);
}

#[test]
fn clouds_without_one_answer_exit_with_1_if_a_reliable_one_is_required() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    // Points of a ball and of a cylinder by the golden ratio.
    let turn = |i: u16| (f32::from(i) * 2.399_963).sin_cos();
    let ball = |i: u16| {
        let z = f32::from(i) / 1500.0 - 1.0;
        let radius = (1.0 - z * z).max(0.0).sqrt();
        [radius * turn(i).0, radius * turn(i).1, z]
    };
    let cylinder = |i: u16| [turn(i).0, turn(i).1, f32::from(i) / 500.0];
    let write = |name: &str, points: Vec<[f32; 3]>| snake_io::write_points(name.as_ref(), &points, [0.0; 3]).unwrap();
    // So large that no distances of the sample are there.
    write(&path("ball.ply"), (0..3000).map(|i| ball(i).map(|v| 50.0 * v)).collect());
    write(&path("cylinder.ply"), (0..3000).map(cylinder).collect());
    let apart = snake(&["register", &sample(), &path("ball.ply"), "--require-reliable", "--json"]);
    assert!(apart.status.code() == Some(1) && apart.stdout.is_empty(), "{}", stderr(&apart));
    // Without the option it is an error as any other, and files that cannot be read are one with it.
    assert_eq!(snake(&["register", &sample(), &path("ball.ply")]).status.code(), Some(2));
    let unread = snake(&["register", &sample(), &path("nowhere.ply"), "--require-reliable"]);
    assert_eq!(unread.status.code(), Some(2));
    assert!(stderr(&apart).contains("do the clouds overlap"), "{}", stderr(&apart));
    let round = snake(&["register", &path("cylinder.ply"), &path("cylinder.ply"), "--require-reliable"]);
    let printed = String::from_utf8_lossy(&round.stdout).into_owned();
    assert!(round.status.code() == Some(1) && printed.starts_with("ambiguous: confidence 0"), "{printed}");
    assert!(printed.contains("translation along (0.00, 0.00, 1.00)"), "{printed}");
}

#[test]
fn the_aligned_file_has_the_scale() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let points = snake_io::read_points(Path::new(&sample())).unwrap();
    let write = |name: &str, points: &[[f32; 3]]| {
        snake_io::write_points(path(name).as_ref(), points, [0.0; 3]).unwrap();
        path(name)
    };
    let half: Vec<_> = points.iter().step_by(2).copied().collect();
    let small: Vec<_> = half.iter().map(|p| p.map(|v| v / 1.2)).collect();
    let run = |source: &str, target: &str, more: &[&str]| {
        let report = report(&[&["register", source, target, "--json", "--aligned", &path("out.ply")], more].concat());
        (report, snake_io::read_points(path("out.ply").as_ref()).unwrap())
    };
    let small = write("small.ply", &small);
    let (report, aligned) = run(&small, &sample(), &["--estimate-scale"]);
    assert!((report["scale"].as_f64().unwrap() - 1.2).abs() < 0.02, "{report}");
    let off = aligned.iter().zip(&half).flat_map(|(p, q)| [0, 1, 2].map(|axis| (p[axis] - q[axis]).abs()));
    assert!(off.fold(0.0, f32::max) < 0.05, "{report}");
    let text = snake(&["register", &small, &sample(), "--estimate-scale", "-o", &path("t.txt")]);
    assert!(text.status.code() == Some(2) && stderr(&text).contains(".json"), "{}", stderr(&text));
}

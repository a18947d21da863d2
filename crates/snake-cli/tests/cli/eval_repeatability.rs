//! `snake-cli eval repeatability`.

use std::path::Path;
use std::process::Output;

use serde_json::Value;
use snake_core::RigidTransform;
use tempfile::TempDir;

use super::eval_registration::scenes;
use super::eval_semantic::keypointnet;
use super::{assert_refused, sample, snake, stderr, succeed, write_npy};

/// A folder in the corpus format: `number` copies of the sample, each of `size` of its points.
pub(super) fn corpus(number: usize, size: usize) -> TempDir {
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
fn an_interrupted_evaluation_continues() {
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

    assert_refused(
        &eval(data.path(), &["--seed", "1", "-o", &results.path().join("whole").display().to_string()]),
        "was written with other settings",
    );
}

/// As tables 1 and 2 of the paper: the test split of KeypointNet, with distances and noise in the units of its files.
#[test]
fn the_shapes_of_a_split_keep_their_units() {
    let (data, results) = (keypointnet(), tempfile::tempdir().unwrap());
    let split = results.path().join("test.txt");
    std::fs::write(&split, "03-b\n").unwrap();
    let split = split.display().to_string();
    let run = |name: &str, data: &str, extra: &[&str]| -> Value {
        let folder = results.path().join(name);
        let usual = ["eval", "repeatability", data, "--methods", "random", "--downsample", "1", "--num-points", "500"];
        succeed(&[&usual, extra, &["-o", &folder.display().to_string()]].concat());
        serde_json::from_slice(&std::fs::read(folder.join("repeatability.json")).unwrap()).unwrap()
    };
    let points = &snake_io::read_points(Path::new(&sample())).unwrap()[..600];
    let radius =
        snake_core::Normalization::of(points, snake_core::NormalizationMethod::UnitSphere).unwrap().scale / 2.0;
    let lengths = |unit: f32| [0.1, 0.2].map(|length: f32| (length * unit).to_string());
    let folder = data.path().display().to_string();
    let [noise, epsilon] = lengths(radius);
    let own = run("own", &folder, &["--split", &split, "--noise", &noise, "--epsilon", &epsilon]);
    let shape = data.path().join("pcds/03/b.pcd").display().to_string();
    let [noise, epsilon] = lengths(1.0);
    let scaled = run("scaled", &shape, &["--noise", &noise, "--epsilon", &epsilon]);
    assert_eq!(own["pairs"], 1);
    for (own, scaled) in own["rows"].as_array().unwrap().iter().zip(scaled["rows"].as_array().unwrap()) {
        assert_eq!(own["repeatability"], scaled["repeatability"]);
        let ratio = own["coverage"].as_f64().unwrap() / scaled["coverage"].as_f64().unwrap();
        assert!((ratio / f64::from(radius) - 1.0).abs() < 1e-4 && (radius - 1.0).abs() > 0.1, "{ratio} {radius}");
    }
    // The paper's figures beside UKPGAN's stand where they are.
    let paper = ["--split", &split, "--noise", "0.02", "--paper", "--methods", "fps", "--num-points", "100"];
    let text = succeed(&[&["eval", "repeatability", &folder][..], &paper].concat());
    assert!(text.contains("ukpgan (paper)") && text.contains("0.948"), "{text}");

    for (names, message) in [("03-x", "no such cloud"), ("03b", "03b is no CLASS_ID-MODEL_ID"), ("", "an empty list")] {
        std::fs::write(&split, names).unwrap();
        assert_refused(&snake(&["eval", "repeatability", &folder, "--split", &split]), message);
    }
    assert_refused(&snake(&["eval", "repeatability", &folder, &folder, "--split", &split]), "--split needs one folder");
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
    succeed(&[&["eval", "repeatability", &data, "-o", &output], &all_points[..]].concat());
    let csv = std::fs::read_to_string(results.path().join("repeatability.csv")).unwrap();
    // All points of both views, so the same keypoints, but for the rounding of the shifted coordinates.
    let shares = csv.lines().skip(1).map(|line| line.split(',').nth(4).unwrap().parse::<f64>().unwrap());
    assert!(shares.clone().count() == 2 && shares.clone().all(|share| share > 0.9), "{csv}");
}

#[test]
fn pairs_that_do_not_meet_under_their_transforms_are_named() {
    let data = scenes(&[[0, 1], [0, 3]]);
    let list = data.path().join("pairs.json");
    let run = |metric: &str, more: &[&str]| {
        stderr(&snake(&[&["eval", metric, &data.path().display().to_string(), "--limit", "2"], more].concat()))
    };
    let repeatability = || run("repeatability", &["--methods", "random", "--downsample", "1", "--noise", "0"]);
    let registration = || run("registration", &["--detectors", "random", "--descriptors", "fpfh"]);
    assert!(!repeatability().contains("do not overlap") && !registration().contains("do not overlap"));
    let rows: Vec<Value> = serde_json::from_slice(&std::fs::read(&list).unwrap()).unwrap();
    let inverse = |row: &Value| {
        let t: RigidTransform = serde_json::from_value(row["T"].clone()).unwrap();
        serde_json::json!({"source": row["source"], "target": row["target"], "T": t.inverse()})
    };
    std::fs::write(&list, Value::from_iter(rows.iter().map(inverse)).to_string()).unwrap();
    for text in [repeatability(), registration()] {
        assert!(text.contains("2 of 2 pairs") && text.contains("room__03") && text.contains("wrong way"), "{text}");
    }
}

#[test]
fn two_clouds_and_a_transform_are_a_pair() {
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
    assert!(stderr(&run("nowhere.json")).contains("nowhere.json: "));
    let one = snake(&["eval", "repeatability", &source, "--transform", &path("t.json")]);
    assert!(stderr(&one).contains("--transform needs two clouds"), "{}", stderr(&one));
}

/// The points of the sample in a frame of their own: rotated by a quarter about z, moved by (3, 0, -1), with the 3x4
/// transform that takes them back.
fn rotated_view() -> (Vec<[f32; 3]>, [f32; 12]) {
    let points = snake_io::read_points(Path::new(&sample())).unwrap();
    let rotated = points.iter().map(|p| [3.0 - p[1], p[0], p[2] - 1.0]).collect();
    (rotated, [0.0, 1.0, 0.0, 0.0, -1.0, 0.0, 0.0, 3.0, 0.0, 0.0, 1.0, 1.0])
}

#[test]
fn layouts_of_usip_are_read_as_pairs() {
    let folder = tempfile::tempdir().unwrap();
    let points = snake_io::read_points(Path::new(&sample())).unwrap();
    let (rotated, back) = rotated_view();
    let shape = [points.len(), 3];
    let (modelnet, redwood) = (folder.path().join("modelnet"), folder.path().join("redwood"));
    for i in 0..2 {
        write_npy(&modelnet.join(format!("original/{i}.npy")), &shape, points.as_flattened());
        write_npy(&modelnet.join(format!("rotated/{i}.npy")), &shape, rotated.as_flattened());
    }
    write_npy(&redwood.join("office1/4.npy"), &shape, points.as_flattened());
    write_npy(&redwood.join("office1/5.npy"), &shape, rotated.as_flattened());
    std::fs::write(redwood.join("redwood_pair.txt"), "office1 4 5\noffice1 5 4\n").unwrap();
    // The second pair's transform is wrong: nothing may be found again there.
    let mut two = [back, back].concat();
    two[15] += 100.0;
    for data in [&modelnet, &redwood] {
        write_npy(&data.join("transform.npy"), &[2, 3, 4], &two);
        let output = folder.path().join("results");
        let all = ["--methods", "fps", "--num-points", "99999", "--downsample", "1", "--noise", "0", "--paper", "-o"];
        let (data, out) = (data.display().to_string(), output.display().to_string());
        let evaluated = snake(&[&["eval", "repeatability", &data], &all[..], &[&out]].concat());
        assert!(evaluated.status.success(), "{}", stderr(&evaluated));
        let record = std::fs::read_to_string(output.join("repeatability.jsonl")).unwrap();
        let pairs: Vec<Value> = record.lines().skip(1).map(|line| serde_json::from_str(line).unwrap()).collect();
        let share = |pair: usize| pairs[pair]["rows"][0]["repeatability"][7].as_f64().unwrap();
        assert!(share(0) > 0.9 && share(1) == 0.0, "{record}");
        std::fs::remove_dir_all(&output).unwrap();
        let (epsilon, paper) = if data.ends_with("modelnet") { ("ε 0.04", "0.864") } else { ("ε 0.2", "0.393") };
        let text = String::from_utf8_lossy(&evaluated.stdout);
        assert!(text.contains(epsilon) && text.contains(paper), "{text}");
    }
    let refused = |message: &str| {
        assert_refused(&eval(&redwood, &[]), message);
    };
    write_npy(&redwood.join("transform.npy"), &[1, 3, 4], &back);
    refused("2 pairs in redwood_pair.txt, but 1 transforms");
    std::fs::write(redwood.join("redwood_pair.txt"), "office1 4\n").unwrap();
    refused("expected a scene and two numbers, found `office1 4`");
    std::fs::write(redwood.join("redwood_pair.txt"), "office1 4 6\n").unwrap();
    refused("6.npy: no such cloud");
    write_npy(&redwood.join("transform.npy"), &[3, 4], &back);
    refused("expected (S, 3, 4)");
}

#[test]
fn invalid_options_and_data_sets_are_refused() {
    let data = corpus(1, 100);
    for (extra, message) in [
        (&["--methods", "iss,orb"][..], "allowed is iss, harris3d, sift3d, surface-variation, fps or random"),
        (
            &["--epsilon", "0.1,0.2", "--table-epsilon", "0.3"],
            "--table-epsilon is 0.3: allowed are the values of --epsilon",
        ),
        (&["--noise", "nan"], "--noise is NaN: allowed is 0 or more"),
        (&["--downsample", "0"], "must be 1 or more"),
        (&["--limit", "0"], "--limit must be 1 or more"),
        (&["--max-keypoints", "0"], "--max-keypoints must be 1 or more"),
        (&["--epsilon=-1"], "option `epsilon` is -1"),
        (&["--preset", "kitti"], "option `preset` is kitti"),
    ] {
        assert_refused(&eval(data.path(), extra), message);
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
    assert!(stderr(&eval(empty.path(), &[])).contains("a.xyz: a cloud without points"));
}

//! `snake-cli eval registration`.

use std::path::Path;
use std::process::Output;

use nalgebra::{IsometryMatrix3, Vector3};
use serde_json::Value;
use snake_core::RigidTransform;
use tempfile::TempDir;

use super::{assert_refused, sample, snake, stderr};

/// From the sample to fragment k of a scene: rotated about z and moved.
fn pose(k: usize) -> RigidTransform {
    IsometryMatrix3::new(Vector3::new(k as f64, 0.0, -0.5), Vector3::z() * 0.1 * k as f64).into()
}

/// From fragment j to fragment i.
pub(super) fn between(i: usize, j: usize) -> RigidTransform {
    pose(i) * pose(j).inverse()
}

/// Fragments 0 to 3 of a scene: the sample, each without every fourth point and in its own frame.
pub(super) fn fragments() -> [Vec<[f32; 3]>; 4] {
    let points = snake_io::read_points(Path::new(&sample())).unwrap();
    std::array::from_fn(|k| {
        let seen: Vec<_> = points.iter().enumerate().filter(|(i, _)| i % 4 != k).map(|(_, p)| *p).collect();
        snake_registration::transform_points(&pose(k), &seen)
    })
}

/// Pairs (i, j) of [`fragments`] in our format.
pub(super) fn scenes(pairs: &[[usize; 2]]) -> TempDir {
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
    snake(&[&["eval", "registration", &data, "--max-keypoints", "400,50"], extra].concat())
}

#[test]
fn an_interrupted_evaluation_continues() {
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
        assert!(stderr(&output).contains("was written with other settings"), "{extra:?}: {}", stderr(&output));
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
        let output_of_eval = eval_scenes(path, &["--detectors", "fps", "--descriptors", "fpfh", "-o", &output]);
        assert!(output_of_eval.status.success(), "{}", stderr(&output_of_eval));
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
fn invalid_options_and_scenes_are_refused() {
    let refused = |path: &Path, extra: &[&str], message: &str| {
        assert_refused(&eval_scenes(path, extra), message);
    };
    let data = scenes(&[[0, 2]]);
    for (extra, message) in [
        (["--detectors", "orb"], "harris3d"),
        (["--descriptors", "shot"], "fpfh"),
        (["--max-keypoints", "100,0"], "--max-keypoints must be 1 or more"),
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
    refused(&data.path().join("nowhere"), &[], "cannot read");
    benchmark_scene(data.path(), "room", &[[0, 2], [1, 3]], 1.0);
    let truth = data.path().join("room-evaluation");
    let (log, info) = (std::fs::read_to_string(truth.join("gt.log")).unwrap(), truth.join("gt.info"));
    let whole = std::fs::read_to_string(&info).unwrap();
    std::fs::write(&info, whole.lines().take(7).collect::<Vec<_>>().join("\n")).unwrap();
    refused(data.path(), &[], "no entry for the pair 1 3 of gt.log");
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

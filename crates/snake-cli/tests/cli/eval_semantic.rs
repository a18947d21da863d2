//! `snake-cli eval semantic`.

use std::path::Path;

use serde_json::Value;
use tempfile::TempDir;

use super::{assert_refused, root, sample, snake, stderr, write_npy};

/// A folder in the layout of KeypointNet: three shapes of 600 points of the sample; on the two chairs the marked points
/// are the first five of farthest-point sampling, on the table one that is not among them.
pub(super) fn keypointnet() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let points = &snake_io::read_points(Path::new(&sample())).unwrap()[..600];
    let farthest: Vec<usize> =
        snake_detectors::farthest_points(points, 5).unwrap().iter().map(|response| response.index).collect();
    let other = (0..600).find(|index| !farthest.contains(index)).unwrap();
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
    let chairs = [annotation("03", "a", &farthest), annotation("03", "b", &farthest)];
    std::fs::write(annotations.join("chair.json"), serde_json::to_string(&chairs).unwrap()).unwrap();
    let tables = [annotation("04", "c", &[other, other])];
    std::fs::write(annotations.join("table.json"), serde_json::to_string(&tables).unwrap()).unwrap();
    std::fs::write(annotations.join("all.json"), "not read").unwrap();
    folder
}

#[test]
fn keypoints_are_compared_with_annotations() {
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
    let (text, files) = run("fps", &["--methods", "fps", "--max-keypoints", "5", "--nms-radius", "0", "--paper"]);
    let figures: Vec<Value> = rows(&files);
    let expected = [(Value::Null, [0.5, 1.0]), ("chair".into(), [1.0, 1.0]), ("table".into(), [0.0, 1.0])];
    for (row, (class, iou)) in figures.iter().zip(expected) {
        assert_eq!((&row["class"], &row["paper"]), (&class, &serde_json::json!(iou)), "{row}");
        assert_eq!((&row["method"], &row["keypoints"]), (&"fps".into(), &5.0.into()));
        // At a threshold of 0 all five places of a chair are found, and the one of the table is not.
        let expected = match row["class"].as_str() {
            Some("chair") => [1.0, 1.0],
            Some(_) => [0.0, 1.0],
            None => [0.5, 1.0],
        };
        assert_eq!(row["recall"], serde_json::json!(expected), "{row}");
    }
    assert!(text.contains("Share of annotated keypoints found over 3 shapes of 2 classes"), "{text}");
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
fn bodies_are_compared_point_by_point() {
    let folder = tempfile::tempdir().unwrap();
    let points = snake_io::read_points(Path::new(&sample())).unwrap();
    let rotated: Vec<[f32; 3]> = points.iter().map(|[x, y, z]| [-y, *x, *z]).collect();
    write_npy(&folder.path().join("body_1.npy"), &[2, 500, 3], points[..1000].as_flattened());
    write_npy(&folder.path().join("body_2.npy"), &[2, 500, 3], rotated[..1000].as_flattened());
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
    // Farthest points are those of the rotated body, random ones others.
    assert!(cells("fps")[0] > 0.8 && cells("random")[0] < 0.2 && cells("random")[1] == 1.0, "{text}");
    assert!(stderr(&run(&["--split", "x.txt"])).contains("the split is for KeypointNet"));
    write_npy(&folder.path().join("body_2.npy"), &[1, 500, 3], rotated[..500].as_flattened());
    assert!(stderr(&run(&[])).contains("2 bodies in body_1.npy, 1 in body_2.npy"));
    write_npy(&folder.path().join("body_2.npy"), &[2, 400, 3], rotated[..800].as_flattened());
    assert!(stderr(&run(&[])).contains("pair 0: body_2: 400 samples, but body_1 has 500"));
}

#[test]
fn body_models_are_posed_and_sampled() {
    let folder = tempfile::tempdir().unwrap();
    let model = root().join("tests/data/smpl/model.npz");
    let run = |data: &Path, extra: &[&str]| {
        let data = data.display().to_string();
        let small = ["--methods", "fps,random", "--threshold", "0,0.1,100", "--limit", "3"];
        snake(&[&["eval", "semantic", &data], &small[..], extra].concat())
    };
    let posed = run(&model, &["--paper"]);
    let text = String::from_utf8_lossy(&posed.stdout).into_owned();
    assert!(text.contains("mIoU over 3 pairs") && text.contains("ukpgan (paper)"), "{text}{}", stderr(&posed));
    // Bodies of a few metres whose poses are near each other, but not the same.
    let random = text.lines().find(|line| line.starts_with("random")).unwrap();
    let shares: Vec<&str> = random.split_whitespace().filter(|cell| !cell.starts_with('±')).collect();
    assert!(shares[1] < "0.100" && shares[3] == "1.000" && !random.contains("0.000 ±0.000"), "{text}");
    assert!(run(&model, &["--paper", "--seed", "1"]).stdout != posed.stdout);

    // A folder; the parameters of the released code: of two equal bodies all keypoints are the same.
    std::fs::copy(&model, folder.path().join("model.npz")).unwrap();
    assert_eq!(run(folder.path(), &["--paper"]).stdout, posed.stdout);
    write_npy(&folder.path().join("pose_test_100.npy"), &[2, 2, 3, 3], &[0.7; 36]);
    write_npy(&folder.path().join("beta_test_100.npy"), &[2, 2, 10], &[0.2; 40]);
    let equal = String::from_utf8_lossy(&run(folder.path(), &[]).stdout).into_owned();
    let fps = equal.lines().find(|line| line.starts_with("fps")).unwrap();
    assert!(equal.contains("mIoU over 2 pairs") && fps.contains("1.000 ±0.000"), "{equal}");
    write_npy(&folder.path().join("beta_test_100.npy"), &[2, 2, 9], &[0.2; 36]);
    assert!(stderr(&run(folder.path(), &[])).contains("expected 10 numbers"));

    let refused = |name: &str, content: &[u8], message: &str| {
        std::fs::write(folder.path().join(name), content).unwrap();
        assert_refused(&run(folder.path(), &[]), message);
    };
    refused("model.npz", b"PK", "model.npz: ");
    std::fs::remove_file(folder.path().join("model.npz")).unwrap();
    refused(
        "model.pkl",
        b"}.",
        "model.pkl: body models are read from .npz; `python -m snake_training.body_model FILE model.npz`",
    );
}

#[test]
fn invalid_options_and_data_sets_are_refused() {
    let data = keypointnet();
    let refused = |extra: &[&str], message: &str| {
        let folder = data.path().display().to_string();
        assert_refused(&snake(&[&["eval", "semantic", &folder, "--methods", "random"], extra].concat()), message);
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
    refused(&[], "neither annotations/ (KeypointNet) nor model.npz");
}

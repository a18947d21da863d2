//! Results as shipped, pinned: keypoints of the sample by each built-in model with its own options, and the transform between two
//! made scans of a room. `SNAKE_WRITE_GOLDEN=1 cargo test -p snake-keypoints --test cli default_path` writes the file anew; the commit
//! that changes it says why.

use serde_json::{Value, json};

use crate::{report, root};

/// Positions and saliencies may differ by this between processors, whose sums have other orders.
const TOLERANCE: f64 = 2e-4;

/// A corner of a room with boxes on the floor, as one of two sensors sees it: each point of a fixed lattice, moved by a little.
fn scan(seed: u32) -> Vec<[f32; 3]> {
    let mut state = seed;
    let mut noise = move || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / (1 << 24) as f32 - 0.5
    };
    let boxes =
        [[0.6, 0.7, 0.4, 0.3, 0.5], [1.6, 0.5, 0.3, 0.5, 0.8], [2.3, 1.6, 0.5, 0.4, 0.35], [0.7, 1.9, 0.2, 0.2, 1.1]];
    let mut points = Vec::new();
    for i in 0..90 {
        for j in 0..70 {
            let (x, y) = (i as f32 / 30.0, j as f32 / 30.0);
            let top = boxes.iter().find(|[cx, cy, w, d, _]| (x - cx).abs() < *w && (y - cy).abs() < *d);
            points.push([x, y, top.map_or(0.0, |[.., height]| *height)]);
            points.push([x, 0.0, y]);
            points.push([0.0, y, x * 0.8]);
        }
    }
    points.iter().map(|point| point.map(|v| v + 0.012 * noise())).collect()
}

fn current_results() -> Value {
    let folder = tempfile::tempdir().unwrap();
    let sample = root().join("samples/plane.ply").display().to_string();
    let model_results = |model: &str| {
        let keypoints =
            report(&["detect", &sample, "--model", model, "--json"])["keypoints"].as_array().unwrap().clone();
        let row = |k: &Value| json!([k["x"], k["y"], k["z"], k["saliency"]]);
        (model.to_owned(), keypoints.iter().map(row).collect::<Value>())
    };
    let mut results: serde_json::Map<String, Value> =
        ["compact", "standard", "scenes"].map(model_results).into_iter().collect();
    let file = |name: &str| folder.path().join(name).display().to_string();
    // A quarter turn about z, and a step aside.
    let rotated: Vec<[f32; 3]> = scan(7).iter().map(|[x, y, z]| [2.0 - y, x + 0.5, z - 0.1]).collect();
    snake_io::write_points(file("a.ply").as_ref(), &scan(3), [0.0; 3]).unwrap();
    snake_io::write_points(file("b.ply").as_ref(), &rotated, [0.0; 3]).unwrap();
    let report = report(&["register", &file("a.ply"), &file("b.ply"), "--json"]);
    assert_eq!(report["verdict"]["is_reliable"], true, "{report}");
    results.insert("transform".into(), report["t_target_source"].clone());
    results.insert("confidence".into(), report["verdict"]["confidence"].clone());
    Value::Object(results)
}

/// Whether two values have the same numbers, nearly.
fn are_near(one: &Value, other: &Value) -> bool {
    match (one, other) {
        (Value::Array(one), Value::Array(other)) => {
            one.len() == other.len() && one.iter().zip(other).all(|(one, other)| are_near(one, other))
        }
        (Value::Number(one), Value::Number(other)) => {
            (one.as_f64().unwrap() - other.as_f64().unwrap()).abs() <= TOLERANCE
        }
        _ => false,
    }
}

#[test]
fn the_default_path_gives_what_it_gave() {
    let path = root().join("tests/golden/default_path.json");
    let results = current_results();
    if std::env::var_os("SNAKE_WRITE_GOLDEN").is_some() {
        std::fs::write(&path, format!("{results}\n")).unwrap();
    }
    let golden: Value = serde_json::from_str(&std::fs::read_to_string(&path).unwrap()).unwrap();
    let rows = results.as_object().unwrap();
    assert_eq!(rows.len(), golden.as_object().unwrap().len());
    for (name, results) in rows {
        assert!(are_near(results, &golden[name]), "{name}: {results}\nwas {}", golden[name]);
    }
    assert!(["compact", "standard", "scenes"].iter().all(|model| rows[*model].as_array().unwrap().len() > 20));
}

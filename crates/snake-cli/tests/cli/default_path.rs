//! Results as shipped, pinned: keypoints of the sample by each built-in model with its own options, and the transform between two
//! views of a room. `SNAKE_WRITE_GOLDEN=1 cargo test -p snake-keypoints --test cli default_path` writes the file anew; the commit
//! that changes it says why.

use serde_json::{Value, json};

use crate::{report, root};

/// Positions and saliencies may differ by this between processors, whose sums have other orders.
const TOLERANCE: f64 = 2e-4;

fn current_results() -> Value {
    let sample = |name: &str| root().join("samples").join(name).display().to_string();
    let model_results = |model: &str| {
        let keypoints = report(&["detect", &sample("plane.ply"), "--model", model, "--json"])["keypoints"]
            .as_array()
            .unwrap()
            .clone();
        let row = |k: &Value| json!([k["x"], k["y"], k["z"], k["saliency"]]);
        (model.to_owned(), keypoints.iter().map(row).collect::<Value>())
    };
    let mut results: serde_json::Map<String, Value> =
        ["compact", "standard", "scenes"].map(model_results).into_iter().collect();
    let report = report(&["register", &sample("room/1.ply"), &sample("room/2.ply"), "--json"]);
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

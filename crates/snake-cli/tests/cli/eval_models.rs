//! `snake-cli eval` with several models as one method.

use std::path::Path;

use serde_json::Value;

use super::eval_registration::scenes;
use super::eval_repeatability::corpus;
use super::eval_semantic::keypointnet;
use super::{snake, stderr};

/// The rows of a report with these words, and what was printed.
fn report(metric: &str, data: &Path, words: &[&str]) -> (Vec<Value>, String) {
    let results = tempfile::tempdir().unwrap();
    let (data, out) = (data.display().to_string(), results.path().display().to_string());
    let output = snake(&[&["eval", metric, &data, "-o", &out], words].concat());
    assert!(output.status.success(), "{}", stderr(&output));
    let read = |results: &Path| std::fs::read(results.join(format!("{metric}.json"))).unwrap();
    let report: Value = serde_json::from_slice(&read(results.path())).unwrap();
    (report["rows"].as_array().unwrap().clone(), String::from_utf8_lossy(&output.stdout).into_owned())
}

/// Two models evaluated as one have the mean of the rows of each, and their deviation; what uses no model is as with one.
fn check(
    metric: &str,
    data: &Path,
    words: &[&str],
    figure: impl Fn(&Value) -> [f64; 2],
    without: impl Fn(&Value) -> bool,
) {
    let with = |model: &[&str]| report(metric, data, &[words, model].concat());
    let ((both, text), (one, _), (other, _)) =
        (with(&["--models", "compact,scenes"]), with(&["--model", "compact"]), with(&["--model", "scenes"]));
    assert!(text.contains("2 models"), "{text}");
    assert_eq!((both.len(), one.len()), (one.len(), other.len()));
    let mut differ = 0;
    for ((both, one), other) in both.iter().zip(&one).zip(&other) {
        if without(both) {
            assert_eq!((both, one), (one, other));
            continue;
        }
        let ([mean, deviation], [a, _], [b, _]) = (figure(both), figure(one), figure(other));
        assert!((mean - (a + b) / 2.0).abs() < 1e-12, "{both}");
        assert!((deviation - (a - b).abs() / 2_f64.sqrt()).abs() < 1e-12, "{both} {a} {b}");
        differ += usize::from(a != b);
    }
    assert!(differ > 0 && both.iter().any(without));
    // The same model twice has its own figures, without a deviation.
    let (twice, _) = with(&["--models", "compact,compact"]);
    assert_eq!(figure(&twice[0]), [figure(&one[0])[0], 0.0]);
}

#[test]
fn repeatability_is_the_mean_over_models() {
    let data = corpus(3, 1000);
    let words = ["--methods", "snake,iss", "--downsample", "1,2", "--noise", "0", "--num-points", "900"];
    let figure = |row: &Value| ["repeatability", "deviation"].map(|key| row[key][7].as_f64().unwrap());
    check("repeatability", data.path(), &words, figure, |row| row["method"] == "iss");
}

#[test]
fn semantic_consistency_is_the_mean_over_models() {
    let data = keypointnet();
    let words = ["--methods", "snake,iss", "--threshold", "0.1", "--nms-radius", "0.1"];
    let figure = |row: &Value| ["strict", "strict_deviation"].map(|key| row[key][0].as_f64().unwrap_or(f64::NAN));
    let without = |row: &Value| row["method"] == "iss";
    check("semantic", data.path(), &words, figure, without);
}

#[test]
fn registration_is_the_mean_over_models() {
    let data = scenes(&[[0, 1], [0, 2]]);
    let words = ["--detectors", "snake,fps", "--max-keypoints", "100,30"];
    let figure = |row: &Value| ["mean", "deviation"].map(|key| row[key]["inlier_ratio"].as_f64().unwrap_or(f64::NAN));
    let without = |row: &Value| row["detector"] == "fps" && row["descriptor"] == "fpfh";
    check("registration", data.path(), &words, figure, without);
}

#[test]
fn without_a_model_each_cloud_has_its_own_and_the_table_names_it() {
    let data = corpus(2, 2000);
    let words = ["--methods", "snake,iss", "--downsample", "1", "--noise", "0", "--num-points", "1800"];
    let ((chosen, text), (named, named_text)) = (
        report("repeatability", data.path(), &words),
        report("repeatability", data.path(), &[&words[..], &["--model", "compact"]].concat()),
    );
    assert!(text.contains("snake (compact) ") && !named_text.contains("(compact)"), "{text}\n{named_text}");
    assert_eq!(chosen, named);
    let (scenes_by_option, text) =
        report("repeatability", data.path(), &[&words[..], &["--set", "voxel_size=0.2"]].concat());
    assert!(text.contains("snake (scenes) "), "{text}");
    assert_ne!(scenes_by_option[0], named[0]);
    let shapes = keypointnet();
    let (_, text) = report("semantic", shapes.path(), &["--methods", "snake,iss", "--threshold", "0.1"]);
    assert!(text.contains("snake (") && text.contains("iss  "), "{text}");
    let fragments = scenes(&[[0, 1]]);
    let (_, text) = report("registration", fragments.path(), &["--detectors", "snake,fps", "--max-keypoints", "30"]);
    assert!(text.contains("snake (compact) field (compact)") && text.contains("fps fpfh"), "{text}");
}

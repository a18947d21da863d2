//! The result of each file of `tests/data/hostile`, by the table `expected.json` beside them.

use std::path::{Path, PathBuf};

use assert_cmd::Command;
use serde::Deserialize;
use serde_json::Value;

/// A row of `expected.json`.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Expected {
    file: String,
    /// Arguments; `FILE` stands for the file.
    command: String,
    exit: i32,
    /// How the one line on stderr that is no note goes on after the file's name.
    message: Option<String>,
    num_points: Option<u64>,
    num_skipped: Option<u64>,
}

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/hostile")
}

fn table() -> Vec<Expected> {
    serde_json::from_slice(&std::fs::read(folder().join("expected.json")).unwrap()).unwrap()
}

#[test]
fn every_file_gives_the_expected_result() {
    for Expected { file, command, exit, message, num_points, num_skipped } in table() {
        let arguments = command.split(' ').map(|word| word.replace("FILE", &file));
        let run = Command::cargo_bin("snake-cli").unwrap().current_dir(folder()).args(arguments).output().unwrap();
        let (stdout, stderr) = (String::from_utf8(run.stdout).unwrap(), String::from_utf8(run.stderr).unwrap());
        assert_eq!(run.status.code(), Some(exit), "{command}, {file}: {stderr}");
        if let Some(message) = message {
            let lines: Vec<&str> = stderr.lines().filter(|line| !line.starts_with("note: ")).collect();
            assert!(
                lines.len() == 1 && lines[0].starts_with("error: ") && lines[0].contains(&message),
                "{file}: {stderr}"
            );
            assert!(lines[0].len() < 600 && !lines[0].contains(char::is_control), "{file}: {stderr}");
        }
        if let Some(num_points) = num_points {
            let report: Value = serde_json::from_str(&stdout).unwrap();
            assert_eq!(report["num_points"], num_points, "{file}");
            assert_eq!(report["num_skipped"], num_skipped.unwrap_or(0), "{file}");
            for keypoint in report["keypoints"].as_array().unwrap() {
                // Only a model without a map of confidences has null, and an open direction of the covariance.
                let mut fields = keypoint.as_object().unwrap().iter();
                let is_free = |name: &str| ["confidence", "covariance"].contains(&name);
                assert!(fields.all(|(name, value)| value.is_number() || is_free(name)), "{file}: {keypoint}");
            }
        }
    }
}

#[test]
fn no_file_is_missing_from_the_table() {
    let listed: Vec<String> = table().into_iter().map(|row| row.file).collect();
    for entry in folder().read_dir().unwrap() {
        let name = entry.unwrap().file_name().into_string().unwrap();
        let is_no_sample = ["expected.json", "generate.py", "README.md"].contains(&name.as_str());
        assert!(is_no_sample || listed.contains(&name), "{name}");
    }
}

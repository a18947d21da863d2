//! The command line as a person uses it, a file for each command and topic. One test binary links once.

mod align;
mod default_path;
mod detect;
mod field;
mod hostile_files;
mod inputs;
mod mistakes;
mod model;
mod options;
mod origins_and_columns;
mod outputs;
mod printing;
mod reconstruct;
mod recording;
mod register;
mod tile_folders;
mod tiles;
mod usage;
mod view;

use std::path::{Path, PathBuf};
use std::process::Output;

use assert_cmd::Command;
use serde_json::Value;
use tempfile::TempDir;

/// Whether `make test-full` runs, which tests whole grids.
fn is_full() -> bool {
    std::env::var_os("SNAKE_FULL").is_some()
}

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

fn sample() -> String {
    root().join("samples/plane.ply").display().to_string()
}

fn snake(arguments: &[&str]) -> Output {
    Command::cargo_bin("snake-cli").unwrap().args(arguments).output().unwrap()
}

/// Runs a command that must succeed; what it printed.
fn succeed(arguments: &[&str]) -> String {
    let output = snake(arguments);
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

/// The one JSON object that a command prints, which must succeed.
fn report(arguments: &[&str]) -> Value {
    serde_json::from_str(&succeed(arguments)).unwrap()
}

/// Checks that a command was refused with a text.
fn assert_refused(output: &Output, expected: &str) {
    assert!(output.status.code() == Some(2) && stderr(output).contains(expected), "{expected}: {}", stderr(output));
}

/// The path of a new file in a folder, as text.
fn file(folder: &TempDir, name: &str) -> String {
    folder.path().join(name).display().to_string()
}

fn json_lines(output: &Output) -> Vec<Value> {
    String::from_utf8_lossy(&output.stdout).lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into()
}

/// An array of the type `descr` as NumPy writes it.
fn npy(descr: &str, shape: &[usize], values: impl Iterator<Item = u8>) -> Vec<u8> {
    let shape: String = shape.iter().map(|length| format!("{length}, ")).collect();
    let header = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': ({shape}), }}\n");
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.as_bytes());
    bytes.extend(values);
    bytes
}

fn write_npy(path: &Path, shape: &[usize], values: &[f32]) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    std::fs::write(path, npy("<f4", shape, values.iter().flat_map(|v| v.to_le_bytes()))).unwrap();
}

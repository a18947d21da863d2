//! The C++ example is built with the library of this crate, and runs. CMake builds it, or the C++ compiler alone where
//! CMake is missing.

#![cfg(target_os = "linux")]

use std::path::{Path, PathBuf};
use std::process::Command;

/// The standard output of a command that must end well.
fn output(command: &mut Command) -> String {
    let done = command.output().unwrap_or_else(|error| panic!("{command:?}: {error}"));
    let [stdout, stderr] = [done.stdout, done.stderr].map(|text| String::from_utf8_lossy(&text).into_owned());
    assert!(done.status.success(), "{command:?}\n{stdout}\n{stderr}");
    stdout
}

/// The shared library, which Cargo builds beside the tests.
fn library() -> PathBuf {
    std::env::current_exe().unwrap().with_file_name("libsnake_rs.so")
}

fn build(example: &Path, folder: &Path) -> PathBuf {
    let program = folder.join("keypoints");
    if Command::new("cmake").arg("--version").output().is_ok() {
        let defined = format!("-DSNAKE_RS_LIBRARY={}", library().display());
        output(Command::new("cmake").arg("-S").arg(example).arg("-B").arg(folder).arg(defined));
        output(Command::new("cmake").arg("--build").arg(folder));
    } else {
        println!("CMake is missing: the compiler builds the example");
        let mut compiler = Command::new("c++");
        compiler.args(["-std=c++17", "-Wall", "-Wextra", "-Werror", "-I"]).arg(example.join("../../include"));
        output(compiler.arg(example.join("keypoints.cpp")).arg(library()).arg("-o").arg(&program));
    }
    program
}

#[test]
fn the_cpp_example_prints_keypoints_a_transform_and_an_error() {
    let example = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/cpp");
    let folder = tempfile::tempdir().unwrap();
    let mut program = Command::new(build(&example, folder.path()));
    // Not the library of an earlier build, which Cargo leaves one folder up and puts first.
    let printed = output(program.env("LD_LIBRARY_PATH", library().parent().unwrap()));
    assert_eq!(printed.lines().filter(|line| line.starts_with("keypoint ")).count(), 5, "{printed}");
    assert!(printed.contains("translation 3.00 ") && printed.contains(", reliable"), "{printed}");
    assert!(printed.contains("without points: error 1, cloud: null"), "{printed}");
}

#[test]
fn the_header_is_valid_c() {
    let header = Path::new(env!("CARGO_MANIFEST_DIR")).join("include/snake_rs.h");
    output(Command::new("cc").args(["-std=c99", "-Wall", "-Wextra", "-Werror", "-fsyntax-only"]).arg(header));
}

//! The folder of `detect --tile`: it belongs to one run, which loses nothing when it is killed.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use crate::{is_full, stderr};

/// A scan of a floor with a wall, and where its keypoints go.
fn scan() -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scan.xyz");
    fs::write(&path, super::tiles::scan(0.0, 0.0)).unwrap();
    (folder, path)
}

fn detect(scan: &Path, output: &Path, more: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_snake-cli"));
    command.arg("detect").arg(scan).arg("-o").arg(output).args(["--tile", "3", "--voxel-size", "0.2"]);
    command.args(["--nms-radius", "0.3", "--max-keypoints", "5000", "--min-confidence", "0"]);
    command.args(["--set", "saliency_threshold=0.01"]).args(more);
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped());
    command
}

/// The exit code of a run and its errors.
fn outcome(child: Child) -> (Option<i32>, String) {
    let output = child.wait_with_output().unwrap();
    (output.status.code(), stderr(&output))
}

fn run(scan: &Path, output: &Path, more: &[&str]) -> (Option<i32>, String) {
    outcome(detect(scan, output, more).spawn().unwrap())
}

#[test]
fn a_run_that_is_killed_at_any_moment_continues_with_nothing_lost() {
    let (folder, scan) = scan();
    let output = folder.path().join("keypoints.csv");
    let start = Instant::now();
    assert_eq!(run(&scan, &output, &[]).0, Some(0));
    let (time, whole) = (start.elapsed(), fs::read(&output).unwrap());
    assert!(whole.len() > 500 && fs::read_dir(folder.path()).unwrap().count() == 2);
    // Most moments lie in the preparation and at the end, where files are written and removed.
    let moments = [0.0, 0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.5, 0.7, 0.8, 0.9, 0.95, 1.0];
    for moment in if is_full() { &moments[..] } else { &[0.05, 0.5, 0.95] } {
        fs::remove_file(&output).unwrap();
        for _ in 0..2 {
            let mut child = detect(&scan, &output, &[]).spawn().unwrap();
            std::thread::sleep(time.mul_f64(*moment));
            child.kill().unwrap();
            child.wait().unwrap();
        }
        let (code, error) = run(&scan, &output, &[]);
        assert_eq!(code, Some(0), "{moment}: {error}");
        assert!(fs::read(&output).unwrap() == whole, "{moment}");
        // A temporary file of the output may be left, or an empty folder, which may be the user's, and nothing else.
        let _if_empty = fs::remove_dir(folder.path().join("keypoints.csv.tiles"));
        let names = fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
        let left: Vec<String> = names.filter(|name| !name.starts_with(".snake-rs.")).collect();
        assert_eq!(left.len(), 2, "{moment}: {left:?}");
    }
}

#[test]
fn folders_of_the_user_are_refused_with_what_to_type() {
    let (folder, scan) = scan();
    let output = folder.path().join("keypoints.csv");
    let scans = folder.path().join("scans");
    let default = folder.path().join("keypoints.csv.tiles");
    for (own, name, more) in [
        (&scans, "points/a.xyz", &["--tile-folder", scans.to_str().unwrap()][..]),
        (&scans, "inputs/mine.txt", &["--tile-folder", scans.to_str().unwrap()]),
        (&default, "inputs/mine.txt", &[]),
        (&default, "candidates/mine.txt", &[]),
    ] {
        let file = own.join(name);
        fs::create_dir_all(file.parent().unwrap()).unwrap();
        fs::copy(&scan, &file).unwrap();
        let (code, error) = run(&scan, &output, more);
        assert_eq!(code, Some(2));
        assert!(error.contains("no run wrote") && error.contains("--tile-folder"), "{error}");
        assert!(!error.contains("continues"), "{error}");
        assert!(fs::read(&file).unwrap() == fs::read(&scan).unwrap() && !output.exists());
        assert_eq!(fs::read_dir(own).unwrap().count(), 1);
        fs::remove_dir_all(own).unwrap();
    }

    // Files that the user puts into the default folder during a run stay.
    let mut child = detect(&scan, &output, &[]).spawn().unwrap();
    while !default.join("points").exists() {
        assert!(child.try_wait().unwrap().is_none());
        std::thread::sleep(Duration::from_millis(1));
    }
    fs::write(default.join("mine.txt"), "mine").unwrap();
    let (code, error) = outcome(child);
    assert!(code == Some(0) && error.contains("mine.txt"), "{error}");
    assert_eq!(fs::read(default.join("mine.txt")).unwrap(), b"mine");
    assert_eq!(fs::read_dir(&default).unwrap().count(), 1);
}

#[test]
fn errors_that_no_repetition_mends_do_not_promise_it() {
    let (folder, scan) = scan();
    let output = folder.path().join("keypoints.csv");
    let single = folder.path().join("single.xyz");
    fs::write(&single, "0 0 0\n").unwrap();
    let tiny = ["--voxel-size", "1e-7"];
    for (input, more) in [(&single, &[][..]), (&scan, &tiny), (&folder.path().join("none.laz"), &[])] {
        let (code, error) = run(input, &output, more);
        assert!(code == Some(2) && !error.contains("continues"), "{error}");
    }
}

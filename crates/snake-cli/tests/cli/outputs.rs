//! Files that the command line writes: they replace no input, and go where the user said.

use std::path::Path;
use std::process::Output;

use assert_cmd::Command;
use serde_json::Value;
use tempfile::TempDir;

use super::{sample, stderr};

/// Runs snake-cli in a folder.
fn snake(folder: &TempDir, arguments: &[&str]) -> Output {
    Command::cargo_bin("snake-cli").unwrap().current_dir(folder.path()).args(arguments).output().unwrap()
}

/// A folder with the sample under each of these names.
fn clouds(names: &[&str]) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    for name in names {
        let path = folder.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::copy(sample(), path).unwrap();
    }
    folder
}

fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<_> = folder.read_dir().unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[cfg(unix)]
#[test]
fn an_output_never_replaces_an_input() {
    use std::os::unix::fs::symlink;
    let folder = clouds(&["a.ply", "b.ply", "scans/a.ply", "scans/b.ply", "results/keep"]);
    let path = |name: &str| folder.path().join(name);
    let points = snake_io::read_points(sample().as_ref()).unwrap();
    for name in ["a.npy", "a.xyz", "repeatability.csv"] {
        snake_io::write_points(&path(name), &points, [0.0; 3]).unwrap();
    }
    std::fs::rename(path("a.xyz"), path("a.txt")).unwrap();
    let identity = "[[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]";
    std::fs::write(path("t.json"), format!(r#"{{"t_target_source": {identity}}}"#)).unwrap();
    for (link, target) in [
        ("link.ply", "a.ply"),
        ("link.html", "a.ply"),
        ("link.png", "a.ply"),
        ("t.html", "t.json"),
        ("results/repeatability.md", "../t.json"),
        ("results/a.keypoints.ply", "../scans/b.ply"),
        ("here", "."),
    ] {
        symlink(target, path(link)).unwrap();
    }
    std::fs::hard_link(path("a.ply"), path("hard.ply")).unwrap();
    let absolute = path("a.ply").display().to_string();
    let inputs = ["a.ply", "b.ply", "a.npy", "a.txt", "t.json", "scans/a.ply", "scans/b.ply"];
    let contents = || inputs.map(|name| std::fs::read(path(name)).unwrap());
    let before = contents();
    let refused = |arguments: &[&str], code: i32| {
        let output = snake(&folder, arguments);
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {}", stderr(&output));
        assert!(stderr(&output).contains("is an input"), "{arguments:?}: {}", stderr(&output));
        assert!(contents() == before, "{arguments:?} changed an input");
    };
    for spelled in ["a.ply", "./a.ply", &absolute, "link.ply", "hard.ply", "scans/../a.ply", "here/a.ply"] {
        refused(&["detect", "a.ply", "-o", spelled], 2);
        refused(&["reconstruct", "a.ply", "-o", spelled, "--resolution", "16"], 2);
        refused(&["register", "a.ply", "b.ply", "--aligned", spelled], 2);
        refused(&["register", "b.ply", "a.ply", "--aligned", spelled], 2);
    }
    refused(&["register", "a.txt", "b.ply", "-o", "./a.txt"], 2);
    refused(&["field", "a.npy", "-o", "./a.npy", "--resolution", "8"], 2);
    refused(&["field", "a.ply", "-o", "link.png", "--resolution", "8"], 2);
    refused(&["view", "a.ply", "-o", "link.html"], 2);
    refused(&["view", "b.ply", "a.ply", "--transform", "t.json", "-o", "t.html"], 2);
    // A folder's other inputs are processed.
    refused(&["detect", "scans", "-o", "results"], 1);
    assert!(path("results/b.keypoints.ply").is_file());
    // The standard input may be a file too.
    let stdin = std::fs::File::open(path("a.ply")).unwrap();
    let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_snake-cli"));
    let output = command.current_dir(folder.path()).args(["detect", "-", "-o", "./a.ply"]).stdin(stdin).output();
    assert_eq!(output.unwrap().status.code(), Some(2));
    assert!(contents() == before);
}

#[cfg(unix)]
#[test]
fn special_files_are_kept() {
    use std::os::unix::fs::{FileTypeExt, symlink};
    let folder = clouds(&["a.ply"]);
    let path = |name: &str| folder.path().join(name);
    let detect = |output: &str| {
        let output = snake(&folder, &["detect", "a.ply", "-q", "--format", "csv", "-o", output]);
        assert!(output.status.success(), "{}", stderr(&output));
    };
    detect("plain.csv");
    let keypoints = std::fs::read(path("plain.csv")).unwrap();
    // A device; the link to it is for the sake of the machine that this is run on.
    symlink("/dev/null", path("null.csv")).unwrap();
    detect("null.csv");
    assert!(path("null.csv").is_symlink());
    assert!(std::fs::metadata("/dev/null").unwrap().file_type().is_char_device());
    // A FIFO with a reader, as a file and as bash's `>(..)`.
    assert!(Command::new("mkfifo").arg(path("fifo")).output().unwrap().status.success());
    let reader = std::thread::spawn({
        let fifo = path("fifo");
        move || std::fs::read(fifo).unwrap()
    });
    detect("fifo");
    assert!(std::fs::symlink_metadata(path("fifo")).unwrap().file_type().is_fifo());
    assert!(reader.join().unwrap() == keypoints);
    let script = "\"$0\" detect a.ply -q --format csv -o >(cat > piped.csv); wait $!";
    let output = Command::new("bash")
        .current_dir(folder.path())
        .args(["-c", script, env!("CARGO_BIN_EXE_snake-cli")])
        .output()
        .unwrap();
    assert_eq!(stderr(&output), "");
    assert!(std::fs::read(path("piped.csv")).unwrap() == keypoints);
}

#[test]
fn errors_name_the_path_that_was_given() {
    let folder = clouds(&["a.ply"]);
    for (command, output) in [
        (&["detect"][..], "nowhere/k.csv"),
        (&["reconstruct", "--resolution", "16"], "nowhere/m.ply"),
        (&["field", "--resolution", "8"], "nowhere/f.png"),
        (&["field", "--resolution", "8"], "nowhere/f.npy"),
        (&["view"], "nowhere/v.html"),
        (&["detect"], "a.ply/k.csv"),
    ] {
        let failed = snake(&folder, &[command, &["a.ply", "-o", output]].concat());
        let said = stderr(&failed);
        assert_eq!(failed.status.code(), Some(2), "{said}");
        assert!(said.contains(output) && !said.contains(".tmp"), "{said}");
    }
    assert_eq!(names(folder.path()), ["a.ply"]);
}

#[test]
fn equal_output_names_stop_only_their_inputs() {
    let folder = clouds(&["scans/a.ply", "scans/b.ply", "deep/a.ply", "deep/a.2.ply"]);
    std::fs::copy(sample(), folder.path().join("scans/c.ply")).unwrap();
    let output = snake(&folder, &["detect", "scans", "deep", "-o", "results", "--json"]);
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(1), "{said}");
    let scans = |name: &str| Path::new("scans").join(name).display().to_string();
    let first = said.lines().next().unwrap();
    assert!(first.contains(&scans("a.ply")) && first.contains("--number-results"), "{said}");
    assert!(said.lines().last().unwrap().contains("2 of 5 inputs failed"), "{said}");
    assert_eq!(names(&folder.path().join("results")), ["a.2.keypoints.ply", "b.keypoints.ply", "c.keypoints.ply"]);

    // Numbered, in the order of the inputs; a number that is a name already is left out.
    let output = snake(&folder, &["detect", "scans", "deep", "-o", "all", "--json", "--number-results"]);
    assert!(output.status.success(), "{}", stderr(&output));
    let all = ["a.2.keypoints.ply", "a.3.keypoints.ply", "a.keypoints.ply", "b.keypoints.ply", "c.keypoints.ply"];
    assert_eq!(names(&folder.path().join("all")), all);
    let text = String::from_utf8(output.stdout).unwrap();
    let outputs: Vec<(String, String)> = text
        .lines()
        .map(|line| {
            let report: Value = serde_json::from_str(line).unwrap();
            let key = |key: &str| report[key].as_str().unwrap().replace('\\', "/");
            (key("input"), key("output"))
        })
        .collect();
    for (input, output) in [("scans/a.ply", "all/a.keypoints.ply"), ("deep/a.ply", "all/a.3.keypoints.ply")] {
        assert!(outputs.contains(&(input.into(), output.into())), "{outputs:?}");
    }
    // Where all clash, nothing can be done.
    let output = snake(&folder, &["detect", "scans/a.ply", "deep/a.ply", "-o", "none"]);
    assert_eq!(output.status.code(), Some(2));
}

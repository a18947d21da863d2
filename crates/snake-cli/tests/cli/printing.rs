//! Printing: the work continues when stdout or stderr fails, and names print no control characters.

use std::fs::File;
use std::process::{Command, Output, Stdio};

use serde_json::Value;
use tempfile::TempDir;

#[cfg(target_os = "linux")]
use super::usage::shown_on_terminal;
use super::{root, sample};

fn snake() -> Command {
    Command::new(env!("CARGO_BIN_EXE_snake-cli"))
}

/// A folder `clouds` with that many copies of the sample.
fn copies(number: usize) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("clouds")).unwrap();
    for index in 0..number {
        std::fs::copy(sample(), folder.path().join(format!("clouds/{index:03}.ply"))).unwrap();
    }
    folder
}

fn written(folder: &TempDir) -> usize {
    folder.path().join("out").read_dir().map_or(0, Iterator::count)
}

/// A pipe that nobody reads.
fn closed_pipe() -> Stdio {
    let mut reader = Command::new("true").stdin(Stdio::piped()).spawn().unwrap();
    let pipe = reader.stdin.take().unwrap();
    reader.wait().unwrap();
    pipe.into()
}

fn full_disk() -> Stdio {
    File::options().write(true).open("/dev/full").unwrap().into()
}

#[cfg(target_os = "linux")]
#[test]
fn a_batch_continues_when_its_output_is_closed() {
    let run = |stdout: Stdio, stderr: Stdio, extra: &[&str]| {
        let folder = copies(4);
        std::fs::write(folder.path().join("clouds/001.ply"), "not a cloud").unwrap();
        let mut command = snake();
        command.current_dir(folder.path()).args(["detect", "clouds", "-o", "out"]).args(extra);
        let status = command.stdout(stdout).stderr(stderr).status().unwrap();
        (status.code(), written(&folder))
    };
    for extra in [&[][..], &["--json"], &["--json", "--timing", "-v"]] {
        // One input of four is none: 1.
        assert_eq!(run(Stdio::null(), full_disk(), extra), (Some(1), 3), "{extra:?}");
        assert_eq!(run(Stdio::null(), closed_pipe(), extra), (Some(1), 3), "{extra:?}");
        assert_eq!(run(closed_pipe(), Stdio::null(), extra), (Some(1), 3), "{extra:?}");
        assert_eq!(run(full_disk(), Stdio::null(), extra), (Some(1), 3), "{extra:?}");
        assert_eq!(run(closed_pipe(), closed_pipe(), extra), (Some(1), 3), "{extra:?}");
    }
    // A reader that takes the first line, as `| head -1`.
    let folder = copies(6);
    let script = "set -o pipefail; \"$0\" detect clouds -o out --json | head -1 > first.json";
    let mut shell = Command::new("bash");
    let status = shell.current_dir(folder.path()).args(["-c", script, env!("CARGO_BIN_EXE_snake-cli")]).status();
    assert_eq!((status.unwrap().code(), written(&folder)), (Some(0), 6));
    assert!(folder.path().join("first.json").metadata().unwrap().len() > 100);
    // Reports that cannot be written are lost, which is an error; without files there is nothing to go on for.
    let folder = copies(2);
    let status = |arguments: &[&str], stdout: Stdio| {
        snake().current_dir(folder.path()).args(arguments).stdout(stdout).stderr(Stdio::null()).status().unwrap().code()
    };
    assert_eq!(status(&["detect", "clouds", "-o", "out", "--json"], full_disk()), Some(1));
    assert_eq!(status(&["detect", "clouds", "--json"], full_disk()), Some(2));
    assert_eq!(status(&["detect", "clouds", "--json"], closed_pipe()), Some(0));
}

#[cfg(target_os = "linux")]
#[test]
fn printing_never_panics() {
    let folder = copies(2);
    let (a, b) = ("clouds/000.ply", "clouds/001.ply");
    for (arguments, code) in [
        (&["--help"][..], 0),
        (&["--version"], 0),
        (&["detect", "--help"], 0),
        (&[], 2),
        (&["detct"], 2),
        (&["detect", a, "--threads", "many"], 2),
        (&["completions", "bash"], 0),
        (&["model"], 0),
        (&["detect", a, "-v", "--timing"], 0),
        (&["detect", "nowhere.ply"], 2),
        (&["reconstruct", a, "-o", "m.ply", "--resolution", "16", "-v"], 0),
        (&["register", a, b, "-o", "t.json", "-v"], 0),
        (&["field", a, "-o", "f.png", "--resolution", "8", "--json"], 0),
        (&["view", a, "-o", "v.html"], 0),
    ] {
        let run = |stdout: Stdio, stderr: Stdio| {
            let mut command = snake();
            command.current_dir(folder.path()).args(arguments);
            command.stdout(stdout).stderr(stderr).status().unwrap().code()
        };
        assert_eq!(run(closed_pipe(), closed_pipe()), Some(code), "{arguments:?}: closed pipes");
        assert_eq!(run(Stdio::null(), full_disk()), Some(code), "{arguments:?}: standard error full");
        let full = run(full_disk(), full_disk());
        assert!(full == Some(code) || full == Some(2), "{arguments:?}: standard output full: {full:?}");
    }
}

/// An escape sequence, a new line and a character that turns the rest around; the eight-bit form of the first.
const HOSTILE: &str = "\u{1b}[31mx\ny\u{202e}z\u{9b}1m";

#[cfg(unix)]
#[test]
fn names_and_values_print_no_control_characters() {
    let folder = tempfile::tempdir().unwrap();
    let name = |extension: &str| format!("{HOSTILE}.{extension}");
    std::fs::copy(sample(), folder.path().join(name("ply"))).unwrap();
    std::fs::create_dir(folder.path().join(HOSTILE)).unwrap();
    std::fs::copy(sample(), folder.path().join(HOSTILE).join("a.ply")).unwrap();
    std::fs::write(folder.path().join("bad.xyz"), format!("1 2 {}\n", HOSTILE.replace('\n', ""))).unwrap();
    let [cloud, json, png, html] = ["ply", "json", "png", "html"].map(name);
    let (mesh, result) = (name("obj"), name("csv"));
    let run = |arguments: &[&str], variable: &str| {
        let mut command = snake();
        command.current_dir(folder.path()).args(arguments).env(variable, HOSTILE);
        command.output().unwrap()
    };
    let harmless = |output: &Output, what: &str| {
        for text in [&output.stdout, &output.stderr] {
            let text = String::from_utf8_lossy(text);
            let harmful = |c: char| (c.is_control() && c != '\n') || c == '\u{202e}';
            assert!(!text.contains(harmful), "{what}: {text:?}");
            // The name's new line began a line of its own.
            assert!(!text.lines().any(|line| line.starts_with('y')), "{what}: {text:?}");
        }
        assert!(!output.stdout.is_empty() || !output.stderr.is_empty(), "{what}: nothing printed");
    };
    for arguments in [
        &["detect", &cloud][..],
        &["detect", &cloud, "--json"],
        &["detect", &cloud, "-v", "-o", &result],
        &["detect", &cloud, "-o", &cloud],
        &["detect", HOSTILE, "--timing"],
        &["detect", HOSTILE, &cloud, "bad.xyz"],
        &["detect", "bad.xyz"],
        &["detect", &format!("{HOSTILE}*.xyz")],
        &["detect", &cloud, "--model", HOSTILE],
        &["detect", &cloud, "--set", &format!("refine_method={HOSTILE}")],
        &["detect", &cloud, &format!("--{HOSTILE}")],
        &[HOSTILE],
        &["field", &cloud, "-o", &png, "--resolution", "8"],
        &["reconstruct", &cloud, "-o", &mesh, "--resolution", "16"],
        &["register", &cloud, &cloud, "-o", &json, "-v"],
        &["register", &cloud, "nowhere"],
        &["view", &cloud, &cloud, "-o", &html],
        &["model", HOSTILE],
    ] {
        harmless(&run(arguments, "UNUSED"), &format!("{arguments:?}"));
    }
    for variable in ["SNAKE_MODEL", "SNAKE_MODELS", "SNAKE_THREADS", "SNAKE_SIMD"] {
        for arguments in
            [&["detect", "--help"][..], &["model", "--help"], &["detect", &cloud, "-v"], &["model", "mine"]]
        {
            harmless(&run(arguments, variable), &format!("{variable}, {arguments:?}"));
        }
    }
    // The name itself is neither lost nor changed.
    let output = run(&["detect", &cloud, "--json"], "UNUSED");
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(report["input"], cloud);
    let shown = String::from_utf8(run(&["detect", &cloud], "UNUSED").stdout).unwrap();
    assert!(shown.starts_with("\\u{1b}[31mx\\ny\\u{202e}z\\u{9b}1m.ply: "), "{shown}");
}

/// The bar's message has the input's name.
#[cfg(target_os = "linux")]
#[test]
fn a_progress_bar_prints_no_control_characters() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::copy(sample(), folder.path().join("x\u{1b}[35my\u{202e}.ply")).unwrap();
    let command = "detect x*.ply --rotations 8 --set refine_steps=10000";
    let Some(shown) = shown_on_terminal(command, folder.path(), ".ply") else { return };
    assert!(shown.contains("x\\u{1b}[35my\\u{202e}.ply"), "{shown:?}");
}

#[test]
fn the_table_of_a_scene_has_its_confidences() {
    let room = root().join("samples/room/1.ply");
    let output = snake().arg("detect").arg(room).args(["--max-keypoints", "9"]).output().unwrap();
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    let first = text.lines().find(|line| line.starts_with("   1 ")).unwrap();
    let confidence: f32 = first.split_whitespace().nth(5).unwrap().parse().unwrap();
    assert!((0.17..1.0).contains(&confidence), "{first}");
    // Words of the network are for those who ask.
    assert!(["queries", "occupied", "scale", "center"].iter().all(|word| !text.contains(word)), "{text}");
}

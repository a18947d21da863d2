//! Which files a command reads: lists, and folders with files that hold no cloud.

use assert_cmd::Command;

use super::{json_lines, sample, snake, succeed};

#[test]
fn a_list_names_inputs_in_a_file_or_at_the_standard_input() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    for name in ["b.ply", "a.ply"] {
        std::fs::copy(sample(), path(name)).unwrap();
    }
    let list = format!("\u{feff}{}\r\n\r\n{}\r\n", path("b.ply"), path("a.ply"));
    std::fs::write(path("list.txt"), &list).unwrap();
    let few = ["--json", "--max-keypoints", "3"];
    let inputs = |output| json_lines(&output).iter().map(|line| line["input"].clone()).collect::<Vec<_>>();
    let kept = inputs(snake(&[&["detect", &sample(), "--input-list", &path("list.txt")], &few[..]].concat()));
    assert_eq!(kept, [sample(), path("b.ply"), path("a.ply")]);
    let mut command = Command::cargo_bin("snake-cli").unwrap();
    let run = command.args(["detect", "--input-list", "-"]).args(few).write_stdin(list).output().unwrap();
    assert_eq!(inputs(run), [path("b.ply"), path("a.ply")]);
    succeed(&["align", "--input-list", &path("list.txt"), "--json"]);
}

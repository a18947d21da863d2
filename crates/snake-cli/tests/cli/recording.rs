//! `snake-cli detect` with a recording.

use super::*;

fn drive() -> String {
    root().join("tests/data/io/drive.mcap").display().to_string()
}

#[test]
fn every_cloud_of_a_recording_has_a_report_and_a_file() {
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("results");
    let done = snake(&["detect", &drive(), "--topic", "/points", "--json", "-o", &output.display().to_string()]);
    assert!(done.status.success(), "{}", stderr(&done));
    let lines = json_lines(&done);
    assert_eq!(lines.len(), 2);
    for (index, line) in lines.iter().enumerate() {
        let file = output.join(format!("drive.{index:06}.keypoints.ply"));
        assert_eq!(line["output"], file.display().to_string());
        assert_eq!((&line["recorded"]["index"], line["input"].as_str()), (&index.into(), Some(drive().as_str())));
        assert!(line["recorded"]["frame_id"].is_string() && line["recorded"]["log_time"].is_u64());
        assert_eq!(snake_io::read_points(&file).unwrap().len(), line["keypoints"].as_array().unwrap().len());
        assert!(!line["keypoints"].as_array().unwrap().is_empty());
    }
    let text = String::from_utf8(snake(&["detect", &drive()]).stdout).unwrap();
    assert!(text.contains("drive.mcap, cloud 0: ") && text.contains("drive.mcap, cloud 1: "), "{text}");
}

#[test]
fn a_cut_recording_gives_its_clouds_and_ends_with_1() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cut.mcap");
    let whole = std::fs::read(drive()).unwrap();
    std::fs::write(&path, &whole[..whole.len() - 20]).unwrap();
    let done = snake(&["detect", &path.display().to_string(), "--json"]);
    assert_eq!((done.status.code(), json_lines(&done).len()), (Some(1), 2), "{}", stderr(&done));
    assert!(stderr(&done).contains("cut short") && stderr(&done).contains("1 of 3 inputs failed"), "{}", stderr(&done));
}

#[test]
fn mistakes_with_recordings_are_named() {
    let (drive, sample) = (drive(), sample());
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("keypoints.ply").display().to_string();
    let page = folder.path().join("page.html").display().to_string();
    let results = folder.path().join("results").display().to_string();
    let renamed = |extension: &str| folder.path().join(format!("old.{extension}")).display().to_string();
    for (arguments, expected) in [
        (
            &["detect", &drive, "--topic", "/other", "-o", &results][..],
            "no messages of the topic /other; topics with point clouds: /points",
        ),
        (&["detect", &drive, &sample], "a recording has to be the only input"),
        (&["detect", &sample, "--topic", "/points"], "--topic is for a recording"),
        (&["detect", &drive, "-o", &file], "give a directory"),
        (&["detect", &drive, "-o", "-"], "give a directory"),
        (&["detect", &drive, "-o", &drive], "is an input"),
        (&["detect", &drive, "--sample", "9"], "not for a recording"),
        (&["view", &drive, "-o", &page], "`snake-cli detect` read"),
        (&["detect", "none.mcap"], "none.mcap"),
        (&["detect", &renamed("bag")], "old.bag: No such file"),
        (&["detect", &renamed("db3")], "old.db3: "),
        (&["view", &renamed("db3"), "-o", &page], "old.db3: No such file"),
    ] {
        let done = snake(arguments);
        assert!(!done.status.success() && stderr(&done).contains(expected), "{arguments:?}: {}", stderr(&done));
    }
    assert!(folder.path().read_dir().unwrap().next().is_none());
    for (extension, expected) in [("bag", "mcap convert FILE.bag FILE.mcap"), ("db3", "ros2 bag convert -i FOLDER")] {
        std::fs::write(renamed(extension), "of another program").unwrap();
        assert_refused(&snake(&["view", &renamed(extension), "-o", &page]), expected);
        assert_refused(&snake(&["detect", &renamed(extension)]), expected);
    }
    // The folder of a bag.
    std::fs::remove_file(renamed("bag")).unwrap();
    std::fs::write(folder.path().join("metadata.yaml"), "").unwrap();
    assert_refused(&snake(&["detect", &folder.path().display().to_string()]), "ros2 bag convert -i FOLDER");
}

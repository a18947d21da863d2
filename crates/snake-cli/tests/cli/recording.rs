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

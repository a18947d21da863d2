//! `detect --tile`: one large cloud in tiles.

use std::fs;

use crate::{snake, stderr};

/// A floor of 12 by 9 m with a wall, at this place.
pub fn scan(east: f64, north: f64) -> String {
    let floor = (0..2700).map(|i| [f64::from(i % 60) * 0.2, f64::from(i / 60) * 0.2, 0.0]);
    let wall = (0..900).map(|i| [6.0, f64::from(i % 45) * 0.2, f64::from(i / 45) * 0.15]);
    floor.chain(wall).map(|[x, y, z]| format!("{} {} {z}\n", x + east, y + north)).collect()
}

#[test]
fn tiles_write_the_keypoints_of_the_whole_cloud() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (input, whole, tiled) = (path("scan.xyz"), path("whole.csv"), path("tiled.csv"));
    fs::write(&input, scan(691_000.25, 5_336_000.5)).unwrap();
    let few = ["--voxel-size", "0.2", "--nms-radius", "0.3", "--max-keypoints", "5000"];
    let options = [&few[..], &["--set", "saliency_threshold=0.01", "--min-confidence", "0"]].concat();
    let run = |arguments: &[&str]| {
        let output = snake(&[&["detect", &input][..], arguments, &options[..]].concat());
        (output.status.code(), stderr(&output))
    };
    assert_eq!(run(&["-o", &whole]).0, Some(0));
    assert_eq!(run(&["-o", &tiled, "--tile", "4"]).0, Some(0));
    let text = fs::read_to_string(&whole).unwrap();
    assert!(text.lines().count() > 20 && fs::read_to_string(&tiled).unwrap() == text);
    assert!(!folder.path().join("tiled.csv.tiles").exists());

    // A tile that fails is named by its bounds and left out. Once it can be written, the run continues.
    let (kept, keypoints) = (path("kept"), path("keypoints.csv"));
    let in_folder = ["-o", &keypoints, "--tile", "4", "--tile-folder", &kept];
    assert_eq!(run(&in_folder).0, Some(0));
    let complete = fs::read(&keypoints).unwrap();
    let entries = fs::read_dir(format!("{kept}/candidates")).unwrap().map(|entry| entry.unwrap());
    let one = entries.max_by_key(|entry| entry.metadata().unwrap().len()).unwrap().path();
    let candidates = fs::read(&one).unwrap();
    fs::remove_file(&one).unwrap();
    fs::create_dir(&one).unwrap();
    let (code, error) = run(&in_folder);
    assert!(code == Some(1) && error.contains("the tile from x 691") && !error.contains("continues"), "{error}");
    assert!(fs::read(&keypoints).unwrap() != complete);
    fs::remove_dir(&one).unwrap();
    assert_eq!(run(&in_folder).0, Some(0));
    assert!(fs::read(&keypoints).unwrap() == complete && fs::read(&one).unwrap() == candidates);

    // With a full disk, here a limit of half the size of a file, the old result stays. Once there is room, the run continues.
    #[cfg(target_os = "linux")]
    {
        fs::remove_file(&one).unwrap();
        let limited = format!("trap '' XFSZ; ulimit -f {}; exec \"$0\" \"$@\"", candidates.len() / 2048);
        let program = env!("CARGO_BIN_EXE_snake-cli");
        let output = std::process::Command::new("sh")
            .args(["-c", &limited, program, "detect", &input])
            .args(in_folder)
            .args(&options)
            .output()
            .unwrap();
        let error = stderr(&output);
        assert!(output.status.code() == Some(2) && error.contains("the same command continues"), "{error}");
        assert!(fs::read(&keypoints).unwrap() == complete);
        fs::remove_file(&keypoints).unwrap();
        assert_eq!(run(&in_folder).0, Some(0));
        assert!(fs::read(&keypoints).unwrap() == complete && fs::read(&one).unwrap() == candidates);
    }
}

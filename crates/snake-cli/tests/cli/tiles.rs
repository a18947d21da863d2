//! `detect --tile`: one large cloud in tiles.

use std::fs;

use crate::{assert_refused, snake, stderr};

/// A floor of 12 by 9 m with a wall, far from zero.
fn scan() -> String {
    let floor = (0..2700).map(|i| [f64::from(i % 60) * 0.2, f64::from(i / 60) * 0.2, 0.0]);
    let wall = (0..900).map(|i| [6.0, f64::from(i % 45) * 0.2, f64::from(i / 45) * 0.15]);
    floor.chain(wall).map(|[x, y, z]| format!("{} {} {z}\n", x + 691_000.25, y + 5_336_000.5)).collect()
}

#[test]
fn tiles_write_the_keypoints_of_the_whole_cloud() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (input, whole, tiled) = (path("scan.xyz"), path("whole.csv"), path("tiled.csv"));
    fs::write(&input, scan()).unwrap();
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

    // A lost tile is made anew; a damaged one is an error that says what to do, and the old result stays.
    let (kept, keypoints) = (path("kept"), path("keypoints.csv"));
    let in_folder = ["-o", &keypoints, "--tile", "4", "--tile-folder", &kept];
    assert_eq!(run(&in_folder).0, Some(0));
    let complete = fs::read(&keypoints).unwrap();
    let largest = |name: &str| {
        let entries = fs::read_dir(format!("{kept}/{name}")).unwrap().map(|entry| entry.unwrap());
        entries.max_by_key(|entry| entry.metadata().unwrap().len()).unwrap().path()
    };
    let one = largest("candidates");
    let candidates = fs::read(&one).unwrap();
    fs::write(&one, &candidates[1..candidates.len() - 1]).unwrap();
    let (code, error) = run(&in_folder);
    assert!(code == Some(2) && error.contains("remove the folder"), "{error}");
    assert!(fs::read(&keypoints).unwrap() == complete);
    fs::remove_file(&one).unwrap();
    assert_eq!(run(&in_folder).0, Some(0));
    assert!(fs::read(&keypoints).unwrap() == complete && fs::read(&one).unwrap() == candidates);

    // A tile that fails is named by its bounds and left out. Once it can be written, the run continues.
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

/// The file and its reference system: `tests/data/tiles/city.copc.laz` of the repository, EPSG 25832.
#[test]
fn a_copc_file_in_tiles_gives_the_bytes_of_the_whole_with_its_reference_system() {
    let city = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/data/tiles/city.copc.laz");
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (whole, tiled) = (path("whole.laz"), path("tiled.laz"));
    let options = ["--model", "scenes", "--voxel-size", "0.4", "--nms-radius", "0.5", "--max-keypoints", "5000"];
    for (output, tile) in [(&whole, &[][..]), (&tiled, &["--tile", "15"])] {
        let run = snake(&[&["detect", city, "-o", output][..], tile, &options].concat());
        assert_eq!(run.status.code(), Some(0), "{}", stderr(&run));
    }
    assert!(fs::read(&whole).unwrap() == fs::read(&tiled).unwrap());
    let mut number = 0;
    let crs = snake_io::for_each_position(whole.as_ref(), &Default::default(), &mut |_| number += 1).unwrap();
    assert!(number > 50 && crs.unwrap().epsg == Some(25832));
}

#[test]
fn tiles_need_lengths_in_cloud_units_and_files() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (input, output) = (path("scan.xyz"), path("k.csv"));
    fs::write(&input, scan()).unwrap();
    for (arguments, expected) in [
        (&["--model", "compact"][..], "scenes"),
        (&["--nms-radius", "3%"], "nms_radius"),
        (&["--set", "max_points=100"], "max_points"),
        (&["--set", "snap=true"], "snap"),
        (&["--set", "mode_radius=4%"], "mode_radius"),
        (&["--voxel-size", "3r"], "voxel_size"),
        (&["--json"], "--json"),
    ] {
        assert_refused(&snake(&[&["detect", &input, "-o", &output, "--tile", "4"][..], arguments].concat()), expected);
    }
    let refused = snake(&["detect", "-", "-o", &output, "--tile", "4"]);
    assert!(stderr(&refused).contains("standard input"), "{}", stderr(&refused));
    let drive = path("drive.mcap");
    fs::write(&drive, "no recording").unwrap();
    for inputs in [&[&drive][..], &[&drive, &input]] {
        let inputs = inputs.iter().map(|input| input.as_str());
        let arguments: Vec<&str> = ["detect"].into_iter().chain(inputs).chain(["-o", &output, "--tile", "4"]).collect();
        assert_refused(&snake(&arguments), "recording");
    }
    assert!(!std::path::Path::new(&output).exists());
}

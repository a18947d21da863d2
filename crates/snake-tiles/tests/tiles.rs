//! Runs in tiles give the keypoints of the whole cloud.

mod city;

use std::fs;
use std::path::{Path, PathBuf};

use snake_core::{Builtin, Control, DetectOptions, Detection, Model, Options, TileDetector};
use snake_io::{ReadOptions, for_each_position, read_cloud};
use snake_tiles::{TiledDetection, TiledRun};

fn options() -> Options {
    let detect = DetectOptions::default()
        .with_query_resolution(16)
        .with_refine_steps(0)
        .with_saliency_threshold(0.01)
        .with_nms_radius(Some(0.5.into()))
        .with_max_keypoints(100_000);
    Options::default().with_detect(detect).with_window_radius(Some(4.0.into()))
}

fn write_city(path: &Path) {
    let mut bytes = Vec::new();
    city::write_las(&mut bytes, city::city(1, 6000)).unwrap();
    fs::write(path, bytes).unwrap();
}

fn prepare(files: &[PathBuf], options: &Options, side: f64, folder: &Path) -> snake_tiles::Result<TiledRun> {
    let detector = TileDetector::new(&Model::builtin(Builtin::Rooms), options)?;
    TiledRun::prepare(detector, files, &ReadOptions::default(), side, folder)
}

fn finish(run: &TiledRun) -> TiledDetection {
    run.tiles().iter().for_each(|tile| run.detect(tile, &Control::default()).unwrap());
    run.finish(&Control::default()).unwrap()
}

fn assert_equal(tiled: &TiledDetection, whole: &Detection, what: &str) {
    assert!(tiled.keypoints.iter().map(|k| &k.keypoint).eq(&whole.keypoints), "{what}");
    assert_eq!(tiled.counts, whole.counts, "{what}");
    assert!(tiled.missing.is_empty());
}

#[test]
fn five_tilings_an_interrupted_run_and_split_files_give_the_bits_of_the_whole_cloud() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let scan = path("city.las");
    write_city(&scan);
    let cloud = read_cloud(&scan, &ReadOptions::default()).unwrap();
    let whole = Model::builtin(Builtin::Rooms).detect(&cloud.points, &options()).unwrap();
    assert!(whole.keypoints.len() > 100, "{}", whole.keypoints.len());

    // The origin of the cells is that of the cloud, so each size has borders at other places.
    for side in [3.0, 6.5, 9.0, 14.0, 1000.0] {
        let run = prepare(std::slice::from_ref(&scan), &options(), side, &path("tiles")).unwrap();
        assert_eq!((run.origin(), run.num_points()), (cloud.origin, (6000, 0)));
        assert_eq!(run.crs().unwrap().epsg, Some(25832));
        assert!((side > 100.0) == (run.tiles().len() < 5), "{side}: {}", run.tiles().len());
        assert_equal(&finish(&run), &whole, &format!("tiles of {side}"));
    }

    // Other processes open the run by its folder. The keypoints of its tiles, sorted, are those of the cloud.
    let run = prepare(std::slice::from_ref(&scan), &options(), 9.0, &path("shared")).unwrap();
    run.tiles().iter().for_each(|tile| run.detect(tile, &Control::default()).unwrap());
    let open = |options| {
        TiledRun::open(TileDetector::new(&Model::builtin(Builtin::Rooms), &options).unwrap(), &path("shared"))
    };
    let opened = open(options()).unwrap();
    let detected = opened.detected().unwrap();
    let of_tile = |tile| opened.keypoints(tile, &detected, &Control::default()).unwrap();
    let mut keypoints: Vec<_> = opened.tiles().iter().flat_map(of_tile).collect();
    keypoints.sort_by(|a, b| b.keypoint.saliency.total_cmp(&a.keypoint.saliency).then(a.cell.cmp(&b.cell)));
    assert_eq!(keypoints, run.finish(&Control::default()).unwrap().keypoints);
    assert!(keypoints.iter().map(|k| &k.keypoint).eq(&whole.keypoints));
    let other = options().with_window_radius(Some(4.5.into()));
    assert!(open(other).unwrap_err().to_string().contains("other options"));

    // A run that ends after some tiles goes on without the input, and repeats none of them.
    let begin = || prepare(std::slice::from_ref(&scan), &options(), 6.0, &path("interrupted")).unwrap();
    let first = begin();
    let some = first.tiles().len() / 2;
    first.tiles()[..some].iter().for_each(|tile| first.detect(tile, &Control::default()).unwrap());
    let partial = first.finish(&Control::default()).unwrap();
    assert_eq!(partial.missing, first.tiles()[some..]);
    let candidates = |path: &Path| fs::read_dir(path.join("candidates")).unwrap().count();
    assert_eq!(candidates(&path("interrupted")), some);
    let again = begin();
    assert!(again.tiles()[..some].iter().all(|tile| again.is_detected(tile)));
    assert_equal(&finish(&again), &whole, "interrupted");

    // Several files are one cloud; one that cannot be read is left out and named.
    let mut lines: Vec<String> = Vec::new();
    let mut add = |[x, y, z]: [f64; 3]| lines.push(format!("{x} {y} {z}\n"));
    for_each_position(&scan, &ReadOptions::default(), &mut add).unwrap();
    let parts = [path("a.xyz"), path("b.laz"), path("c.xyz")];
    fs::write(&parts[0], lines[..2500].concat()).unwrap();
    fs::write(&parts[1], "no scan").unwrap();
    fs::write(&parts[2], lines[2500..].concat()).unwrap();
    let run = prepare(&parts, &options(), 9.0, &path("parts")).unwrap();
    assert_eq!(run.failures().iter().map(|failure| &failure.path).collect::<Vec<_>>(), [&parts[1]]);
    assert_equal(&finish(&run), &whole, "parts");
}

#[test]
fn a_folder_of_another_run_is_cleared_and_one_with_other_files_refused() {
    let folder = tempfile::tempdir().unwrap();
    let (scan, tiles) = (folder.path().join("city.las"), folder.path().join("tiles"));
    write_city(&scan);
    let begin = |options: &Options| prepare(std::slice::from_ref(&scan), options, 8.0, &tiles);
    let run = begin(&options()).unwrap();
    run.detect(&run.tiles()[0], &Control::default()).unwrap();
    assert!(begin(&options()).unwrap().is_detected(&run.tiles()[0]));
    let mut other = options();
    other.detect.saliency_threshold = 0.5;
    assert!(!begin(&other).unwrap().is_detected(&run.tiles()[0]));
    fs::write(tiles.join("notes.txt"), "mine").unwrap();
    let error = begin(&options()).unwrap_err().to_string();
    assert!(error.contains("notes.txt"), "{error}");
}

#[test]
fn damaged_tiles_and_degrees_are_refused_with_the_reason() {
    let folder = tempfile::tempdir().unwrap();
    let (scan, tiles) = (folder.path().join("city.las"), folder.path().join("tiles"));
    write_city(&scan);
    let run = prepare(std::slice::from_ref(&scan), &options(), 8.0, &tiles).unwrap();
    let file = fs::read_dir(tiles.join("points")).unwrap().next().unwrap().unwrap().path();
    fs::write(&file, [0; 21]).unwrap();
    let errors = run.tiles().iter().filter_map(|tile| run.detect(tile, &Control::default()).err());
    assert!(errors.map(|error| error.to_string()).next().unwrap().contains("21 bytes"));

    let mut bytes = fs::read(&scan).unwrap();
    // The key 1024: projected is 1, geographic is 2.
    bytes[227 + 54 + 14] = 2;
    fs::write(&scan, bytes).unwrap();
    let error = prepare(std::slice::from_ref(&scan), &options(), 8.0, &tiles).unwrap_err().to_string();
    assert!(error.contains("degrees"), "{error}");
    for (wrong, expected) in [(0.0, "tile"), (f64::NAN, "tile"), (1e12, "tile")] {
        assert!(
            prepare(std::slice::from_ref(&scan), &options(), wrong, &tiles).unwrap_err().to_string().contains(expected)
        );
    }
}

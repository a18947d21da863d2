//! Runs in tiles give the keypoints of the whole cloud.

mod city;

use std::fs;
use std::path::{Path, PathBuf};

use snake_core::{Builtin, Control, Detection, Model, Options, TileDetector};
use snake_io::{ReadOptions, for_each_position, read_cloud};
use snake_tiles::{TiledDetection, TiledKeypoint, TiledRun};

/// Whether `make test-full` runs, which tests whole grids.
fn is_full() -> bool {
    std::env::var_os("SNAKE_FULL").is_some()
}

fn options() -> Options {
    let mut options = *Model::builtin(Builtin::Scenes).recommended();
    options.encode.voxel_size = Some(0.2.into());
    options.detect = options.detect.with_saliency_threshold(0.01).with_nms_radius(Some(0.5.into()));
    options.detect.max_keypoints = 100_000;
    options
}

fn write_city(path: &Path) {
    let mut bytes = Vec::new();
    city::write_las(&mut bytes, city::city(1, 6000)).unwrap();
    fs::write(path, bytes).unwrap();
}

fn prepare(files: &[PathBuf], options: &Options, side: f64, folder: &Path) -> snake_tiles::Result<TiledRun> {
    let detector = TileDetector::new(&Model::builtin(Builtin::Scenes), options)?;
    TiledRun::prepare(detector, files, &ReadOptions::default(), side, folder)
}

fn finish(run: &TiledRun) -> TiledDetection {
    run.tiles().iter().for_each(|tile| run.detect(tile, &Control::default()).unwrap());
    run.finish(&Control::default()).unwrap()
}

fn assert_equal(tiled: &TiledDetection, whole: &Detection, what: &str) {
    assert!(tiled.keypoints.iter().map(|k| &k.keypoint).eq(&whole.keypoints), "{what}");
    assert_eq!(tiled.counts, whole.counts, "{what}");
}

#[test]
fn tilings_an_interrupted_run_and_split_files_give_the_bits_of_the_whole_cloud() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let scan = path("city.las");
    write_city(&scan);
    let cloud = read_cloud(&scan, &ReadOptions::default()).unwrap();
    let whole = Model::builtin(Builtin::Scenes).detect(&cloud.points, &options()).unwrap();
    assert!(whole.keypoints.len() > 100, "{}", whole.keypoints.len());

    // The tiles begin at the lowest corner, so each size has borders at other places.
    for &side in if is_full() { &[3.0, 6.5, 9.0, 14.0, 1000.0][..] } else { &[6.5, 1000.0] } {
        let run = prepare(std::slice::from_ref(&scan), &options(), side, &path("tiles")).unwrap();
        assert_eq!((run.origin(), run.num_points()), (cloud.origin, (6000, 0)));
        assert_eq!(run.crs().unwrap().epsg, Some(25832));
        assert!((side > 100.0) == (run.tiles().len() == 1), "{side}: {}", run.tiles().len());
        assert_equal(&finish(&run), &whole, &format!("tiles of {side}"));
    }

    // Other processes open the run by its folder. The keypoints of its tiles, sorted, are those of the cloud.
    let run = prepare(std::slice::from_ref(&scan), &options(), 9.0, &path("shared")).unwrap();
    run.tiles().iter().for_each(|tile| run.detect(tile, &Control::default()).unwrap());
    let open = |options| {
        TiledRun::open(TileDetector::new(&Model::builtin(Builtin::Scenes), &options).unwrap(), &path("shared"))
    };
    let opened = open(options()).unwrap();
    let detected = opened.detected();
    let tile_keypoints = |tile| opened.keypoints(tile, &detected, &Control::default()).unwrap();
    let mut keypoints: Vec<_> = opened.tiles().iter().flat_map(tile_keypoints).collect();
    let by_place = |found: &TiledKeypoint| [found.cell[2], found.cell[1], found.cell[0]];
    keypoints.sort_by(|a, b| {
        b.keypoint
            .saliency
            .total_cmp(&a.keypoint.saliency)
            .then(b.start.total_cmp(&a.start))
            .then_with(|| by_place(a).cmp(&by_place(b)))
    });
    assert_eq!(keypoints, run.finish(&Control::default()).unwrap().keypoints);
    assert!(keypoints.iter().map(|k| &k.keypoint).eq(&whole.keypoints));
    let mut other = options();
    other.encode.voxel_size = Some(0.5.into());
    assert!(open(other).unwrap_err().to_string().contains("other options"));

    // A run that ends after some tiles goes on without the input, and repeats none of them.
    let begin = || prepare(std::slice::from_ref(&scan), &options(), 6.0, &path("interrupted")).unwrap();
    let first = begin();
    let some = first.tiles().len() / 2;
    first.tiles()[..some].iter().for_each(|tile| first.detect(tile, &Control::default()).unwrap());
    assert_eq!(first.detected().missing, first.tiles()[some..]);
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
    assert!(errors.map(|error| error.to_string()).next().unwrap().contains("checksum"));

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

fn write_copc(path: &Path) -> Vec<u8> {
    let mut bytes = Vec::new();
    city::copc::write_copc(&mut bytes, city::city(1, 6000), 300).unwrap();
    fs::write(path, &bytes).unwrap();
    bytes
}

#[test]
fn tiles_read_by_bounds_from_copc_give_the_bits_of_the_whole_cloud() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let scan = path("city.copc.laz");
    write_copc(&scan);
    let cloud = read_cloud(&scan, &ReadOptions::default()).unwrap();
    assert_eq!(cloud.points.len(), 6000);
    let whole = Model::builtin(Builtin::Scenes).detect(&cloud.points, &options()).unwrap();
    assert!(whole.keypoints.len() > 100, "{}", whole.keypoints.len());
    for &side in if is_full() { &[6.5, 1000.0][..] } else { &[6.5] } {
        let run = prepare(std::slice::from_ref(&scan), &options(), side, &path("tiles")).unwrap();
        assert_eq!((run.origin(), run.num_points()), (cloud.origin, (6000, 0)));
        assert_eq!(run.crs().unwrap().epsg, Some(25832));
        assert!(!path("tiles/points").exists());
        let estimated = run.tiles().iter().map(|tile| tile.num_points).sum::<u64>();
        assert!(estimated.abs_diff(6000) < 50, "{estimated}");
        assert_equal(&finish(&run), &whole, &format!("tiles of {side}"));
    }

    // A copy that is sorted into tiles has the same bits: with a file of another format all are copied.
    let empty = path("empty.xyz");
    fs::write(&empty, "").unwrap();
    let run = prepare(&[scan.clone(), empty], &options(), 9.0, &path("sorted")).unwrap();
    assert!(fs::read_dir(path("sorted/points")).unwrap().count() > 3);
    assert_equal(&finish(&run), &whole, "sorted");

    // The same run continues, and another process opens it as long as the file stays the same.
    let begin = || prepare(std::slice::from_ref(&scan), &options(), 9.0, &path("again")).unwrap();
    let run = begin();
    run.detect(&run.tiles()[0], &Control::default()).unwrap();
    assert!(begin().is_detected(&run.tiles()[0]));
    let open =
        || TiledRun::open(TileDetector::new(&Model::builtin(Builtin::Scenes), &options()).unwrap(), &path("again"));
    assert_equal(&finish(&open().unwrap()), &whole, "opened");
    let mut bytes = fs::read(&scan).unwrap();
    bytes.push(0);
    fs::write(&scan, bytes).unwrap();
    assert!(open().unwrap_err().to_string().contains("changed"));
}

#[test]
fn damaged_copc_files_are_errors() {
    let folder = tempfile::tempdir().unwrap();
    let (scan, tiles) = (folder.path().join("city.copc.laz"), folder.path().join("tiles"));
    let bytes = write_copc(&scan);
    let octree = u64::from_le_bytes(bytes[375 + 54 + 40..][..8].try_into().unwrap()) as usize;
    let outcome = |at: usize, replacement: &[u8]| -> String {
        let mut bytes = bytes.clone();
        bytes[at..at + replacement.len()].copy_from_slice(replacement);
        fs::write(&scan, bytes).unwrap();
        let source = std::sync::Arc::new(snake_io::LocalFile::new(&scan).unwrap());
        let outcome = snake_io::Copc::open(source).and_then(|file| match file {
            Some(file) => file.for_each_position_in([[-1e9; 2], [1e9; 2]], &mut |_, _| ()).map(|()| "read"),
            None => Ok("not COPC"),
        });
        outcome.map_or_else(|error| error.to_string(), Into::into)
    };
    assert_eq!(outcome(0, b"LASF"), "read");
    assert_eq!(outcome(377, b"none"), "not COPC");
    let chunk = u64::from_le_bytes(bytes[octree + 16..][..8].try_into().unwrap()) as usize;
    for (at, replacement, expected) in [
        (375 + 54 + 40, &u64::MAX.to_le_bytes()[..], "the octree is damaged"),
        (375 + 54 + 24, &f64::NAN.to_le_bytes(), "the octree is damaged"),
        (octree, &77_i32.to_le_bytes(), "the octree is damaged"),
        (octree + 28, &(-7_i32).to_le_bytes(), "the octree is damaged"),
        (octree + 28, &7_i32.to_le_bytes(), "points and the header 6000"),
        (octree + 24, &(1_i32 << 30).to_le_bytes(), "a chunk begins"),
        (octree + 24, &40_i32.to_le_bytes(), "damaged or cut short"),
        (chunk + 30, &[0; 4], "damaged or cut short"),
        (chunk, &i32::MAX.to_le_bytes(), "outside of its node"),
        (179, &691_010.0_f64.to_le_bytes(), "outside of its node"),
        (179, &f64::INFINITY.to_le_bytes(), "not finite"),
    ] {
        let text = outcome(at, replacement);
        assert!(text.contains(expected), "{expected}: {text}");
    }

    // The first page of the octree leads to itself.
    let mut page = [0; 16];
    page[..8].copy_from_slice(&(octree as u64).to_le_bytes());
    page[8..12].copy_from_slice(&(32_i32).to_le_bytes());
    page[12..].copy_from_slice(&(-1_i32).to_le_bytes());
    assert!(outcome(octree + 16, &page).contains("the octree is damaged"));

    // A tile of a damaged chunk is an error, as is the preparation if it needs all points; a damaged octree leaves the points of a LAZ file, which are sorted.
    outcome(chunk + 30, &[0; 4]);
    let error = prepare(std::slice::from_ref(&scan), &options(), 8.0, &tiles).unwrap_err().to_string();
    assert!(error.contains("city.copc.laz"), "{error}");
    let mut options = options();
    options.detect.mode_radius = Some(0.6.into());
    let run = prepare(std::slice::from_ref(&scan), &options, 8.0, &tiles).unwrap();
    let error = run.detect(&run.tiles()[0], &Control::default()).unwrap_err().to_string();
    assert!(error.contains("city.copc.laz"), "{error}");
    outcome(octree, &77_i32.to_le_bytes());
    let run = prepare(std::slice::from_ref(&scan), &options, 8.0, &tiles).unwrap();
    assert!(fs::read_dir(tiles.join("points")).unwrap().count() > 3);
    assert_eq!(run.num_points().0, 6000);
}

#[test]
fn damaged_candidates_are_found_again() {
    let folder = tempfile::tempdir().unwrap();
    let (scan, tiles) = (folder.path().join("city.las"), folder.path().join("tiles"));
    write_city(&scan);
    let run = prepare(std::slice::from_ref(&scan), &options(), 8.0, &tiles).unwrap();
    let whole = finish(&run);
    let path = |tile: &snake_tiles::Tile| {
        tiles.join("candidates").join(format!("{}_{}.safetensors", tile.place[0], tile.place[1]))
    };
    let bytes = fs::read(path(&run.tiles()[1])).unwrap();
    for damaged in [&b""[..], b"damaged", &bytes[..bytes.len() - 1], &[&bytes[..], b"x"].concat()] {
        fs::write(path(&run.tiles()[1]), damaged).unwrap();
        assert!(!run.is_detected(&run.tiles()[1]));
        assert_eq!(run.detected().missing, run.tiles()[1..2]);
        assert_eq!(finish(&run), whole);
    }
}

//! Runs in tiles give the keypoints of the whole cloud, and lose neither files of others in their folder nor keypoints.

use std::fs;
use std::path::{Path, PathBuf};

use snake_core::{Builtin, Control, Detection, Length, Model, Options, TileDetector};
use snake_io::{ReadOptions, for_each_position, read_cloud};
use snake_tiles::{Error, Result, TiledDetection, TiledKeypoint, TiledRun};

/// Whether `make test-full` runs, which tests whole grids.
fn is_full() -> bool {
    std::env::var_os("SNAKE_FULL").is_some()
}

fn options() -> Options {
    let mut options = *Model::builtin(Builtin::Scenes).recommended();
    options.encode.voxel_size = Some(0.4.into());
    options.detect = options.detect.with_saliency_threshold(0.01).with_nms_radius(Some(0.5.into()));
    (options.detect.max_keypoints, options.detect.min_confidence) = (100_000, Some(0.1));
    options
}

/// A COPC file of copclib: 12 000 points on 40 by 40 m, with UTM 32N as coordinate reference system.
const CITY: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/data/tiles/city.copc.laz");

/// The lines of every `step`-th point of the city.
fn lines(step: usize) -> Vec<String> {
    let mut lines = Vec::new();
    let mut add = |[x, y, z]: [f64; 3]| lines.push(format!("{x} {y} {z}\n"));
    for_each_position(CITY.as_ref(), &ReadOptions::default(), &mut add).unwrap();
    lines.into_iter().step_by(step).collect()
}

/// A scan of the city in a new folder.
fn scan(step: usize) -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let scan = folder.path().join("city.xyz");
    fs::write(&scan, lines(step).concat()).unwrap();
    (folder, scan)
}

fn detector(options: &Options) -> TileDetector {
    TileDetector::new(&Model::builtin(Builtin::Scenes), options).unwrap()
}

fn prepare(files: &[&Path], options: &Options, side: f64, folder: &Path) -> Result<TiledRun> {
    let files: Vec<PathBuf> = files.iter().map(|&file| file.to_owned()).collect();
    TiledRun::prepare(detector(options), &files, &ReadOptions::default(), side, folder)
}

fn begin(scan: &Path, folder: &Path) -> Result<TiledRun> {
    prepare(&[scan], &options(), 13.0, folder)
}

fn finish(run: &TiledRun) -> TiledDetection {
    run.tiles().iter().for_each(|tile| run.detect(tile, &Control::default()).unwrap());
    run.finish(&Control::default()).unwrap()
}

fn assert_equal(tiled: &TiledDetection, whole: &Detection, what: &str) {
    assert!(tiled.keypoints.iter().map(|k| &k.keypoint).eq(&whole.keypoints), "{what}");
    assert_eq!(tiled.counts, whole.counts, "{what}");
}

/// Asserts that a run is refused, and that a fault of the folder comes with what to do.
fn assert_refused(outcome: Result<TiledRun>, expected: &str) {
    let text = outcome.unwrap_err().to_string();
    assert!(text.contains(expected), "{expected}: {text}");
    assert!(!text.contains("the folder of the tiles") || text.contains("name a `folder` that is new"), "{text}");
}

#[test]
fn tilings_an_interrupted_run_and_split_files_give_the_bits_of_the_whole_cloud() {
    let (folder, scan) = scan(1);
    let (path, options) = (|name: &str| folder.path().join(name), options());
    let cloud = read_cloud(&scan, &ReadOptions::default()).unwrap();
    let whole = Model::builtin(Builtin::Scenes).detect(&cloud.points, &options).unwrap();
    assert!(whole.keypoints.len() > 100, "{}", whole.keypoints.len());

    // The tiles begin at the lowest corner, so each size has borders at other places.
    for &side in if is_full() { &[6.5, 13.0, 20.0, 28.0, 1000.0][..] } else { &[13.0] } {
        let run = prepare(&[&scan], &options, side, &path(&format!("tiles{side}"))).unwrap();
        assert_eq!((run.origin(), run.num_points()), (cloud.origin, (12_000, 0)));
        assert!((side > 100.0) == (run.tiles().len() == 1), "{side}: {}", run.tiles().len());
        assert_equal(&finish(&run), &whole, &format!("tiles of {side}"));
    }

    // Chains of candidates and of modes reach over several tiles: a detector asks for wider margins.
    for (mode_radius, side) in [(Length::Resolutions(3.5), 20.0), (Length::Voxels(9.0), 13.0)] {
        let mut options = options;
        options.detect.mode_radius = Some(mode_radius);
        let whole = Model::builtin(Builtin::Scenes).detect(&cloud.points, &options).unwrap();
        let run = prepare(&[&scan], &options, side, &path(&format!("modes{side}"))).unwrap();
        assert_equal(&finish(&run), &whole, &format!("modes of {mode_radius}"));
    }

    // A run that ends after some tiles goes on, and repeats none of them.
    let first = prepare(&[&scan], &options, 20.0, &path("shared")).unwrap();
    let some = first.tiles().len() / 2;
    first.tiles()[..some].iter().for_each(|tile| first.detect(tile, &Control::default()).unwrap());
    let error = first.finish(&Control::default()).unwrap_err().to_string();
    assert!(error.starts_with(&format!("{} of {} tiles are missing", first.tiles().len() - some, first.tiles().len())));
    let detected = first.detected().unwrap();
    assert_eq!(detected.missing, first.tiles()[some..]);
    assert!(!first.finish_detected(&detected, &Control::default()).unwrap().keypoints.is_empty());
    let place = first.tiles()[0].place;
    let candidates = path(&format!("shared/candidates/{}_{}.safetensors", place[0], place[1]));
    let before = candidates.metadata().unwrap().modified().unwrap();
    let again = prepare(&[&scan], &options, 20.0, &path("shared")).unwrap();
    assert!(again.tiles()[..some].iter().all(|tile| again.is_detected(tile)));
    assert_equal(&finish(&again), &whole, "interrupted");
    assert_eq!(candidates.metadata().unwrap().modified().unwrap(), before);

    // Other processes open the run by its folder. The keypoints of its tiles, sorted, are those of the cloud.
    let opened = TiledRun::open(detector(&options), &path("shared")).unwrap();
    let detected = opened.detected().unwrap();
    let tile_keypoints = |tile| opened.keypoints(tile, &detected, &Control::default()).unwrap();
    let mut keypoints: Vec<_> = opened.tiles().iter().flat_map(tile_keypoints).collect();
    let cell = |found: &TiledKeypoint| [found.cell[2], found.cell[1], found.cell[0]];
    keypoints.sort_by(|a, b| {
        let by_rank = b.rank.total_cmp(&a.rank);
        by_rank.then(b.start.total_cmp(&a.start)).then_with(|| cell(a).cmp(&cell(b)))
    });
    assert!(keypoints.iter().map(|k| &k.keypoint).eq(&whole.keypoints));
    let mut other = options;
    other.encode.voxel_size = Some(0.5.into());
    assert_refused(TiledRun::open(detector(&other), &path("shared")), "other inputs, options");

    // Several files are one cloud; one that cannot be read is left out and named.
    let lines = lines(1);
    let parts = [("a.xyz", lines[..5000].concat()), ("b.laz", "no scan".into()), ("c.xyz", lines[5000..].concat())];
    let parts = parts.map(|(name, text)| fs::write(path(name), text).map(|()| path(name)).unwrap());
    let run = prepare(&parts.each_ref().map(|part| &**part), &options, 1000.0, &path("parts")).unwrap();
    assert_eq!(run.failures().iter().map(|failure| &failure.path).collect::<Vec<_>>(), [&parts[1]]);
    assert_equal(&finish(&run), &whole, "parts");
}

#[test]
fn tiles_read_by_bounds_from_copc_give_the_bits_of_the_whole_cloud() {
    let folder = tempfile::tempdir().unwrap();
    let (path, options) = (|name: &str| folder.path().join(name), options());
    let scan = path("city.copc.laz");
    let mut bytes = fs::read(CITY).unwrap();
    fs::write(&scan, &bytes).unwrap();
    let cloud = read_cloud(&scan, &ReadOptions::default()).unwrap();
    let whole = Model::builtin(Builtin::Scenes).detect(&cloud.points, &options).unwrap();
    assert!(whole.keypoints.len() > 100, "{}", whole.keypoints.len());
    for &side in if is_full() { &[13.0, 20.0, 1000.0][..] } else { &[20.0] } {
        let run = prepare(&[&scan], &options, side, &path(&format!("tiles{side}"))).unwrap();
        assert_eq!((run.origin(), run.num_points()), (cloud.origin, (12_000, 0)));
        assert_eq!(run.crs().unwrap().epsg, Some(25832));
        assert!(!run.folder().join("points").exists());
        let estimated = run.tiles().iter().map(|tile| tile.num_points).sum::<u64>();
        assert!(estimated.abs_diff(12_000) < 50, "{estimated}");
        assert_equal(&finish(&run), &whole, &format!("tiles of {side}"));
    }

    // A copy that is sorted into tiles has the same bits: with a file of another format all are copied.
    fs::write(path("empty.xyz"), "").unwrap();
    let run = prepare(&[&scan, &path("empty.xyz")], &options, 20.0, &path("sorted")).unwrap();
    assert!(fs::read_dir(path("sorted/points")).unwrap().count() > 3 && run.crs().unwrap().epsg == Some(25832));
    assert_equal(&finish(&run), &whole, "sorted");

    // The same run continues, and another process opens it as long as the file stays the same.
    let begin = || prepare(&[&scan], &options, 20.0, &path("tiles20"));
    assert!(begin().unwrap().tiles().iter().all(|tile| begin().unwrap().is_detected(tile)));
    let open = || TiledRun::open(detector(&options), &path("tiles20"));
    assert_equal(&open().unwrap().finish(&Control::default()).unwrap(), &whole, "opened");
    // The name of the program that wrote the file: its size stays the same, and its time.
    let time = scan.metadata().unwrap().modified().unwrap();
    bytes[60] ^= 1;
    fs::write(&scan, &bytes).unwrap();
    assert_refused(open(), "other inputs");
    fs::File::options().append(true).open(&scan).unwrap().set_modified(time).unwrap();
    assert_refused(begin(), "other inputs");

    let name = bytes.windows(6).position(|text| text == b"PROJCS").unwrap();
    bytes[name..name + 6].copy_from_slice(b"GEOGCS");
    fs::write(&scan, &bytes).unwrap();
    assert_refused(prepare(&[&scan], &options, 20.0, &path("new")), "degrees");
    assert_refused(prepare(&[&scan, &path("empty.xyz")], &options, 20.0, &path("new")), "degrees");
    // A tile of a damaged chunk is an error, as is the preparation if it needs all points. A damaged octree leaves the points of
    // a LAZ file, which are sorted.
    bytes = fs::read(CITY).unwrap();
    let number = |bytes: &[u8], at: usize| u64::from_le_bytes(bytes[at..at + 8].try_into().unwrap()) as usize;
    let octree = number(&bytes, 375 + 54 + 40);
    let chunk = number(&bytes, octree + 16) + 30;
    bytes[chunk..chunk + 4].fill(0);
    fs::write(&scan, &bytes).unwrap();
    assert_refused(prepare(&[&scan], &options, 20.0, &path("new")), "city.copc.laz");
    assert!(!path("new").exists());
    let mut options = options;
    options.detect.mode_radius = Some(0.6.into());
    let run = prepare(&[&scan], &options, 20.0, &path("new")).unwrap();
    let error = run.detect(&run.tiles()[0], &Control::default()).unwrap_err().to_string();
    assert!(error.contains("city.copc.laz"), "{error}");
    bytes = fs::read(CITY).unwrap();
    bytes[octree] = 77;
    fs::write(&scan, &bytes).unwrap();
    let run = prepare(&[&scan], &options, 20.0, &path("octree")).unwrap();
    assert!(run.folder().join("points").exists() && run.num_points().0 == 12_000);
}

/// All files below a folder with their contents, links by their targets.
fn content(folder: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let mut contents = Vec::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_symlink() {
            contents.push((path.clone(), fs::read_link(&path).unwrap().into_os_string().into_encoded_bytes()));
        } else if path.is_dir() {
            contents.extend(content(&path));
        } else {
            contents.push((path.clone(), fs::read(&path).unwrap()));
        }
    }
    contents.sort();
    contents
}

#[test]
fn folders_of_others_are_refused_and_only_files_of_the_run_removed() {
    let (folder, scan) = scan(6);
    let path = |name: &str| folder.path().join(name);
    for (number, name) in
        ["points/0_0.bin", "candidates/0_0.safetensors", "plan.json", "deep/er/mine.txt"].iter().enumerate()
    {
        let own = path(&number.to_string());
        fs::create_dir_all(own.join(name).parent().unwrap()).unwrap();
        fs::write(own.join(name), "mine").unwrap();
        assert_refused(begin(&scan, &own), &format!("has `{}`", name.split('/').next().unwrap()));
        assert_eq!(content(&own), [(own.join(name), b"mine".to_vec())]);
    }
    fs::write(path("file"), "mine").unwrap();
    assert!(matches!(begin(&scan, &path("file")), Err(Error::Core(_))));
    assert_eq!(fs::read(path("file")).unwrap(), b"mine");

    // What others write into the folder of a run stays, and so does a folder that was there before.
    for is_made in [true, false] {
        let tiles = path(&format!("{is_made}"));
        if !is_made {
            fs::create_dir(&tiles).unwrap();
        }
        let run = begin(&scan, &tiles).unwrap();
        run.detect(&run.tiles()[0], &Control::default()).unwrap();
        let others = ["candidates/notes.txt", "notes.txt", "points/1.bin"].map(|name| tiles.join(name));
        others.iter().for_each(|path| fs::write(path, "mine").unwrap());
        let mut left = run.remove().unwrap();
        left.sort();
        assert_eq!(left.iter().map(|name| tiles.join(name)).collect::<Vec<_>>(), others);
        assert_eq!(content(&tiles), others.each_ref().map(|path| (path.clone(), b"mine".to_vec())));
        fs::remove_dir_all(&tiles).unwrap();
        if !is_made {
            fs::create_dir(&tiles).unwrap();
        }
        assert!(begin(&scan, &tiles).unwrap().remove().unwrap().is_empty());
        assert_eq!(tiles.exists(), !is_made);
    }
}

#[cfg(unix)]
#[test]
fn links_in_the_folder_of_a_run_are_neither_followed_nor_removed() {
    use std::os::unix::fs::symlink;
    let (folder, scan) = scan(6);
    let (tiles, real) = (folder.path().join("tiles"), folder.path().join("real"));
    fs::create_dir(&real).unwrap();
    let run = begin(&scan, &tiles).unwrap();
    for name in ["points", "candidates"] {
        fs::write(real.join("0_0.bin"), "mine").unwrap();
        fs::write(real.join("0_0.safetensors"), "mine").unwrap();
        fs::remove_dir_all(tiles.join(name)).unwrap_or_default();
        symlink(&real, tiles.join(name)).unwrap();
        assert!(run.detect(&run.tiles()[0], &Control::default()).is_err());
        fs::remove_file(tiles.join("plan.json")).unwrap_or_default();
        assert_eq!(begin(&scan, &tiles).is_err(), name == "points");
        if name == "points" {
            fs::remove_file(tiles.join(name)).unwrap();
            begin(&scan, &tiles).unwrap();
        }
    }
    assert_eq!(run.remove().unwrap(), [Path::new("candidates")]);
    assert_eq!(content(&real), ["0_0.bin", "0_0.safetensors"].map(|name| (real.join(name), b"mine".to_vec())));
    assert!(tiles.join("candidates").is_symlink());
}

#[test]
fn another_run_is_refused_and_mistakes_leave_nothing() {
    let (folder, scan) = scan(6);
    let tiles = folder.path().join("tiles");
    let run = begin(&scan, &tiles).unwrap();
    let before = finish(&run);
    let mut other = options();
    other.detect.saliency_threshold = 0.5;
    assert_refused(prepare(&[&scan], &other, 9.0, &tiles), "other inputs, options or weights");
    assert_refused(prepare(&[&scan], &options(), 30.0, &tiles), "other inputs, options or weights");
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../snake-core/models/scenes.safetensors");
    let mut weights = fs::read(file).unwrap();
    let last = weights.len() - 2;
    weights[last] ^= 0x30;
    let detector = TileDetector::new(&Model::from_bytes(&weights).unwrap(), &options()).unwrap();
    let outcome = TiledRun::prepare(detector, std::slice::from_ref(&scan), &ReadOptions::default(), 13.0, &tiles);
    assert_refused(outcome, "other inputs, options or weights");

    // Another cloud of the same name, size and time.
    let (mut bytes, time) = (fs::read(&scan).unwrap(), scan.metadata().unwrap().modified().unwrap());
    let last = bytes.len() - 2;
    bytes[last] ^= 1;
    fs::write(&scan, &bytes).unwrap();
    fs::File::options().append(true).open(&scan).unwrap().set_modified(time).unwrap();
    assert_refused(begin(&scan, &tiles), "other inputs, options or weights");
    bytes[last] ^= 1;
    fs::write(&scan, &bytes).unwrap();
    assert_eq!(finish(&begin(&scan, &tiles).unwrap()), before);

    let new = folder.path().join("new");
    let single = folder.path().join("single.xyz");
    fs::write(&single, "0 0 0\n").unwrap();
    assert_refused(begin(&single, &new), "two different points");
    fs::write(&single, "0 0 0\n1 1 1\n9e9 0 0\n").unwrap();
    assert_refused(begin(&single, &new), "voxel_size");
    for wrong in [0.0, f64::NAN, 1e12] {
        assert_refused(prepare(&[&scan], &options(), wrong, &new), "tile");
    }
    assert!(!new.exists());
}

#[test]
fn a_killed_run_continues_and_a_damaged_file_is_an_error() {
    let (_folder, scan) = scan(6);
    let tiles = scan.with_file_name("tiles");
    let run = begin(&scan, &tiles).unwrap();
    let keypoints = finish(&run);
    let path = |start: &str| {
        let mut all = content(&tiles).into_iter().map(|(path, _)| path);
        all.find(|path| path.strip_prefix(&tiles).unwrap().to_string_lossy().starts_with(start)).unwrap()
    };
    // What is there when a run is killed: the marker, a part of the points, a part of a file before it gets its name.
    for kept in [0, 1000, 1_000_000] {
        let (points, plan) = (path("points"), tiles.join("plan.json"));
        let bytes = fs::read(&points).unwrap();
        fs::write(&points, &bytes[..bytes.len().min(kept)]).unwrap();
        fs::write(tiles.join(".snake-rs.9-0.part"), fs::read(&plan).unwrap()).unwrap();
        fs::remove_file(plan).unwrap();
        fs::remove_file(path("candidates")).unwrap();
        assert_eq!(finish(&begin(&scan, &tiles).unwrap()), keypoints, "{kept}");
        assert!(fs::read(points).unwrap() == bytes);
    }
    for start in ["candidates", "points", "plan.json"] {
        let file = path(start);
        let bytes = fs::read(&file).unwrap();
        let half = bytes.len() / 2;
        let zeros = [&bytes[..half], &vec![0; bytes.len() - half][..]].concat();
        for damaged in [&b""[..], b"damaged", &bytes[..half], &[&bytes[..], b"x"].concat(), &zeros] {
            fs::write(&file, damaged).unwrap();
            let outcome = begin(&scan, &tiles).and_then(|run| run.finish(&Control::default()));
            // Points have no mark at the end: all of them are there or not.
            if start != "points" || damaged.len() != bytes.len() {
                let Err(error) = outcome else { panic!("{start}, {} bytes", damaged.len()) };
                assert!(matches!(error, Error::Damaged { .. }) && error.to_string().contains("remove"), "{error}");
            }
        }
        fs::write(&file, bytes).unwrap();
    }
    assert_eq!(run.finish(&Control::default()).unwrap(), keypoints);
    assert!(run.remove().unwrap().is_empty() && !tiles.exists());
}

#[test]
fn two_runs_in_one_folder_write_the_same_and_one_that_is_removed_ends() {
    let (_folder, scan) = scan(6);
    let tiles = scan.with_file_name("tiles");
    let one = || finish(&begin(&scan, &tiles).unwrap());
    let keypoints = std::thread::scope(|scope| {
        let runs = [scope.spawn(one), scope.spawn(one), scope.spawn(one)];
        let [first, second, third] = runs.map(|run| run.join().unwrap());
        assert!(first == second && second == third);
        first
    });
    let (run, other) = (begin(&scan, &tiles).unwrap(), begin(&scan, &tiles).unwrap());
    assert_eq!(finish(&run), keypoints);
    assert!(run.remove().unwrap().is_empty() && !tiles.exists());
    let error = other.detected().unwrap_err().to_string();
    assert!(error.contains("no longer there"), "{error}");
    assert!(other.detect(&other.tiles()[0], &Control::default()).is_err() && !tiles.exists());
}

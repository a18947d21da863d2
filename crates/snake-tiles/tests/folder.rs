//! A run loses nothing: neither files of others in its folder nor its own keypoints when stored files are damaged.

mod city;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use snake_core::{Builtin, Control, Model, Options, TileDetector};
use snake_io::ReadOptions;
use snake_tiles::{Error, TiledKeypoint, TiledRun};

fn options() -> Options {
    let mut options = *Model::builtin(Builtin::Scenes).recommended();
    options.encode.voxel_size = Some(0.4.into());
    options.detect = options.detect.with_saliency_threshold(0.01).with_nms_radius(Some(0.5.into()));
    options.detect.max_keypoints = 100_000;
    options
}

/// A scan in a folder, and a place for its tiles.
fn scan() -> (tempfile::TempDir, PathBuf, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let (scan, tiles) = (folder.path().join("city.las"), folder.path().join("tiles"));
    let mut bytes = Vec::new();
    city::write_las(&mut bytes, city::city(1, 2000)).unwrap();
    fs::write(&scan, bytes).unwrap();
    (folder, scan, tiles)
}

fn prepare_with(model: &Model, scan: &Path, options: &Options, tiles: &Path) -> snake_tiles::Result<TiledRun> {
    TiledRun::prepare(TileDetector::new(model, options)?, &[scan.into()], &ReadOptions::default(), 9.0, tiles)
}

fn prepare(scan: &Path, tiles: &Path) -> snake_tiles::Result<TiledRun> {
    prepare_with(&Model::builtin(Builtin::Scenes), scan, &options(), tiles)
}

fn finish(run: &TiledRun) -> Vec<TiledKeypoint> {
    run.tiles().iter().for_each(|tile| run.detect(tile, &Control::default()).unwrap());
    let keypoints = run.finish(&Control::default()).unwrap().keypoints;
    assert!(keypoints.len() > 10);
    keypoints
}

/// All files below a folder with their contents, links by their targets.
fn content(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut contents = BTreeMap::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_symlink() {
            contents.insert(path.clone(), fs::read_link(&path).unwrap().into_os_string().into_encoded_bytes());
        } else if path.is_dir() {
            contents.insert(path.clone(), Vec::new());
            contents.extend(content(&path));
        } else {
            contents.insert(path.clone(), fs::read(&path).unwrap());
        }
    }
    contents
}

#[test]
fn a_folder_that_no_run_made_is_refused_and_stays_as_it_is() {
    let (folder, scan, _) = scan();
    let others = [
        "points/a.npy",
        "points/0_0.bin",
        "candidates/0_0.safetensors",
        "inputs/mine.txt",
        "plan.json",
        "deep/er/mine.txt",
        "snake-tiles.run",
    ];
    for (number, name) in others.into_iter().enumerate() {
        let own = folder.path().join(number.to_string());
        let file = own.join(name);
        fs::create_dir_all(file.parent().unwrap()).unwrap();
        fs::write(&file, "mine").unwrap();
        let before = content(&own);
        let error = prepare(&scan, &own).unwrap_err().to_string();
        let first = name.split('/').next().unwrap();
        assert!(error.contains(first) && error.contains("`folder`"), "{error}");
        assert_eq!(content(&own), before, "{name}");
    }
    // An empty folder of that name is not the run's either.
    let own = folder.path().join("empty");
    fs::create_dir_all(own.join("points")).unwrap();
    assert!(prepare(&scan, &own).unwrap_err().to_string().contains("points"));
    let file = folder.path().join("file");
    fs::write(&file, "mine").unwrap();
    assert!(matches!(prepare(&scan, &file), Err(Error::File { .. })));
    assert_eq!(fs::read(&file).unwrap(), b"mine");
}

#[cfg(unix)]
#[test]
fn links_are_neither_followed_nor_removed() {
    use std::os::unix::fs::symlink;
    let (folder, scan, tiles) = scan();
    let real = folder.path().join("real");
    fs::create_dir(&real).unwrap();
    fs::write(real.join("0_0.bin"), "mine").unwrap();
    let before = content(&real);
    let link = folder.path().join("linked");
    fs::create_dir(&link).unwrap();
    symlink(&real, link.join("points")).unwrap();
    assert!(prepare(&scan, &link).is_err());
    assert_eq!(content(&real), before);

    // In the folder of a run a link takes the place of a file or a folder: nothing behind it changes.
    let mut other = options();
    other.detect.saliency_threshold = 0.02;
    let scenes = Model::builtin(Builtin::Scenes);
    let run = prepare(&scan, &tiles).unwrap();
    let keypoints = finish(&run);
    for name in ["points", "candidates"] {
        let (path, kept) = (tiles.join(name), folder.path().join("kept"));
        fs::rename(&path, &kept).unwrap();
        symlink(&real, &path).unwrap();
        let errors = [prepare_with(&scenes, &scan, &other, &tiles).err(), prepare(&scan, &tiles).err()];
        assert!(errors.iter().filter(|error| matches!(error, Some(Error::Refused { .. }))).count() > 0, "{errors:?}");
        fs::remove_file(&path).unwrap();
        fs::rename(&kept, &path).unwrap();
        assert_eq!(content(&real), before, "{name}");
    }
    let candidates = fs::read_dir(tiles.join("candidates")).unwrap().next().unwrap().unwrap().path();
    fs::remove_file(&candidates).unwrap();
    symlink(real.join("0_0.bin"), &candidates).unwrap();
    let open = run.tiles().iter().find(|tile| !run.is_detected(tile)).unwrap();
    assert!(matches!(run.detect(open, &Control::default()), Err(Error::Refused { .. })));
    assert!(prepare_with(&scenes, &scan, &other, &tiles).unwrap_err().to_string().contains("candidates"));
    assert_eq!(content(&real), before);
    fs::remove_file(&candidates).unwrap();
    assert_eq!(finish(&run), keypoints);

    // The folder has several names. It was there before the run, so that it stays.
    let (there, name) = (folder.path().join("there"), folder.path().join("name"));
    fs::create_dir(&there).unwrap();
    symlink(&there, &name).unwrap();
    let run = prepare(&scan, &name).unwrap();
    assert_eq!(finish(&run), keypoints);
    assert!(prepare(&scan, &there.join("../there/.")).unwrap().is_detected(&run.tiles()[0]));
    assert!(run.remove().unwrap().is_empty());
    assert!(content(&there).is_empty() && name.is_symlink());
}

#[test]
fn only_files_of_the_run_are_removed() {
    let (_folder, scan, tiles) = scan();
    let run = prepare(&scan, &tiles).unwrap();
    finish(&run);
    let others = [tiles.join("candidates/notes.txt"), tiles.join("notes.txt"), tiles.join("points/1.bin")];
    others.iter().for_each(|path| fs::write(path, "mine").unwrap());
    let left = run.remove().unwrap();
    assert_eq!(left.len(), 3, "{left:?}");
    let left = content(&tiles);
    assert_eq!(left.len(), 5, "{left:?}");
    assert!(others.iter().all(|path| left[path] == b"mine"));

    others.iter().for_each(|path| fs::remove_file(path).unwrap());
    fs::remove_dir_all(&tiles).unwrap();
    assert!(prepare(&scan, &tiles).unwrap().remove().unwrap().is_empty());
    assert!(!tiles.exists());
}

/// What damage does to a file, or takes it away.
fn damages(bytes: &[u8]) -> Vec<Option<Vec<u8>>> {
    let flipped = |at: usize| {
        let mut bytes = bytes.to_vec();
        bytes[at] ^= 0x10;
        bytes
    };
    let number = bytes.len();
    let mut damaged: Vec<_> = (0..4).map(|part| Some(flipped((number - 1) * part / 3))).collect();
    let half = number / 2;
    let zeros = [&bytes[..half], &vec![0; number - half][..]].concat();
    damaged.extend([Some(zeros), Some(vec![0; number]), Some(Vec::new()), Some(bytes[..half].to_vec()), None]);
    damaged.push(Some([bytes, b"x"].concat()));
    damaged
}

#[test]
fn damage_in_any_stored_file_is_mended() {
    let (_folder, scan, tiles) = scan();
    let keypoints = finish(&prepare(&scan, &tiles).unwrap());
    let files: Vec<PathBuf> = content(&tiles).into_keys().filter(|path| path.is_file()).collect();
    let of = |part: &str| files.iter().find(|path| path.to_string_lossy().contains(part)).unwrap();
    for file in [of("candidates/"), of("points/"), of("plan.json"), of("snake-tiles.run"), of("snake-tiles.lock")] {
        let bytes = fs::read(file).unwrap();
        for (number, damage) in damages(if bytes.is_empty() { b"\0" } else { &bytes }).into_iter().enumerate() {
            match damage {
                Some(damaged) => fs::write(file, damaged).unwrap(),
                None => fs::remove_file(file).unwrap(),
            }
            let run = prepare(&scan, &tiles).unwrap_or_else(|error| panic!("{number} of {}: {error}", file.display()));
            assert_eq!(finish(&run), keypoints, "{number} of {}", file.display());
        }
    }
    assert!(prepare(&scan, &tiles).unwrap().remove().unwrap().is_empty());
}

#[test]
fn damage_during_a_run_is_an_error() {
    let (_folder, scan, tiles) = scan();
    let run = prepare(&scan, &tiles).unwrap();
    let keypoints = finish(&run);
    for name in ["candidates", "points"] {
        let file = fs::read_dir(tiles.join(name)).unwrap().next().unwrap().unwrap().path();
        let bytes = fs::read(&file).unwrap();
        for damage in damages(&bytes) {
            match damage {
                Some(damaged) => fs::write(&file, damaged).unwrap(),
                None => fs::remove_file(&file).unwrap(),
            }
            let error = run.finish(&Control::default()).unwrap_err();
            assert!(matches!(error, Error::Missing { .. } | Error::Damaged { .. } | Error::File { .. }), "{error}");
        }
        fs::write(&file, bytes).unwrap();
        assert_eq!(run.finish(&Control::default()).unwrap().keypoints, keypoints);
    }
}

#[test]
fn other_weights_and_other_inputs_of_the_same_metadata_begin_anew() {
    let (folder, scan, tiles) = scan();
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../snake-core/models/scenes.safetensors");
    let mut bytes = fs::read(file).unwrap();
    let first = Model::from_bytes(&bytes).unwrap();
    let last = bytes.len() - 2;
    bytes[last] ^= 0x30;
    let second = Model::from_bytes(&bytes).unwrap();
    let begin = |model: &Model| prepare_with(model, &scan, &options(), &tiles).unwrap();
    let run = begin(&first);
    finish(&run);
    assert!(begin(&first).is_detected(&run.tiles()[0]));
    assert!(!begin(&second).is_detected(&run.tiles()[0]));
    // The first run is no longer at home there: it neither takes the files of the second for its own nor replaces them.
    let error = run.detect(&run.tiles()[0], &Control::default()).unwrap_err().to_string();
    assert!(error.contains("another run"), "{error}");

    let before = finish(&begin(&first));
    let mut bytes = fs::read(&scan).unwrap();
    let time = scan.metadata().unwrap().modified().unwrap();
    let last = bytes.len() - 8;
    bytes[last] ^= 1;
    fs::write(&scan, &bytes).unwrap();
    fs::File::options().append(true).open(&scan).unwrap().set_modified(time).unwrap();
    let changed = begin(&first);
    assert!(!changed.tiles().iter().any(|tile| changed.is_detected(tile)));
    bytes[last] ^= 1;
    fs::write(&scan, &bytes).unwrap();
    assert_eq!(finish(&begin(&first)), before);

    // A mistake in the inputs is told before anything is removed.
    let broken = folder.path().join("broken.las");
    fs::write(&broken, "no scan").unwrap();
    assert!(prepare_with(&first, &broken, &options(), &tiles).is_err());
    assert!(begin(&first).is_detected(&run.tiles()[0]));
}

#[test]
fn a_copc_file_that_was_replaced_begins_anew() {
    let (folder, _, tiles) = scan();
    let scan = folder.path().join("city.copc.laz");
    let mut bytes = Vec::new();
    city::copc::write_copc(&mut bytes, city::city(1, 2000), 300).unwrap();
    fs::write(&scan, &bytes).unwrap();
    let run = prepare(&scan, &tiles).unwrap();
    let keypoints = finish(&run);
    let time = scan.metadata().unwrap().modified().unwrap();
    assert!(prepare(&scan, &tiles).unwrap().is_detected(&run.tiles()[0]));
    // The name of the program that wrote the file.
    bytes[60] ^= 1;
    fs::write(&scan, &bytes).unwrap();
    fs::File::options().append(true).open(&scan).unwrap().set_modified(time).unwrap();
    let again = prepare(&scan, &tiles).unwrap();
    assert!(!again.is_detected(&run.tiles()[0]));
    assert_eq!(finish(&again), keypoints);
}

#[test]
fn a_run_that_was_killed_at_any_point_of_its_preparation_continues() {
    let (_folder, scan, tiles) = scan();
    let keypoints = finish(&prepare(&scan, &tiles).unwrap());
    let all = content(&tiles);
    let restore = |is_there: &dyn Fn(&str) -> bool| {
        fs::remove_dir_all(&tiles).unwrap();
        fs::create_dir(&tiles).unwrap();
        for (path, bytes) in &all {
            let name = path.strip_prefix(&tiles).unwrap().to_string_lossy().replace('\\', "/");
            if bytes.is_empty() && !name.contains('.') {
                fs::create_dir_all(path).unwrap();
            } else if is_there(&name) {
                fs::create_dir_all(path.parent().unwrap()).unwrap();
                fs::write(path, bytes).unwrap();
            }
        }
        // What a killed process leaves of the file that it was about to rename.
        fs::write(tiles.join(".snake-rs.Ab12Cd.part"), "{\"sou").unwrap();
    };
    let lock = |name: &str| name == "snake-tiles.lock";
    let marker = |name: &str| lock(name) || name == "snake-tiles.run";
    let points = |name: &str| marker(name) || name.starts_with("points");
    for is_there in [&marker as &dyn Fn(&str) -> bool, &points, &|_| true] {
        restore(is_there);
        let run = prepare(&scan, &tiles).unwrap();
        assert_eq!(finish(&run), keypoints);
        assert!(run.remove().unwrap().is_empty() && !tiles.exists());
        fs::create_dir(&tiles).unwrap();
    }
    fs::write(tiles.join("snake-tiles.lock"), "").unwrap();
    fs::write(tiles.join(".snake-rs.Ab12Cd.part"), "").unwrap();
    assert_eq!(finish(&prepare(&scan, &tiles).unwrap()), keypoints);
    // A part of a line at the end of the marker.
    let path = tiles.join("snake-tiles.run");
    let text = fs::read(&path).unwrap();
    fs::write(&path, &text[..text.len() - 9]).unwrap();
    let run = prepare(&scan, &tiles).unwrap();
    assert_eq!(finish(&run), keypoints);
    assert!(run.remove().unwrap().is_empty());
}

#[test]
fn a_lock_names_its_process_and_a_dead_one_is_no_obstacle() {
    let (_folder, scan, tiles) = scan();
    let run = prepare(&scan, &tiles).unwrap();
    let lock = tiles.join("snake-tiles.lock");
    let holder = fs::read_to_string(&lock).unwrap();
    assert_eq!(holder.lines().next(), Some(&*std::process::id().to_string()));
    // Runs of the same process share it.
    drop(prepare(&scan, &tiles).unwrap());
    assert_eq!(fs::read_to_string(&lock).unwrap(), holder);
    drop(run);
    assert_eq!(fs::read_to_string(&lock).unwrap(), "");

    let mut lines: Vec<&str> = holder.lines().collect();
    lines[0] = "4194999";
    fs::write(&lock, lines.join("\n")).unwrap();
    drop(prepare(&scan, &tiles).unwrap());
    fs::write(&lock, "4194999\nanother-host\nother-boot\n").unwrap();
    let error = prepare(&scan, &tiles).unwrap_err();
    let text = error.to_string();
    assert!(matches!(error, Error::InUse { .. }), "{text}");
    assert!(text.contains("process 4194999 on another-host") && text.contains("remove"), "{text}");
    fs::remove_file(&lock).unwrap();
    drop(prepare(&scan, &tiles).unwrap());
}

#[test]
fn missing_tiles_are_an_error() {
    let (_folder, scan, tiles) = scan();
    let run = prepare(&scan, &tiles).unwrap();
    run.tiles()[1..].iter().for_each(|tile| run.detect(tile, &Control::default()).unwrap());
    let error = run.finish(&Control::default()).unwrap_err();
    let text = error.to_string();
    assert!(matches!(error, Error::Missing { missing, .. } if missing == run.tiles()[..1]), "{text}");
    assert!(text.starts_with(&format!("1 of {} tiles are missing", run.tiles().len())), "{text}");
    let detected = run.detected();
    assert_eq!(detected.missing, run.tiles()[..1]);
    assert!(!run.finish_detected(&detected, &Control::default()).unwrap().keypoints.is_empty());
}

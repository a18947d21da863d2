//! Bags of ROS 2 in SQLite files. `tests/data/io/drive.db3` has the clouds of `drive.mcap`, written by the package rosbags.

use std::path::{Path, PathBuf};

use rusqlite::Connection;
use snake_io::{Error, RecordedCloud, is_recording, read_recording};

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/io").join(name)
}

fn read(path: &Path, topic: Option<&str>) -> Result<Vec<RecordedCloud>, Error> {
    read_recording(path, topic)?.collect()
}

/// A copy of the bag, changed by a statement.
fn changed(folder: &Path, statement: &str) -> PathBuf {
    let path = folder.join("changed.db3");
    std::fs::copy(data("drive.db3"), &path).unwrap();
    Connection::open(&path).unwrap().execute_batch(statement).unwrap();
    path
}

#[test]
fn a_bag_has_the_clouds_of_the_same_drive_in_mcap() {
    let expected = read(&data("drive.mcap"), None).unwrap();
    assert_eq!(expected.len(), 2);
    for topic in [None, Some("/points")] {
        assert_eq!(read(&data("drive.db3"), topic).unwrap(), expected);
    }
    let folder = tempfile::tempdir().unwrap();
    let later_first = changed(folder.path(), "UPDATE messages SET timestamp = 5000000000 - timestamp");
    let times = read(&later_first, None).unwrap().into_iter().map(|cloud| cloud.log_time);
    assert_eq!(times.collect::<Vec<_>>(), [4_000_000_000, 5_000_000_000]);
}

#[test]
fn bags_that_cannot_be_read_are_refused_with_the_reason() {
    let folder = tempfile::tempdir().unwrap();
    let refused = |path: &Path, topic| read(path, topic).unwrap_err().to_string();
    let topics = "topics with point clouds: /points";
    let error = refused(&data("drive.db3"), Some("/other"));
    assert!(error.contains("no messages of the topic /other") && error.contains(topics), "{error}");
    for (statement, expected) in [
        ("UPDATE topics SET type = 'sensor_msgs/msg/Imu'", "no topic has point clouds"),
        ("UPDATE messages SET data = x'28b52ffd00'", "ros2 bag convert"),
        ("UPDATE messages SET data = x'00010000'", "message 0 of /points: cut short"),
        ("UPDATE messages SET data = 7", "message 1: "),
        ("UPDATE topics SET serialization_format = 'xml'", "`xml`"),
        ("DROP TABLE messages", "no such table: messages"),
        ("ALTER TABLE topics RENAME TO t; CREATE VIEW topics AS SELECT * FROM t", "topics"),
    ] {
        let error = refused(&changed(folder.path(), statement), None);
        assert!(error.contains("changed.db3: ") && error.contains(expected), "{statement}: {error}");
    }
    assert!(matches!(read(&folder.path().join("none.db3"), None), Err(Error::Io { .. })));
}

#[test]
fn damaged_files_give_an_error_or_whole_clouds() {
    let folder = tempfile::tempdir().unwrap();
    let (whole, expected) = (std::fs::read(data("drive.db3")).unwrap(), read(&data("drive.db3"), None).unwrap());
    let path = folder.path().join("damaged.db3");
    for length in (0..whole.len()).step_by(701) {
        std::fs::write(&path, &whole[..length]).unwrap();
        assert!(read(&path, None).is_err(), "{length}");
    }
    for place in (0..whole.len()).step_by(97) {
        let mut bytes = whole.clone();
        bytes[place] ^= 0xff;
        std::fs::write(&path, &bytes).unwrap();
        if let Ok(found) = read(&path, None) {
            assert!(found.len() <= expected.len(), "{place}");
        }
    }
}

/// A folder of a bag with copies of these files under these names, and a metadata file.
fn bag_folder(root: &Path, files: &[(&str, &str)], metadata: &str) -> PathBuf {
    let folder = root.join("drive");
    std::fs::create_dir_all(&folder).unwrap();
    for (name, source) in files {
        std::fs::copy(data(source), folder.join(name)).unwrap();
    }
    std::fs::write(folder.join("metadata.yaml"), metadata).unwrap();
    folder
}

/// What rosbag2 writes, with these files.
fn metadata(files: &[&str]) -> String {
    let files: String = files.iter().map(|file| format!("    - {file}\n")).collect();
    format!(
        "rosbag2_bagfile_information:\n  version: 5\n  storage_identifier: sqlite3\n  duration:\n    nanoseconds: 1000000000\n  \
         topics_with_message_count:\n    - topic_metadata:\n        name: /points\n        type: sensor_msgs/msg/PointCloud2\n        \
         offered_qos_profiles: \"- history: 3\\n  depth: 0\"\n      message_count: 4\n  compression_format: \"\"\n  \
         relative_file_paths:\n{files}"
    )
}

#[test]
fn the_folder_of_a_bag_has_the_clouds_of_its_files_in_the_order_of_its_metadata() {
    let root = tempfile::tempdir().unwrap();
    let files = [("drive_0.db3", "drive.db3"), ("drive_1.mcap", "drive.mcap"), ("unlisted.db3", "drive.db3")];
    // Old bags put the name of the folder before the file.
    let folder = bag_folder(root.path(), &files, &metadata(&["drive/drive_1.mcap", "drive_0.db3"]));
    assert!(is_recording(&folder) && is_recording(&folder.join("drive_0.db3")) && !is_recording(root.path()));
    let expected = [read(&data("drive.mcap"), None).unwrap(), read(&data("drive.db3"), None).unwrap()].concat();
    assert_eq!(expected.len(), 4);
    assert_eq!(read(&folder, None).unwrap(), expected);
    assert_eq!(read(&folder, Some("/points")).unwrap(), expected);
    // The time of the second file shows the order: it is changed to that of no other cloud.
    std::fs::copy(changed(root.path(), "UPDATE messages SET timestamp = 7"), folder.join("drive_0.db3")).unwrap();
    let times: Vec<u64> = read(&folder, None).unwrap().into_iter().map(|cloud| cloud.log_time).collect();
    assert_eq!(times[2..], [7, 7]);
}

#[test]
fn damaged_folders_of_bags_are_refused_with_the_reason() {
    let root = tempfile::tempdir().unwrap();
    let whole = metadata(&["drive_0.db3"]);
    let refused = |metadata: &str| {
        let folder = bag_folder(root.path(), &[("drive_0.db3", "drive.db3")], metadata);
        let error = read(&folder, None).unwrap_err().to_string();
        assert!(!error.contains('\n'), "one line: {error}");
        error
    };
    for (metadata, expected) in [
        ("", "metadata.yaml: no metadata of a bag"),
        ("a: [", "metadata.yaml: no metadata of a bag"),
        ("rosbag2_bagfile_information: 3", "metadata.yaml: no metadata of a bag"),
        ("rosbag2_bagfile_information: {version: 5}", "relative_file_paths"),
        ("rosbag2_bagfile_information: {relative_file_paths: []}", "metadata.yaml: it lists no files"),
        (&whole.replace("drive_0.db3", "drive_0.db3.zstd"), "drive_0.db3.zstd: its messages are compressed"),
        (&whole.replace("drive_0.db3", "../.."), "no file of messages"),
        (&whole.replace("drive_0.db3", "notes.txt"), "notes.txt: no file of messages"),
        (&whole.replace("drive_0.db3", "drive_1.db3"), "drive_1.db3: "),
        (&whole.replace("drive_0.db3", "drive_1.mcap"), "drive_1.mcap: "),
    ] {
        let error = refused(metadata);
        assert!(error.contains(expected), "{metadata}: {error}");
    }
    // Names that repeat each other would grow without end; they are not followed.
    let names = |level: u32| (0..9).map(|_| format!("*l{level}")).collect::<Vec<_>>().join(", ");
    let bomb: String = (1..12).map(|level| format!("l{level}: &l{level} [{}]\n", names(level - 1))).collect();
    let folder = bag_folder(root.path(), &[("drive_0.db3", "drive.db3")], &format!("l0: &l0 [x]\n{bomb}{whole}"));
    assert_eq!(read(&folder, None).unwrap().len(), 2);
    for length in (0..whole.len() - 2).step_by(7) {
        refused(&whole[..length]);
    }
    let folder = bag_folder(root.path(), &[], &whole);
    std::fs::remove_file(folder.join("metadata.yaml")).unwrap();
    assert_eq!(read(&folder, None).unwrap().len(), 2, "the metadata are missing after a crash");
}

#[test]
fn parts_without_metadata_are_read_by_number() {
    let root = tempfile::tempdir().unwrap();
    let folder = root.path().join("drive");
    let with = |files: &[&str]| {
        let _ = std::fs::remove_dir_all(&folder);
        std::fs::create_dir(&folder).unwrap();
        for name in files {
            std::fs::copy(data("drive.db3"), folder.join(name)).unwrap();
        }
    };
    let names: Vec<String> = (0..11).map(|number| format!("drive_{number}.db3")).collect();
    with(&names.iter().map(String::as_str).collect::<Vec<_>>());
    // The time of the last part shows the order.
    std::fs::copy(changed(root.path(), "UPDATE messages SET timestamp = 7"), folder.join("drive_10.db3")).unwrap();
    let times: Vec<u64> = read(&folder, None).unwrap().into_iter().map(|cloud| cloud.log_time).collect();
    assert!(is_recording(&folder) && times.len() == 22 && times[20..] == [7, 7], "{times:?}");
    for (files, expected) in [
        (&["a_0.db3", "b_0.db3"][..], "files of several recordings"),
        (&["a_0.db3", "a_2.db3"], "a_2.db3 does not follow a_0.db3"),
        (&["a_0.db3", "a_1.db3.zstd"], "its messages are compressed"),
        (&["notes.md"], "no files of messages"),
    ] {
        with(files);
        let error = read(&folder, None).unwrap_err().to_string();
        assert!(error.contains(expected) && !is_recording(&folder), "{files:?}: {error}");
    }
    // Beside clouds in files it is a folder of clouds.
    with(&["a_0.db3", "cloud.ply"]);
    assert!(!is_recording(&folder));
}

#[test]
fn a_damaged_part_costs_no_other() {
    let root = tempfile::tempdir().unwrap();
    let folder = bag_folder(
        root.path(),
        &[("drive_0.db3", "drive.db3"), ("drive_2.db3", "drive.db3")],
        &metadata(&["drive_0.db3", "drive_1.db3", "drive_2.db3"]),
    );
    std::fs::write(folder.join("drive_1.db3"), "no bag").unwrap();
    let clouds: Vec<_> = read_recording(&folder, None).unwrap().map(|cloud| cloud.map_err(|e| e.to_string())).collect();
    assert!(clouds.len() == 5 && clouds.iter().filter(|cloud| cloud.is_ok()).count() == 4, "{clouds:?}");
    assert!(clouds[2].as_ref().unwrap_err().contains("drive_1.db3"), "{clouds:?}");
}

#[test]
fn a_damaged_message_costs_no_other() {
    let folder = tempfile::tempdir().unwrap();
    for statement in
        ["UPDATE messages SET data = x'00010000' WHERE id = 1", "UPDATE messages SET data = 7 WHERE id = 1"]
    {
        let path = changed(folder.path(), statement);
        let clouds: Vec<_> = read_recording(&path, None).unwrap().collect();
        assert!(clouds.len() == 2 && clouds[0].is_err() && clouds[1].is_ok(), "{statement}: {clouds:?}");
    }
}

/// The names in a folder.
fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> =
        folder.read_dir().unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

/// A copy of the bag in WAL mode; with its journal if the writer did not end it.
fn in_wal_mode(folder: &Path, has_ended: bool) -> PathBuf {
    let path = folder.join("a b%20c#?.db3");
    let writing = folder.join("writing.db3");
    std::fs::copy(data("drive.db3"), &writing).unwrap();
    let writer = Connection::open(&writing).unwrap();
    writer.pragma_update(None, "journal_mode", "wal").unwrap();
    writer.pragma_update(None, "wal_autocheckpoint", 0).unwrap();
    writer.execute_batch("INSERT INTO messages SELECT id + 10, topic_id, timestamp + 9, data FROM messages").unwrap();
    if has_ended {
        drop(writer);
        std::fs::rename(writing, &path).unwrap();
    } else {
        // As after a crash.
        for end in ["", "-wal"] {
            std::fs::copy(format!("{}{end}", writing.display()), format!("{}{end}", path.display())).unwrap();
        }
        drop(writer);
        std::fs::remove_file(writing).unwrap();
    }
    path
}

#[test]
fn bags_in_wal_mode_are_read_and_nothing_is_left_beside_them() {
    for has_ended in [true, false] {
        for is_read_only in [false, true] {
            let folder = tempfile::tempdir().unwrap();
            let path = in_wal_mode(folder.path(), has_ended);
            let (before, bytes) = (names(folder.path()), std::fs::read(&path).unwrap());
            assert_eq!(before.len(), if has_ended { 1 } else { 2 }, "{before:?}");
            let permit = |is_read_only: bool| {
                for file in before.iter().map(|name| folder.path().join(name)).chain([folder.path().to_owned()]) {
                    let mut permissions = file.metadata().unwrap().permissions();
                    permissions.set_readonly(is_read_only);
                    #[cfg(unix)]
                    std::os::unix::fs::PermissionsExt::set_mode(
                        &mut permissions,
                        if is_read_only { 0o555 } else { 0o755 },
                    );
                    std::fs::set_permissions(file, permissions).unwrap();
                }
            };
            permit(is_read_only);
            let mut clouds = read_recording(&path, None).unwrap();
            let first = clouds.next().unwrap();
            let during = names(folder.path());
            let number = 1 + clouds.map(Result::unwrap).count();
            permit(false);
            assert!(first.is_ok() && number == 4, "{number} clouds");
            assert_eq!((during, names(folder.path())), (before.clone(), before));
            assert_eq!(std::fs::read(&path).unwrap(), bytes);
        }
    }
}

//! Bags of ROS 2 in SQLite files. `tests/data/io/drive.db3` has the clouds of `drive.mcap`, written by the package rosbags.

use std::path::{Path, PathBuf};

use rusqlite::Connection;
use snake_io::{Error, RecordedCloud, read_recording};

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/io").join(name)
}

fn read(path: &Path, topic: Option<&str>) -> Result<Vec<RecordedCloud>, Error> {
    let mut found = Vec::new();
    let number = read_recording(path, topic, |cloud| {
        found.push(cloud);
        Ok::<_, Error>(())
    })?;
    assert_eq!(number, found.len());
    Ok(found)
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

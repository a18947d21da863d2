//! Recordings in MCAP files.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};

mod messages;

use mcap::records::MessageHeader;
use messages::{SCHEMA, encoded_points};
use snake_io::{Error, RecordedCloud, read_recording};

/// The path of a recording, in a folder that lasts as long as it is held.
fn drive() -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("drive.mcap");
    (folder, path)
}

/// A message of ROS 2 with the points `(1, 2, 3)` and `(4, 5, NaN)`, each with a ring before it.
fn message() -> Vec<u8> {
    [vec![0, 1, 0, 0], encoded(true)].concat()
}

/// The same without the header of CDR, or in the encoding of ROS 1.
fn encoded(is_ros2: bool) -> Vec<u8> {
    encoded_points(is_ros2, &[[0.0, 1.0, 2.0, 3.0], [0.0, 4.0, 5.0, f32::NAN]])
}

/// Writes a recording with messages of these topics and schemas.
fn record(path: &Path, messages: &[(&str, &str, Vec<u8>)]) {
    let mut writer = mcap::Writer::new(std::fs::File::create(path).unwrap()).unwrap();
    for (time, (topic, schema, data)) in (100..).zip(messages) {
        let schema_id = writer.add_schema(schema, "ros2msg", b"").unwrap();
        let encoding = if schema.contains("/msg/") { "cdr" } else { "ros1" };
        let channel_id = writer.add_channel(schema_id, topic, encoding, &BTreeMap::new()).unwrap();
        let header = MessageHeader { channel_id, sequence: 0, log_time: time, publish_time: time };
        writer.write_to_known_channel(&header, data).unwrap();
    }
    writer.finish().unwrap();
}

fn read(path: &Path, topic: Option<&str>) -> Result<Vec<RecordedCloud>, Error> {
    read_recording(path, topic)?.collect()
}

/// The number of clouds of a recording, and the errors between them.
fn clouds_and_errors(path: &Path) -> (usize, Vec<String>) {
    let (clouds, errors): (Vec<_>, Vec<_>) = read_recording(path, None).unwrap().partition(Result::is_ok);
    (clouds.len(), errors.into_iter().map(|error| error.unwrap_err().to_string()).collect())
}

#[test]
fn the_clouds_of_a_topic_are_read_in_order() {
    let (_folder, path) = drive();
    record(
        &path,
        &[("/points", SCHEMA, message()), ("/pose", "geometry_msgs/msg/Pose", vec![]), ("/points", SCHEMA, message())],
    );
    for topic in [None, Some("/points")] {
        let messages = read(&path, topic).unwrap();
        assert_eq!((messages.len(), messages[1].log_time, messages[0].frame_id.as_str()), (2, 102, "lidar"));
        let points = &messages[0].cloud.points;
        assert!(points[0] == [1.0, 2.0, 3.0] && points[1][1] == 5.0 && points[1][2].is_nan());
    }
}

#[test]
fn other_topics_and_damaged_messages_are_refused_by_name() {
    let (_folder, path) = drive();
    let error = |topic| read(&path, topic).unwrap_err().to_string();
    record(&path, &[("/a", SCHEMA, message()), ("/b", SCHEMA, message()), ("/pose", "geometry_msgs/msg/Pose", vec![])]);
    assert!(error(None).contains("/a, /b"));
    assert!(error(Some("/c")).contains("topics with point clouds: /a, /b"));
    assert!(error(Some("/pose")).contains("geometry_msgs/msg/Pose"));
    for length in 0..message().len() - 1 {
        record(&path, &[("/a", SCHEMA, message()[..length].to_vec())]);
        let text = error(None);
        assert!(text.contains("message 0 of /a") || length == 0, "{length}: {text}");
    }
    std::fs::write(&path, b"no recording").unwrap();
    assert!(error(None).contains("drive.mcap"));
}

#[test]
fn recordings_of_ros_1_are_read() {
    let (_folder, path) = drive();
    record(&path, &[("/velodyne", "sensor_msgs/PointCloud2", encoded(false))]);
    let messages = read(&path, None).unwrap();
    assert_eq!(
        (messages.len(), messages[0].frame_id.as_str(), messages[0].cloud.points[0]),
        (1, "lidar", [1.0, 2.0, 3.0])
    );
    for length in 0..encoded(false).len() - 1 {
        record(&path, &[("/velodyne", "sensor_msgs/PointCloud2", encoded(false)[..length].to_vec())]);
        let text = read(&path, None).unwrap_err().to_string();
        assert!(text.contains("message 0 of /velodyne"), "{length}: {text}");
    }
}

#[test]
fn a_recording_without_clouds_names_its_topics() {
    let (_folder, path) = drive();
    let error = |topic| read(&path, topic).unwrap_err().to_string();
    record(&path, &[("/pose", "geometry_msgs/msg/Pose", vec![]), ("/imu", "sensor_msgs/msg/Imu", vec![])]);
    let expected = "no topic has point clouds (sensor_msgs/PointCloud2); topics: /pose (geometry_msgs/msg/Pose), /imu \
                    (sensor_msgs/msg/Imu)";
    assert!(error(None).ends_with(expected) && error(Some("/points")).ends_with(expected), "{}", error(None));
    record(&path, &[]);
    assert!(error(None).ends_with("the file has no messages"));
}

#[test]
fn damaged_files_give_an_error_or_whole_clouds() {
    let (_folder, path) = drive();
    record(&path, &[("/a", SCHEMA, message()), ("/a", SCHEMA, message())]);
    let whole = std::fs::read(&path).unwrap();
    for length in (0..whole.len()).step_by(3) {
        std::fs::write(&path, &whole[..length]).unwrap();
        assert!(read(&path, None).is_err(), "{length}");
    }
    // The largest number overflows as the length of any record.
    for (length, place) in (0..whole.len() - 8).flat_map(|place| [(1, place), (8, place)]) {
        let mut bytes = whole.clone();
        bytes[place..place + length].iter_mut().for_each(|byte| *byte = if length == 1 { !*byte } else { 0xff });
        std::fs::write(&path, &bytes).unwrap();
        if let Ok(found) = read(&path, None) {
            assert!(found.len() <= 2, "{length} bytes at {place}");
        }
    }
}

#[test]
fn a_damaged_message_costs_no_other() {
    let (_folder, path) = drive();
    let (good, short) = (("/a", SCHEMA, message()), ("/a", SCHEMA, message()[..90].to_vec()));
    record(&path, &[short.clone(), good.clone(), short, good.clone(), good]);
    let (number, errors) = clouds_and_errors(&path);
    assert_eq!((number, errors.len()), (3, 2), "{errors:?}");
    assert!(errors[0].contains("message 0 of /a") && errors[1].contains("message 2 of /a"), "{errors:?}");
}

/// A recording of 20 messages, in chunks of a size that have this compression.
fn in_chunks(path: &Path, compression: &str, chunk_size: u64, message: impl Fn(u64) -> Vec<u8>) {
    let options = mcap::WriteOptions::new().compression(None).chunk_size(Some(chunk_size));
    let mut writer = options.create(std::fs::File::create(path).unwrap()).unwrap();
    let schema_id = writer.add_schema(SCHEMA, "ros2msg", b"").unwrap();
    let channel_id = writer.add_channel(schema_id, "/a", "cdr", &BTreeMap::new()).unwrap();
    for time in 0..20 {
        let header = MessageHeader { channel_id, sequence: time as u32, log_time: time, publish_time: time };
        writer.write_to_known_channel(&header, &message(time)).unwrap();
    }
    writer.finish().unwrap();
    if !compression.is_empty() {
        std::fs::write(path, compressed(&std::fs::read(path).unwrap(), compression)).unwrap();
    }
}

/// The same recording with compressed chunks.
fn compressed(bytes: &[u8], compression: &str) -> Vec<u8> {
    let (mut packed, mut rest) = (bytes[..8].to_vec(), &bytes[8..]);
    while rest.len() > 8 {
        let length = u64::from_le_bytes(rest[1..9].try_into().unwrap()) as usize;
        let (record, after) = rest.split_at(9 + length);
        rest = after;
        if record[0] != 6 {
            packed.extend(record);
            continue;
        }
        // Times, size and checksum; then an empty name of the compression and the length of the data.
        let (times, data) = (&record[9..37], &record[49..]);
        let data = match compression {
            "zstd" => ruzstd::encoding::compress_to_vec(data, ruzstd::encoding::CompressionLevel::Fastest),
            _ => {
                let info = lz4_flex::frame::FrameInfo::new().block_size(lz4_flex::frame::BlockSize::Max64KB);
                let mut encoder = lz4_flex::frame::FrameEncoder::with_frame_info(info, Vec::new());
                encoder.write_all(data).unwrap();
                encoder.finish().unwrap()
            }
        };
        let name = compression.as_bytes();
        packed.push(6);
        packed.extend((times.len() as u64 + 12 + name.len() as u64 + data.len() as u64).to_le_bytes());
        packed.extend(times);
        packed.extend((name.len() as u32).to_le_bytes());
        packed.extend(name);
        packed.extend((data.len() as u64).to_le_bytes());
        packed.extend(data);
    }
    packed.extend(rest);
    packed
}

const COMPRESSIONS: [&str; 3] = ["", "lz4", "zstd"];

#[test]
fn chunks_of_the_usual_programs_are_read() {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/io");
    // One is packed by zstd, one by lz4, by their own libraries.
    let [zstd, lz4] = ["drive.mcap", "drive_lz4.mcap"].map(|name| read(&data.join(name), None).unwrap());
    assert_eq!((zstd.len(), zstd[0].cloud.points.len()), (2, 1000));
    assert_eq!(zstd, lz4);
    let (_folder, path) = drive();
    let clouds = COMPRESSIONS.map(|compression| {
        in_chunks(&path, compression, 300, |_| message());
        format!("{:?}", read(&path, None).unwrap())
    });
    assert!(clouds[0] == clouds[1] && clouds[0] == clouds[2]);
    in_chunks(&path, "zstd", 300, |_| message());
    let bytes = std::fs::read(&path).unwrap();
    let name = bytes.windows(4).position(|name| name == b"zstd").unwrap();
    std::fs::write(&path, [&bytes[..name], b"snap", &bytes[name + 4..]].concat()).unwrap();
    let error = read(&path, None).unwrap_err().to_string();
    assert!(error.contains("compressed with `snap`, which is not read; convert it"), "{error}");
}

#[test]
fn a_cut_file_has_the_clouds_before_the_cut() {
    let (_folder, path) = drive();
    for compression in COMPRESSIONS {
        in_chunks(&path, compression, 300, |_| message());
        let whole = std::fs::read(&path).unwrap();
        let mut most = 0;
        for length in (whole.len() / 4..whole.len()).step_by(37) {
            std::fs::write(&path, &whole[..length]).unwrap();
            let (number, errors) = clouds_and_errors(&path);
            assert!(number >= most && number > 0, "{length}: {number}");
            assert!(errors.len() == 1 && errors[0].contains("cut short"), "{length}: {errors:?}");
            assert!(errors[0].contains("mcap recover"));
            most = number;
        }
        assert_eq!(most, 20);
    }
}

/// The end of a chunk, counted from 0.
fn end_of_chunk(bytes: &[u8], number: usize) -> usize {
    let (mut place, mut chunks) = (8, 0);
    loop {
        let length = u64::from_le_bytes(bytes[place + 1..place + 9].try_into().unwrap()) as usize;
        let end = place + 9 + length;
        if bytes[place] == 6 {
            chunks += 1;
        }
        if chunks > number {
            return end;
        }
        place = end;
    }
}

#[test]
fn a_damaged_chunk_costs_its_own_messages_only() {
    let (_folder, path) = drive();
    for compression in COMPRESSIONS {
        in_chunks(&path, compression, 300, |_| message());
        let mut bytes = std::fs::read(&path).unwrap();
        // In the last coordinates of a message, or in the frame's name, which lz4 leaves as it is: only the checksum shows it.
        let end = end_of_chunk(&bytes, 3);
        let name = bytes[..end].windows(5).rposition(|name| name == b"lidar");
        let damaged = if compression == "lz4" { name.unwrap() } else { end - 12 };
        bytes[damaged] ^= 0x55;
        std::fs::write(&path, &bytes).unwrap();
        let (number, errors) = clouds_and_errors(&path);
        assert!((16..20).contains(&number) && errors.len() == 1, "{compression} {number}: {errors:?}");
        assert!(errors[0].contains("damaged"), "{errors:?}");
    }
}

#[test]
fn messages_in_the_second_version_of_cdr_and_names_of_dds_are_read() {
    let (_folder, path) = drive();
    let expected = {
        record(&path, &[("/a", SCHEMA, message())]);
        format!("{:?}", read(&path, None).unwrap())
    };
    let body = encoded(true);
    // The list of fields begins after the time, the frame and the size of the cloud.
    let fields = 8 + 4 + 8 + 8;
    let with_size = [&body[..fields], &100_u32.to_le_bytes(), &body[fields..]].concat();
    for kind in [6_u8, 7, 16, 17] {
        let head = [0, kind | 1, 0, 0];
        for body in [&body, &with_size] {
            record(&path, &[("/a", SCHEMA, [&head, &body[..]].concat())]);
            assert_eq!(format!("{:?}", read(&path, None).unwrap()), expected, "{kind}");
        }
    }
    record(&path, &[("/a", SCHEMA, [&[0, 9, 0, 0], &body[..]].concat())]);
    assert!(read(&path, None).unwrap_err().to_string().contains("CDR of the kind 00 09"));
    let mut writer = mcap::Writer::new(std::fs::File::create(&path).unwrap()).unwrap();
    let schema_id = writer.add_schema("sensor_msgs::msg::dds_::PointCloud2_", "omgidl", b"").unwrap();
    let channel_id = writer.add_channel(schema_id, "/a", "cdr", &BTreeMap::new()).unwrap();
    let header = MessageHeader { channel_id, sequence: 0, log_time: 100, publish_time: 100 };
    writer.write_to_known_channel(&header, &message()).unwrap();
    writer.finish().unwrap();
    assert_eq!(format!("{:?}", read(&path, None).unwrap()), expected);
}

#[test]
fn topics_that_can_become_clouds_say_how() {
    let (_folder, path) = drive();
    for (schema, expected) in [
        ("livox_ros_driver2/msg/CustomMsg", "xfer_format: 0"),
        ("velodyne_msgs/msg/VelodyneScan", "play the recording to its driver"),
        ("ouster_sensor_msgs/msg/PacketMsg", "play the recording to its driver"),
        ("sensor_msgs/msg/LaserScan", "one plane"),
        ("foxglove.PointCloud", "record sensor_msgs/PointCloud2"),
        ("sensor_msgs/msg/PointCloud", "point_cloud_converter"),
        ("sensor_msgs/msg/Image", "depth_image_proc"),
    ] {
        record(&path, &[("/pose", "geometry_msgs/msg/Pose", vec![]), ("/a", schema, vec![])]);
        let error = read(&path, None).unwrap_err().to_string();
        assert!(error.contains(&format!("/a ({schema})")) && error.contains(expected), "{schema}: {error}");
    }
    record(&path, &[("/a", SCHEMA, message()), ("/b", SCHEMA, message())]);
    assert!(read(&path, None).unwrap_err().to_string().ends_with("give one: `topic` /a"));
}

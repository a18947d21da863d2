//! Reads the point clouds of recordings, MCAP files: messages `sensor_msgs/msg/PointCloud2` of ROS 2 and
//! `sensor_msgs/PointCloud2` of ROS 1.

use std::path::{Path, PathBuf};

use snake_geometry::Cloud;

use crate::formats::{CONVERT_BAG, extension};
use crate::logs::mcap;
use crate::logs::message::{Message, Messages};
use crate::logs::ros_message::decode;
use crate::logs::topics::chosen;
use crate::{Error, Result};

/// A cloud of a recording.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordedCloud {
    /// The time at which it was recorded, in nanoseconds since 1970.
    pub log_time: u64,
    /// The frame that the message names.
    pub frame_id: String,
    /// All points, including those that are not finite, relative to an origin if they are far from zero.
    pub cloud: Cloud,
}

/// The clouds of a recording: the iterator of [`read_recording`]. It reads one cloud or one chunk of the
/// file at a time. An error, [`Error::Io`] or [`Error::Format`], replaces a message, a chunk or the rest of
/// a file that is damaged or compressed in an unknown way. The iterator then continues with the next cloud.
pub struct Recording {
    path: PathBuf,
    topic: String,
    messages: Messages,
    /// The number of messages read so far.
    number: usize,
}

/// Whether the path names a recording: an MCAP file, or a ROS 2 bag in SQLite (`.db3`). [`read_recording`] refuses the latter with
/// the command that converts it.
pub fn is_recording(path: &Path) -> bool {
    matches!(extension(path).as_str(), "mcap" | "db3")
}

/// Reads the clouds of a topic of an MCAP file one by one, in order. Without a topic, it takes the only one with point clouds.
///
/// ```no_run
/// for cloud in snake_io::read_recording("drive.mcap".as_ref(), Some("/points"))? {
///     let cloud = cloud?;
///     println!("{} ns: {} points", cloud.log_time, cloud.cloud.points.len());
/// }
/// # Ok::<(), snake_io::Error>(())
/// ```
///
/// # Errors
/// [`Error::Io`] when the file cannot be read; [`Error::Format`] when it is not a recording, when the topic has no point clouds,
/// or when no topic is given and several have point clouds.
pub fn read_recording(path: &Path, topic: Option<&str>) -> Result<Recording> {
    let wrong = |reason: String| Error::Format { path: path.into(), reason };
    if path.is_dir() {
        return Err(wrong("a folder; give the MCAP file in it, or convert the bag: ".to_owned() + CONVERT_BAG));
    }
    if extension(path) == "db3" {
        std::fs::metadata(path).map_err(|source| Error::Io { path: path.into(), source })?;
        return Err(wrong("bags in SQLite are not read; convert the bag: ".to_owned() + CONVERT_BAG));
    }
    let topic = chosen(&mcap::topics(path)?, topic).map_err(wrong)?;
    let messages = mcap::messages(path, &topic)?;
    Ok(Recording { path: path.into(), topic, messages, number: 0 })
}

impl Recording {
    /// The topic of the clouds.
    pub fn topic(&self) -> &str {
        &self.topic
    }
}

impl Iterator for Recording {
    type Item = Result<RecordedCloud>;

    fn next(&mut self) -> Option<Self::Item> {
        Some(self.messages.next()?.and_then(|Message { log_time, encoding, data }| {
            // A damaged message is counted, too.
            let number = self.number;
            self.number += 1;
            let (frame_id, cloud) = decode(&encoding, &data).map_err(|reason| {
                let reason = format!("message {number} of {}: {reason}", self.topic);
                Error::Format { path: self.path.clone(), reason }
            })?;
            Ok(RecordedCloud { log_time, frame_id, cloud })
        }))
    }
}

//! Reads the point clouds of recordings, MCAP files and bags of ROS 2: messages `sensor_msgs/msg/PointCloud2` of ROS 2 and
//! `sensor_msgs/PointCloud2` of ROS 1.

use std::path::{Path, PathBuf};

use snake_geometry::Cloud;

use crate::formats::extension;
use crate::logs::bag_folder;
use crate::logs::mcap;
use crate::logs::message::{Message, Messages};
use crate::logs::ros_message::decode;
#[cfg(feature = "rosbag2")]
use crate::logs::rosbag2;
use crate::logs::topics::chosen;
use crate::{Error, Result};

/// A cloud of a recording.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordedCloud {
    /// The time at which it was recorded, in nanoseconds since 1970.
    pub log_time: u64,
    /// The frame that the message names.
    pub frame_id: String,
    /// The points with those that are not finite, relative to an origin if they are far from zero.
    pub cloud: Cloud,
}

/// The clouds of a recording, an iterator made by [`read_recording`]. It reads one cloud at a time, or one chunk of an MCAP
/// file. An error, [`Error::Io`] or [`Error::Format`], stands for a message, a chunk or the rest of a file that is damaged
/// or compressed. The clouds after it follow: the iterator has not ended.
pub struct Recording {
    topic: String,
    /// The files that are still to be read.
    files: std::vec::IntoIter<PathBuf>,
    /// The file that is being read, and its messages.
    open: Option<(PathBuf, Messages)>,
    /// The number of messages that have been read.
    number: usize,
}

/// Whether the path is a recording: a file `.mcap` or `.db3`, or the folder of a bag of ROS 2, which has such files and a
/// `metadata.yaml`. A folder without that has nothing else to read, and the names of its files differ in their numbers.
pub fn is_recording(path: &Path) -> bool {
    matches!(extension(path).as_str(), "mcap" | "db3") || bag_folder::is_bag(path)
}

/// Reads the clouds of a topic, one by one. `path` is an MCAP file, a file of a bag of ROS 2 in SQLite (`.db3`), or the folder
/// of a bag, the files of which are read in the order of its `metadata.yaml`, or without that of their numbers. The clouds of an MCAP file are in its order,
/// those of a `.db3` file by time. Without a topic the only one with point clouds is taken.
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
/// [`Error::Io`] when a file cannot be read; [`Error::Format`] when it is no recording, the topic has no point clouds, or no
/// topic is given and several have some; [`Error::Feature`] for a `.db3` file without the feature `rosbag2`.
pub fn read_recording(path: &Path, topic: Option<&str>) -> Result<Recording> {
    let files = if path.is_dir() { bag_folder::files(path)? } else { vec![path.to_path_buf()] };
    let mut topics: Vec<(String, String)> = Vec::new();
    let mut errors: Vec<Error> = Vec::new();
    for file in &files {
        match topics_of(file) {
            Ok(found) => {
                for topic in found {
                    if topics.iter().all(|(name, _)| *name != topic.0) {
                        topics.push(topic);
                    }
                }
            }
            Err(error) => errors.push(error),
        }
    }
    // A damaged file among good ones is an error when its turn comes.
    if errors.len() == files.len()
        && let Some(error) = errors.into_iter().next()
    {
        return Err(error);
    }
    let topic = chosen(&topics, topic).map_err(|reason| Error::Format { path: path.into(), reason })?;
    Ok(Recording { topic, files: files.into_iter(), open: None, number: 0 })
}

impl Recording {
    /// The topic of the clouds.
    pub fn topic(&self) -> &str {
        &self.topic
    }

    /// Decodes the next message. It is counted also if it is damaged.
    fn cloud(&mut self, path: &Path, message: Message) -> Result<RecordedCloud> {
        let Message { log_time, encoding, data } = message;
        let number = self.number;
        self.number += 1;
        let (frame_id, cloud) = decode(&encoding, &data).map_err(|reason| {
            let reason = format!("message {number} of {}: {reason}", self.topic);
            Error::Format { path: path.into(), reason }
        })?;
        Ok(RecordedCloud { log_time, frame_id, cloud })
    }
}

impl Iterator for Recording {
    type Item = Result<RecordedCloud>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            let (path, mut messages) = match self.open.take() {
                Some(open) => open,
                None => {
                    let path = self.files.next()?;
                    match messages_of(&path, &self.topic) {
                        Ok(messages) => (path, messages),
                        Err(error) => return Some(Err(error)),
                    }
                }
            };
            if let Some(message) = messages.next() {
                let cloud = message.and_then(|message| self.cloud(&path, message));
                self.open = Some((path, messages));
                return Some(cloud);
            }
        }
    }
}

/// The topics of a file and the schemas of their messages.
fn topics_of(path: &Path) -> Result<Vec<(String, String)>> {
    match extension(path).as_str() {
        #[cfg(feature = "rosbag2")]
        "db3" => rosbag2::Bag::open(path)?.topics(),
        #[cfg(not(feature = "rosbag2"))]
        "db3" => Err(Error::Feature { path: path.into(), feature: "rosbag2" }),
        _ => mcap::topics(path),
    }
}

/// The messages of a topic in a file whose topics have been read.
fn messages_of(path: &Path, topic: &str) -> Result<Messages> {
    match extension(path).as_str() {
        #[cfg(feature = "rosbag2")]
        "db3" => rosbag2::Bag::open(path)?.messages(topic),
        #[cfg(not(feature = "rosbag2"))]
        "db3" => Err(Error::Feature { path: path.into(), feature: "rosbag2" }),
        _ => mcap::messages(path, topic),
    }
}

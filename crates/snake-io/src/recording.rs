//! Reads the point clouds of recordings, MCAP files and bags of ROS 2: messages `sensor_msgs/msg/PointCloud2` of ROS 2 and
//! `sensor_msgs/PointCloud2` of ROS 1.

use std::path::{Path, PathBuf};

use snake_core::Cloud;

use crate::bag_folder;
use crate::format::extension;
use crate::message::{Message, Messages};
use crate::ros_message::decode;
#[cfg(feature = "rosbag2")]
use crate::rosbag2;
use crate::{Error, Result, mcap};

/// The schemas of the messages that are read: of ROS 2 and of ROS 1.
const SCHEMAS: [&str; 2] = ["sensor_msgs/msg/PointCloud2", "sensor_msgs/PointCloud2"];

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

/// The clouds of a recording, an iterator made by [`read_recording`]. It reads one cloud at a time, and ends at the first
/// error: [`Error::Io`], or [`Error::Format`] for a message that is damaged or compressed.
pub struct Recording {
    topic: String,
    /// The files that are still to be read.
    files: std::vec::IntoIter<PathBuf>,
    /// The file that is being read, and its messages.
    open: Option<(PathBuf, Messages)>,
    /// The number of clouds that have been read.
    number: usize,
}

/// Whether the path is a recording: a file `.mcap` or `.db3`, or the folder of a bag of ROS 2, which has such files and a
/// `metadata.yaml`.
pub fn is_recording(path: &Path) -> bool {
    matches!(extension(path).as_str(), "mcap" | "db3") || bag_folder::is_bag(path)
}

/// Reads the clouds of a topic, one by one. `path` is an MCAP file, a file of a bag of ROS 2 in SQLite (`.db3`), or the folder
/// of a bag, the files of which are read in the order of its `metadata.yaml`. The clouds of an MCAP file are in its order,
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
/// topic is given and several have some.
pub fn read_recording(path: &Path, topic: Option<&str>) -> Result<Recording> {
    let files = if path.is_dir() { bag_folder::files(path)? } else { vec![path.to_path_buf()] };
    let mut topics: Vec<(String, String)> = Vec::new();
    for file in &files {
        for found in topics_of(file)? {
            if topics.iter().all(|(name, _)| *name != found.0) {
                topics.push(found);
            }
        }
    }
    let topic = chosen_topic(&topics, topic).map_err(|reason| Error::Format { path: path.into(), reason })?;
    Ok(Recording { topic, files: files.into_iter(), open: None, number: 0 })
}

impl Recording {
    /// The topic of the clouds.
    pub fn topic(&self) -> &str {
        &self.topic
    }

    fn cloud(&mut self, path: &Path, message: Message) -> Result<RecordedCloud> {
        let Message { log_time, encoding, data } = message;
        let (frame_id, cloud) = decode(&encoding, &data).map_err(|reason| {
            let reason = format!("message {} of {}: {reason}", self.number, self.topic);
            Error::Format { path: path.into(), reason }
        })?;
        self.number += 1;
        Ok(RecordedCloud { log_time, frame_id, cloud })
    }

    fn next_cloud(&mut self) -> Result<Option<RecordedCloud>> {
        loop {
            let (path, mut messages) = match self.open.take() {
                Some(open) => open,
                None => match self.files.next() {
                    Some(path) => {
                        let messages = messages_of(&path, &self.topic)?;
                        (path, messages)
                    }
                    None => return Ok(None),
                },
            };
            if let Some(message) = messages.next() {
                let cloud = self.cloud(&path, message?)?;
                self.open = Some((path, messages));
                return Ok(Some(cloud));
            }
        }
    }
}

impl Iterator for Recording {
    type Item = Result<RecordedCloud>;

    fn next(&mut self) -> Option<Self::Item> {
        let cloud = self.next_cloud().transpose();
        if matches!(cloud, Some(Err(_))) {
            self.files = Vec::new().into_iter();
        }
        cloud
    }
}

/// The topics of a file and the schemas of their messages.
fn topics_of(path: &Path) -> Result<Vec<(String, String)>> {
    match extension(path).as_str() {
        #[cfg(feature = "rosbag2")]
        "db3" => rosbag2::Bag::open(path)?.topics(),
        #[cfg(not(feature = "rosbag2"))]
        "db3" => {
            let reason = "this build cannot read .db3: it lacks the feature `rosbag2` of snake-io".into();
            Err(Error::Format { path: path.into(), reason })
        }
        _ => mcap::topics(path),
    }
}

/// The messages of a topic in a file whose topics have been read.
fn messages_of(path: &Path, topic: &str) -> Result<Messages> {
    #[cfg(feature = "rosbag2")]
    if extension(path) == "db3" {
        return rosbag2::Bag::open(path)?.messages(topic);
    }
    mcap::messages(path, topic)
}

/// The given one of the topics and the schemas of their messages, or the only one with point clouds.
fn chosen_topic(topics: &[(String, String)], given: Option<&str>) -> std::result::Result<String, String> {
    let is_cloud = |schema: &str| SCHEMAS.contains(&schema);
    let clouds: Vec<&str> =
        topics.iter().filter(|(_, schema)| is_cloud(schema)).map(|(topic, _)| topic.as_str()).collect();
    let listed = || match &clouds[..] {
        [] if topics.is_empty() => "the file has no messages".to_owned(),
        [] => {
            let all: Vec<String> = topics.iter().map(|(topic, schema)| format!("{topic} ({schema})")).collect();
            format!("no topic has point clouds; topics: {}", all.join(", "))
        }
        clouds => format!("topics with point clouds: {}", clouds.join(", ")),
    };
    match (given, &clouds[..]) {
        (Some(given), _) => match topics.iter().find(|(topic, _)| topic == given) {
            Some((_, schema)) if is_cloud(schema) => Ok(given.to_owned()),
            Some((_, schema)) => Err(format!("topic {given} has messages {schema}, not point clouds; {}", listed())),
            None => Err(format!("no messages of the topic {given}; {}", listed())),
        },
        (None, [topic]) => Ok((*topic).to_owned()),
        (None, []) => Err(listed()),
        (None, _) => Err(format!("which topic? {}", listed())),
    }
}

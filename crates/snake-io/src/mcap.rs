//! Reads the point clouds of recordings in MCAP files: messages `sensor_msgs/msg/PointCloud2` of ROS 2.

use std::path::Path;

use snake_core::{Cloud, PointCloud2Layout, PointCloud2View, PointField, PointSource};

use crate::{Error, Result};

/// The schema of the messages that are read.
const SCHEMA: &str = "sensor_msgs/msg/PointCloud2";

/// A cloud of a recording.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordedCloud {
    /// The time at which it was recorded, in nanoseconds since 1970.
    pub log_time: u64,
    /// The frame that the message names.
    pub frame_id: String,
    /// The points, as float32, with those that are not finite.
    pub cloud: Cloud,
}

/// Calls `use_cloud` with each point cloud of a topic, in the order of the file, and returns their number. `None` takes the
/// only topic with point clouds. Only one cloud is in memory at a time.
///
/// # Errors
/// [`Error::Io`] when the file cannot be read; [`Error::Format`] when it is no MCAP file, the topic has no point clouds or
/// several topics have some, or a message is damaged. The errors of `use_cloud` end the reading.
pub fn read_recording(
    path: &Path,
    topic: Option<&str>,
    mut use_cloud: impl FnMut(RecordedCloud) -> Result<()>,
) -> Result<usize> {
    let refuse = |reason: String| Error::Format { path: path.into(), reason };
    let bytes = std::fs::read(path).map_err(|source| Error::Io { path: path.into(), source })?;
    let topic = match topic {
        Some(topic) => topic.to_owned(),
        None => only_topic(&bytes).map_err(refuse)?,
    };
    let mut number = 0;
    for message in ::mcap::MessageStream::new(&bytes).map_err(|error| refuse(error.to_string()))? {
        let message = message.map_err(|error| refuse(error.to_string()))?;
        if message.channel.topic != topic {
            continue;
        }
        let schema = message.channel.schema.as_ref().map_or("", |schema| schema.name.as_str());
        if schema != SCHEMA {
            return Err(refuse(format!("topic {topic} has messages {schema}; {SCHEMA} is read")));
        }
        let (frame_id, cloud) =
            decode(&message.data).map_err(|reason| refuse(format!("message {number} of {topic}: {reason}")))?;
        use_cloud(RecordedCloud { log_time: message.log_time, frame_id, cloud })?;
        number += 1;
    }
    match number {
        0 => Err(refuse(format!("no messages of the topic {topic}; topics with point clouds: {}", listed(&bytes)))),
        _ => Ok(number),
    }
}

/// The topics with point clouds.
fn topics(bytes: &[u8]) -> Vec<String> {
    let mut topics = Vec::new();
    for message in ::mcap::MessageStream::new(bytes).into_iter().flatten().flatten() {
        let is_cloud = message.channel.schema.as_ref().is_some_and(|schema| schema.name == SCHEMA);
        if is_cloud && !topics.contains(&message.channel.topic) {
            topics.push(message.channel.topic.clone());
        }
    }
    topics
}

fn listed(bytes: &[u8]) -> String {
    let topics = topics(bytes);
    if topics.is_empty() { "none".into() } else { topics.join(", ") }
}

fn only_topic(bytes: &[u8]) -> std::result::Result<String, String> {
    ::mcap::MessageStream::new(bytes).map_err(|error| error.to_string())?;
    match &topics(bytes)[..] {
        [topic] => Ok(topic.clone()),
        [] => Err(format!("no messages {SCHEMA}")),
        several => Err(format!("several topics with point clouds: {}; choose one", several.join(", "))),
    }
}

/// Decodes a message: its frame and its points.
fn decode(data: &[u8]) -> std::result::Result<(String, Cloud), String> {
    let mut reader = Cdr::new(data)?;
    reader.skip_time()?;
    let frame_id = reader.text()?;
    let [height, width] = [reader.number()?, reader.number()?];
    let num_fields = reader.number()?;
    let mut fields: Vec<(String, usize, u8, usize)> = Vec::new();
    for _ in 0..num_fields {
        fields.push((reader.text()?, reader.number()?, reader.byte()?, reader.number()?));
    }
    let is_bigendian = reader.byte()? != 0;
    let [point_step, row_step, length] = [reader.number()?, reader.number()?, reader.number()?];
    let layout = PointCloud2Layout { height, width, point_step, row_step, is_bigendian };
    let fields: Vec<PointField> = fields
        .iter()
        .map(|(name, offset, datatype, count)| PointField { name, offset: *offset, datatype: *datatype, count: *count })
        .collect();
    let view = PointCloud2View::new(layout, &fields, reader.bytes(length)?).map_err(|error| error.to_string())?;
    // Points of no bytes could be any number.
    if view.num_points() > data.len() {
        return Err(format!("{} points in {} bytes", view.num_points(), data.len()));
    }
    Ok((frame_id, Cloud { points: view.to_points(), origin: [0.0; 3] }))
}

/// A reader of CDR, the encoding of ROS 2 messages: numbers are aligned to their size, from the end of the header.
struct Cdr<'a> {
    data: &'a [u8],
    place: usize,
    is_little_endian: bool,
}

impl<'a> Cdr<'a> {
    fn new(data: &'a [u8]) -> std::result::Result<Self, String> {
        match data {
            [0, kind @ (0 | 1), _, _, data @ ..] => Ok(Self { data, place: 0, is_little_endian: *kind == 1 }),
            _ => Err("not encoded as CDR".into()),
        }
    }

    fn bytes(&mut self, length: usize) -> std::result::Result<&'a [u8], String> {
        let end = self.place.checked_add(length);
        let bytes = end.and_then(|end| self.data.get(self.place..end)).ok_or("cut short")?;
        self.place += length;
        Ok(bytes)
    }

    fn byte(&mut self) -> std::result::Result<u8, String> {
        Ok(self.bytes(1)?[0])
    }

    fn number(&mut self) -> std::result::Result<usize, String> {
        self.place = self.place.next_multiple_of(4);
        let mut bytes = [0; 4];
        bytes.copy_from_slice(self.bytes(4)?);
        Ok(if self.is_little_endian { u32::from_le_bytes(bytes) } else { u32::from_be_bytes(bytes) } as usize)
    }

    /// A text with its length before it and a zero after it.
    fn text(&mut self) -> std::result::Result<String, String> {
        let length = self.number()?;
        let bytes = self.bytes(length)?;
        Ok(String::from_utf8_lossy(bytes.strip_suffix(&[0]).unwrap_or(bytes)).into_owned())
    }

    fn skip_time(&mut self) -> std::result::Result<(), String> {
        self.bytes(8).map(drop)
    }
}

//! Reads the point clouds of recordings in MCAP files and in bags of ROS 2 in SQLite: messages `sensor_msgs/msg/PointCloud2` of ROS 2 and
//! `sensor_msgs/PointCloud2` of ROS 1.

use std::path::Path;

use snake_core::{Cloud, PointCloud2Layout, PointCloud2View, PointField, PointSource};

use crate::Error;
use crate::format::extension;
use crate::mcap;
use crate::message::Message;
#[cfg(feature = "rosbag2")]
use crate::rosbag2;

/// The schemas of the messages that are read: of ROS 2 and of ROS 1.
const SCHEMAS: [&str; 2] = ["sensor_msgs/msg/PointCloud2", "sensor_msgs/PointCloud2"];

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

/// Calls `use_cloud` with each point cloud of a topic, in the order of an MCAP file or by time in a bag of ROS 2 in SQLite
/// (`.db3`), and returns their number. `None` takes the only topic with point clouds. Only one cloud is in memory at a time.
///
/// # Errors
/// [`Error::Io`] when the file cannot be read; [`Error::Format`] when it is no recording, the topic has no point clouds or
/// several topics have some, or a message is damaged or compressed. The errors of `use_cloud` end the reading.
pub fn read_recording<E: From<Error>>(
    path: &Path,
    topic: Option<&str>,
    mut use_cloud: impl FnMut(RecordedCloud) -> std::result::Result<(), E>,
) -> std::result::Result<usize, E> {
    let io_error = |source| Error::Io { path: path.into(), source };
    let refuse = |reason: String| Error::Format { path: path.into(), reason };
    let mut number = 0;
    let mut use_message = |Message { log_time, encoding, data }: Message, topic: &str| {
        let decoded = MessageReader::new(encoding, data).and_then(decode);
        let (frame_id, cloud) = decoded.map_err(|reason| refuse(format!("message {number} of {topic}: {reason}")))?;
        number += 1;
        use_cloud(RecordedCloud { log_time, frame_id, cloud })
    };
    if extension(path) == "db3" {
        #[cfg(feature = "rosbag2")]
        {
            let length = std::fs::metadata(path).map_err(io_error)?.len();
            let bag = rosbag2::Bag::open(path, length).map_err(refuse)?;
            let topic = chosen_topic(&bag.topics().map_err(refuse)?, topic).map_err(refuse)?;
            for id in bag.messages(&topic).map_err(refuse)? {
                bag.use_message(id, |message| use_message(message, &topic)).map_err(refuse)??;
            }
            return Ok(number);
        }
        #[cfg(not(feature = "rosbag2"))]
        return Err(refuse("this build cannot read .db3: it lacks the feature `rosbag2` of snake-io".into()).into());
    }
    let bytes = std::fs::read(path).map_err(io_error)?;
    let topic = chosen_topic(&mcap::topics(&bytes).map_err(refuse)?, topic).map_err(refuse)?;
    for message in ::mcap::MessageStream::new(&bytes).map_err(|error| refuse(error.to_string()))? {
        let message = message.map_err(|error| refuse(error.to_string()))?;
        if message.channel.topic == topic {
            let (log_time, encoding) = (message.log_time, &message.channel.message_encoding);
            use_message(Message { log_time, encoding, data: &message.data }, &topic)?;
        }
    }
    Ok(number)
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

/// Decodes a message: its frame and its points.
fn decode(mut reader: MessageReader) -> std::result::Result<(String, Cloud), String> {
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
    if view.num_points() > length {
        return Err(format!("{} points in {length} bytes", view.num_points()));
    }
    Ok((frame_id, Cloud { points: view.to_points(), origin: [0.0; 3] }))
}

/// A reader of messages in CDR, the encoding of ROS 2, in which numbers are aligned to their size from the end of the header,
/// or in the encoding of ROS 1, which has no alignment.
struct MessageReader<'a> {
    data: &'a [u8],
    place: usize,
    is_little_endian: bool,
    is_aligned: bool,
}

impl<'a> MessageReader<'a> {
    /// At the time in the header of a message.
    fn new(encoding: &str, data: &'a [u8]) -> std::result::Result<Self, String> {
        match (encoding, data) {
            // The number of the message comes before its time.
            ("ros1", [_, _, _, _, data @ ..]) => Ok(Self { data, place: 0, is_little_endian: true, is_aligned: false }),
            ("cdr", [0, kind @ (0 | 1), _, _, data @ ..]) => {
                Ok(Self { data, place: 0, is_little_endian: *kind == 1, is_aligned: true })
            }
            _ => Err(format!("{} bytes that are not encoded as `cdr` or `ros1`, but as `{encoding}`", data.len())),
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
        if self.is_aligned {
            self.place = self.place.next_multiple_of(4);
        }
        let mut bytes = [0; 4];
        bytes.copy_from_slice(self.bytes(4)?);
        Ok(if self.is_little_endian { u32::from_le_bytes(bytes) } else { u32::from_be_bytes(bytes) } as usize)
    }

    /// A text with its length before it, in ROS 2 with a zero at its end.
    fn text(&mut self) -> std::result::Result<String, String> {
        let length = self.number()?;
        let bytes = self.bytes(length)?;
        Ok(String::from_utf8_lossy(bytes.strip_suffix(&[0]).unwrap_or(bytes)).into_owned())
    }

    fn skip_time(&mut self) -> std::result::Result<(), String> {
        self.bytes(8).map(drop)
    }
}

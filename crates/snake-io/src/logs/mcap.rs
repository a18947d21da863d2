//! MCAP files. A damaged chunk or a cut end only loses its own messages.

use std::collections::{HashMap, VecDeque};
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::logs::chunk::for_each_record;
use crate::logs::message::{Message, Messages};
use crate::logs::records::{MAGIC, Record, kind};
use crate::{Error, MAX_EXPANSION, Result};

/// The topics and the schemas of their messages, in the order of the file. Damage is an error only without topics.
pub(crate) fn topics(path: &Path) -> Result<Vec<(String, String)>> {
    let mut topics: Vec<(String, String)> = Vec::new();
    let mut first_error = None;
    for found in Reader::open(path, None)? {
        match found {
            Ok(Found { channel, .. }) => {
                if topics.iter().all(|(topic, _)| *topic != channel.topic) {
                    topics.push((channel.topic.clone(), channel.schema.clone()));
                }
            }
            Err(error) => first_error = first_error.or(Some(error)),
        }
    }
    match first_error {
        Some(error) if topics.is_empty() => Err(error),
        _ => Ok(topics),
    }
}

/// The messages of a topic, in the order of the file.
pub(crate) fn messages(path: &Path, topic: &str) -> Result<Messages> {
    Ok(Box::new(Reader::open(path, Some(topic.to_owned()))?.map(|found| {
        let Found { channel, log_time, data } = found?;
        Ok(Message { log_time, encoding: channel.encoding.clone(), data })
    })))
}

/// A channel: the messages of one writer to a topic.
struct Channel {
    topic: String,
    schema: String,
    encoding: String,
}

/// A message.
struct Found {
    channel: Arc<Channel>,
    log_time: u64,
    /// Empty if no topic is read.
    data: Vec<u8>,
}

/// The messages of a file, in order, or only those of one topic.
struct Reader {
    path: PathBuf,
    file: BufReader<File>,
    /// Number of bytes from here to the end of the file.
    left: u64,
    /// Maximum length of a record in bytes.
    max_record: usize,
    topic: Option<String>,
    schemas: HashMap<u16, String>,
    channels: HashMap<u16, Arc<Channel>>,
    /// The records of a chunk.
    waiting: VecDeque<Result<Found>>,
    has_ended: bool,
}

impl Reader {
    fn open(path: &Path, topic: Option<String>) -> Result<Self> {
        let io_error = |source| Error::Io { path: path.into(), source };
        let file = File::open(path).map_err(io_error)?;
        let length = file.metadata().map_err(io_error)?.len();
        // A damaged length could otherwise take all memory. Lengths in ROS messages have 32 bits.
        let max_record = length.saturating_mul(MAX_EXPANSION as u64).min(u32::MAX.into()) as usize;
        let mut reader = Self {
            path: path.into(),
            file: BufReader::with_capacity(1 << 20, file),
            left: length,
            max_record,
            topic,
            schemas: HashMap::new(),
            channels: HashMap::new(),
            waiting: VecDeque::new(),
            has_ended: false,
        };
        if reader.bytes(MAGIC.len() as u64)? != MAGIC {
            return Err(reader.refused("no MCAP file: it does not begin with the bytes 89 `MCAP0`"));
        }
        Ok(reader)
    }

    fn refused(&self, reason: impl Into<String>) -> Error {
        Error::Format { path: self.path.clone(), reason: reason.into() }
    }

    fn cut(&self) -> Error {
        self.refused("cut short; the messages before are read. To repair the file: mcap recover IN.mcap -o OUT.mcap")
    }

    fn io(&self, source: std::io::Error) -> Error {
        Error::Io { path: self.path.clone(), source }
    }

    /// The next `length` bytes, or fewer at the end of the file.
    fn bytes(&mut self, length: u64) -> Result<Vec<u8>> {
        let mut bytes = Vec::new();
        let length = length.min(self.left);
        self.file.by_ref().take(length).read_to_end(&mut bytes).map_err(|source| self.io(source))?;
        self.left -= length;
        Ok(bytes)
    }

    fn skip(&mut self, length: u64) -> Result<()> {
        let length = length.min(self.left);
        self.file.seek_relative(length as i64).map_err(|source| self.io(source))?;
        self.left -= length;
        Ok(())
    }

    /// Reads the next record. Its messages are appended to `waiting`.
    fn read_record(&mut self) -> Result<()> {
        let head = self.bytes(9)?;
        let Ok::<[u8; 9], _>([kind, length @ ..]) = head.as_slice().try_into() else { return Err(self.cut()) };
        let length = u64::from_le_bytes(length);
        let is_whole = length <= self.left;
        match kind {
            kind::DATA_END => return self.check_end(),
            kind::CHUNK => {
                let body = self.bytes(length)?;
                self.read_chunk(&body, is_whole);
            }
            kind::SCHEMA | kind::CHANNEL | kind::MESSAGE if is_whole => {
                let body = self.bytes(length)?;
                let message = self.add(kind, &body).map_err(|reason| self.refused(reason))?;
                self.waiting.extend(message.map(Ok));
            }
            0 => return Err(self.refused("damaged: a record of the kind 0")),
            _ => self.skip(length)?,
        }
        if is_whole { Ok(()) } else { Err(self.cut()) }
    }

    /// Checks that the file ends as it began. The summary before the end is not read.
    fn check_end(&mut self) -> Result<()> {
        self.has_ended = true;
        let end = MAGIC.len() as i64;
        if self.left < MAGIC.len() as u64 {
            return Err(self.cut());
        }
        self.file.seek(SeekFrom::End(-end)).map_err(|source| self.io(source))?;
        self.left = end as u64;
        if self.bytes(end as u64)? == MAGIC { Ok(()) } else { Err(self.cut()) }
    }

    /// Reads the messages of a chunk. Messages of a damaged chunk are dropped, because its checksum
    /// covers all of them; messages of a chunk that the end of the file cuts short are kept.
    fn read_chunk(&mut self, body: &[u8], is_whole: bool) {
        let mut messages = Vec::new();
        let result = for_each_record(body, self.max_record, |kind, content| {
            messages.extend(self.add(kind, content)?);
            Ok(())
        });
        match result {
            Err(reason) if is_whole => self.waiting.push_back(Err(self.refused(reason))),
            _ => self.waiting.extend(messages.into_iter().map(Ok)),
        }
    }

    /// Stores a schema or a channel; returns a message of the topic.
    fn add(&mut self, kind: u8, content: &[u8]) -> std::result::Result<Option<Found>, String> {
        match Record::parse(kind, content).map_err(|error| format!("a record is damaged: {error}"))? {
            Record::Schema { id, name } => {
                self.schemas.insert(id, name);
            }
            Record::Channel { id, schema_id, topic, encoding } => {
                let schema = self.schemas.get(&schema_id).map_or("without a schema", |name| name).to_owned();
                self.channels.insert(id, Arc::new(Channel { topic, schema, encoding }));
            }
            Record::Message { channel_id, log_time, data } => {
                let Some(channel) = self.channels.get(&channel_id) else {
                    return Err(format!("a message of channel {channel_id}, which is not there"));
                };
                let data = match &self.topic {
                    Some(topic) if *topic != channel.topic => return Ok(None),
                    Some(_) => data.to_vec(),
                    None => Vec::new(),
                };
                return Ok(Some(Found { channel: channel.clone(), log_time, data }));
            }
            Record::Other => (),
        }
        Ok(None)
    }
}

impl Iterator for Reader {
    type Item = Result<Found>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            if let Some(found) = self.waiting.pop_front() {
                return Some(found);
            }
            if self.has_ended {
                return None;
            }
            if let Err(error) = self.read_record() {
                self.has_ended = true;
                self.waiting.push_back(Err(error));
            }
        }
    }
}

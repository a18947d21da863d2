//! MCAP files.

use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use ::mcap::McapError;
use ::mcap::io::MessageReader;
use ::mcap::sans_io::LinearReaderOptions;

use crate::message::{Message, Messages};
use crate::{Error, MAX_EXPANSION, Result};

/// The topics and the schemas of their messages, in the order of the file. A damaged end is left to the reader.
pub(crate) fn topics(path: &Path) -> Result<Vec<(String, String)>> {
    let mut topics: Vec<(String, String)> = Vec::new();
    for message in open(path)? {
        let message = match message {
            Ok(message) => message,
            Err(error) if topics.is_empty() => return Err(refused(path, error)),
            Err(_) => break,
        };
        let schema = message.channel.schema.as_ref().map_or("without a schema", |schema| &schema.name);
        if topics.iter().all(|(topic, _)| *topic != message.channel.topic) {
            topics.push((message.channel.topic.clone(), schema.to_owned()));
        }
    }
    Ok(topics)
}

/// The messages of a topic, in the order of the file.
pub(crate) fn messages(path: &Path, topic: &str) -> Result<Messages> {
    let (path, topic) = (PathBuf::from(path), topic.to_owned());
    let messages = open(&path)?.filter(move |message| message.as_ref().map_or(true, |it| it.channel.topic == topic));
    Ok(Box::new(messages.map(move |message| {
        let message = message.map_err(|error| refused(&path, error))?;
        let encoding = message.channel.message_encoding.clone();
        Ok(Message { log_time: message.log_time, encoding, data: message.data.into_owned() })
    })))
}

fn open(path: &Path) -> Result<MessageReader<BufReader<File>>> {
    let io_error = |source| Error::Io { path: path.into(), source };
    let file = File::open(path).map_err(io_error)?;
    let length = file.metadata().map_err(io_error)?.len();
    // A damaged length would otherwise take all memory. Lengths in messages of ROS have 32 bits.
    let most = length.saturating_mul(MAX_EXPANSION as u64).min(u32::MAX.into());
    let options = LinearReaderOptions::default().with_record_length_limit(most as usize);
    Ok(MessageReader::new_with_options(BufReader::with_capacity(1 << 20, file), options))
}

fn refused(path: &Path, error: McapError) -> Error {
    match error {
        McapError::Io(source) => Error::Io { path: path.into(), source },
        error => Error::Format { path: path.into(), reason: error.to_string() },
    }
}

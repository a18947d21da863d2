//! Bags of ROS 2 in SQLite files, `.db3`: a table of topics and a table of messages.

use std::path::{Path, PathBuf};

use rusqlite::config::DbConfig;
use rusqlite::limits::Limit;
use rusqlite::types::FromSqlError;
use rusqlite::{Connection, OpenFlags};

use crate::bag_folder::COMPRESSED;
use crate::message::{Message, Messages};
use crate::{Error, Result};

/// The first bytes of a message that rosbag2 compressed.
const ZSTD_MAGIC: &[u8] = &[0x28, 0xb5, 0x2f, 0xfd];

/// A bag that is open for reading.
pub(crate) struct Bag {
    path: PathBuf,
    connection: Connection,
}

impl Bag {
    pub(crate) fn open(path: &Path) -> Result<Self> {
        let length = std::fs::metadata(path).map_err(|source| Error::Io { path: path.into(), source })?.len();
        let open = || -> rusqlite::Result<Connection> {
            let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
            let bag = Connection::open_with_flags(path, flags)?;
            // The file may come from anybody: it is data, and nothing in it runs.
            bag.set_db_config(DbConfig::SQLITE_DBCONFIG_DEFENSIVE, true)?;
            for feature in [
                DbConfig::SQLITE_DBCONFIG_TRUSTED_SCHEMA,
                DbConfig::SQLITE_DBCONFIG_ENABLE_VIEW,
                DbConfig::SQLITE_DBCONFIG_ENABLE_TRIGGER,
            ] {
                bag.set_db_config(feature, false)?;
            }
            // No value is longer than the file.
            bag.set_limit(Limit::SQLITE_LIMIT_LENGTH, i32::try_from(length).unwrap_or(i32::MAX).max(4096))?;
            Ok(bag)
        };
        let connection = open().map_err(|error| refused(path, error))?;
        Ok(Self { path: path.into(), connection })
    }

    /// The topics and the types of their messages.
    pub(crate) fn topics(&self) -> Result<Vec<(String, String)>> {
        let read = || -> rusqlite::Result<Vec<(String, String)>> {
            let mut query = self.connection.prepare("SELECT name, type FROM topics ORDER BY id")?;
            query.query_map([], |row| Ok((row.get(0)?, row.get(1)?)))?.collect()
        };
        read().map_err(|error| refused(&self.path, error))
    }

    /// The messages of a topic, by time.
    pub(crate) fn messages(self, topic: &str) -> Result<Messages> {
        let read = || -> rusqlite::Result<Vec<i64>> {
            let mut query = self.connection.prepare(
                "SELECT id FROM messages WHERE topic_id IN (SELECT id FROM topics WHERE name = ?1) ORDER BY timestamp, id",
            )?;
            query.query_map([topic], |row| row.get(0))?.collect()
        };
        let numbers = read().map_err(|error| refused(&self.path, error))?;
        Ok(Box::new(numbers.into_iter().map(move |number| self.message(number))))
    }

    fn message(&self, number: i64) -> Result<Message> {
        let sql = |error| refused(&self.path, error);
        let wrong = |reason: String| Error::Format { path: self.path.clone(), reason };
        let of_type = |error: FromSqlError| wrong(format!("message {number}: {error}"));
        let mut query = self
            .connection
            .prepare_cached(
                "SELECT messages.timestamp, topics.serialization_format, messages.data FROM messages \
                 JOIN topics ON topics.id = messages.topic_id WHERE messages.id = ?1",
            )
            .map_err(sql)?;
        let mut rows = query.query([number]).map_err(sql)?;
        let row = rows.next().map_err(sql)?.ok_or_else(|| wrong(format!("message {number} is missing")))?;
        let value = |column: usize| row.get_ref(column).map_err(sql);
        let (time, encoding) = (value(0)?.as_i64().map_err(of_type)?, value(1)?.as_str().map_err(of_type)?);
        let data = value(2)?.as_blob().map_err(of_type)?;
        if data.starts_with(ZSTD_MAGIC) {
            return Err(wrong(COMPRESSED.into()));
        }
        Ok(Message { log_time: u64::try_from(time).unwrap_or(0), encoding: encoding.into(), data: data.into() })
    }
}

fn refused(path: &Path, error: rusqlite::Error) -> Error {
    Error::Format { path: path.into(), reason: format!("no bag of ROS 2 that can be read: {error}") }
}

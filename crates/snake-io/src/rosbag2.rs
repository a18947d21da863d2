//! Bags of ROS 2 in SQLite files, `.db3`: a table of topics and a table of messages.

use std::path::Path;

use rusqlite::config::DbConfig;
use rusqlite::limits::Limit;
use rusqlite::{Connection, OpenFlags};

use crate::message::Message;

/// The first bytes of a message that rosbag2 compressed.
const ZSTD_MAGIC: &[u8] = &[0x28, 0xb5, 0x2f, 0xfd];

/// A bag that is open for reading.
pub(crate) struct Bag(Connection);

impl Bag {
    /// Opens a file of so many bytes.
    pub(crate) fn open(path: &Path, length: u64) -> Result<Self, String> {
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
        open().map(Self).map_err(refused)
    }

    /// The topics and the types of their messages.
    pub(crate) fn topics(&self) -> Result<Vec<(String, String)>, String> {
        let read = || -> rusqlite::Result<Vec<(String, String)>> {
            let mut query = self.0.prepare("SELECT name, type FROM topics ORDER BY id")?;
            query.query_map([], |row| Ok((row.get(0)?, row.get(1)?)))?.collect()
        };
        read().map_err(refused)
    }

    /// The numbers of the messages of a topic, by time.
    pub(crate) fn messages(&self, topic: &str) -> Result<Vec<i64>, String> {
        let read = || -> rusqlite::Result<Vec<i64>> {
            let mut query = self.0.prepare(
                "SELECT id FROM messages WHERE topic_id IN (SELECT id FROM topics WHERE name = ?1) ORDER BY timestamp, id",
            )?;
            query.query_map([topic], |row| row.get(0))?.collect()
        };
        read().map_err(refused)
    }

    /// Calls `use_message` with a message.
    pub(crate) fn use_message<T>(&self, id: i64, use_message: impl FnOnce(Message) -> T) -> Result<T, String> {
        let mut query = self
            .0
            .prepare_cached(
                "SELECT messages.timestamp, topics.serialization_format, messages.data FROM messages \
                 JOIN topics ON topics.id = messages.topic_id WHERE messages.id = ?1",
            )
            .map_err(refused)?;
        let mut rows = query.query([id]).map_err(refused)?;
        let row = rows.next().map_err(refused)?.ok_or_else(|| format!("message {id} is missing"))?;
        let value = |column: usize| row.get_ref(column).map_err(refused);
        let wrong = |error: rusqlite::types::FromSqlError| format!("message {id}: {error}");
        let (time, encoding) = (value(0)?.as_i64().map_err(wrong)?, value(1)?.as_str().map_err(wrong)?);
        let data = value(2)?.as_blob().map_err(wrong)?;
        if data.starts_with(ZSTD_MAGIC) {
            return Err("its messages are compressed; write them without compression: ros2 bag convert -i FOLDER -o \
                        OPTIONS.yaml with output_bags: [{uri: drive, storage_id: mcap, all: true}]"
                .into());
        }
        Ok(use_message(Message { log_time: u64::try_from(time).unwrap_or(0), encoding, data }))
    }
}

fn refused(error: rusqlite::Error) -> String {
    format!("no bag of ROS 2 that can be read: {error}")
}

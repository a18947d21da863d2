//! Bags of ROS 2 in SQLite files, `.db3`: a table of topics and a table of messages.

use std::path::{Path, PathBuf};

use rusqlite::config::DbConfig;
use rusqlite::limits::Limit;
use rusqlite::types::FromSqlError;

use crate::logs::bag_folder::COMPRESSED;
use crate::logs::message::{Message, Messages};
use crate::logs::sqlite_file::Database;
use crate::{Error, Result};

/// The first bytes of a message that rosbag2 compressed.
const ZSTD_MAGIC: &[u8] = &[0x28, 0xb5, 0x2f, 0xfd];

const UNREADABLE: &str = "no bag of ROS 2 that can be read";

/// A bag that is open for reading.
pub(crate) struct Bag {
    path: PathBuf,
    database: Database,
}

impl Bag {
    pub(crate) fn open(path: &Path) -> Result<Self> {
        let length = std::fs::metadata(path).map_err(|source| Error::Io { path: path.into(), source })?.len();
        let wrong = |reason: String| Error::Format { path: path.into(), reason: format!("{UNREADABLE}: {reason}") };
        let database = Database::open(path).map_err(wrong)?;
        let bag = &database.connection;
        let restrict = || -> rusqlite::Result<()> {
            // The file may come from anybody: it is data, and nothing in it runs.
            bag.set_db_config(DbConfig::SQLITE_DBCONFIG_DEFENSIVE, true)?;
            for feature in [
                DbConfig::SQLITE_DBCONFIG_TRUSTED_SCHEMA,
                DbConfig::SQLITE_DBCONFIG_ENABLE_VIEW,
                DbConfig::SQLITE_DBCONFIG_ENABLE_TRIGGER,
            ] {
                bag.set_db_config(feature, false)?;
            }
            // No value is longer than the file and its journal.
            let journal =
                std::fs::metadata(crate::logs::sqlite_file::beside(path, "-wal")).map_or(0, |journal| journal.len());
            let most = i32::try_from(length.saturating_add(journal)).unwrap_or(i32::MAX);
            bag.set_limit(Limit::SQLITE_LIMIT_LENGTH, most.max(4096))?;
            Ok(())
        };
        restrict().map_err(|error| refused(path, error))?;
        Ok(Self { path: path.into(), database })
    }

    /// The topics and the types of their messages.
    pub(crate) fn topics(&self) -> Result<Vec<(String, String)>> {
        let read = || -> rusqlite::Result<Vec<(String, String)>> {
            let mut query = self.database.connection.prepare("SELECT name, type FROM topics ORDER BY id")?;
            query.query_map([], |row| Ok((row.get(0)?, row.get(1)?)))?.collect()
        };
        read().map_err(|error| refused(&self.path, error))
    }

    /// The messages of a topic, by time. Where the table is damaged, those that can be found come before the error.
    pub(crate) fn messages(self, topic: &str) -> Result<Messages> {
        let mut times: Vec<(i64, i64)> = Vec::new();
        let mut read = || -> rusqlite::Result<()> {
            let mut query = self.database.connection.prepare(
                "SELECT timestamp, id FROM messages WHERE topic_id IN (SELECT id FROM topics WHERE name = ?1)",
            )?;
            let mut rows = query.query([topic])?;
            while let Some(row) = rows.next()? {
                times.push((row.get(0)?, row.get(1)?));
            }
            Ok(())
        };
        let damage = read().err().map(|error| Err(refused(&self.path, error)));
        times.sort_unstable();
        // All messages are compressed, or none.
        if let Some(&(_, first)) = times.first()
            && self.message(first).is_ok_and(|message| message.data.starts_with(ZSTD_MAGIC))
        {
            return Err(Error::Format { path: self.path, reason: COMPRESSED.into() });
        }
        Ok(Box::new(times.into_iter().map(move |(_, number)| self.message(number)).chain(damage)))
    }

    fn message(&self, number: i64) -> Result<Message> {
        let sql = |error| refused(&self.path, error);
        let wrong = |reason: String| Error::Format { path: self.path.clone(), reason };
        let type_error = |error: FromSqlError| wrong(format!("message {number}: {error}"));
        let mut query = self
            .database
            .connection
            .prepare_cached(
                "SELECT messages.timestamp, topics.serialization_format, messages.data FROM messages \
                 JOIN topics ON topics.id = messages.topic_id WHERE messages.id = ?1",
            )
            .map_err(sql)?;
        let mut rows = query.query([number]).map_err(sql)?;
        let row = rows.next().map_err(sql)?.ok_or_else(|| wrong(format!("message {number} is missing")))?;
        let value = |column: usize| row.get_ref(column).map_err(sql);
        let (time, encoding) = (value(0)?.as_i64().map_err(type_error)?, value(1)?.as_str().map_err(type_error)?);
        let data = value(2)?.as_blob().map_err(type_error)?;
        Ok(Message { log_time: u64::try_from(time).unwrap_or(0), encoding: encoding.into(), data: data.into() })
    }
}

fn refused(path: &Path, error: rusqlite::Error) -> Error {
    Error::Format { path: path.into(), reason: format!("{UNREADABLE}: {error}") }
}

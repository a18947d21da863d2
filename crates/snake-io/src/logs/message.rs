//! Messages of a recording, as they are stored.

use crate::Result;

/// A message.
pub(crate) struct Message {
    /// Nanoseconds since 1970.
    pub(crate) log_time: u64,
    /// `cdr` or `ros1`.
    pub(crate) encoding: String,
    pub(crate) data: Vec<u8>,
}

/// The messages of a topic in a file.
pub(crate) type Messages = Box<dyn Iterator<Item = Result<Message>> + Send>;

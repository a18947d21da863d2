//! A message of a recording, as its file holds it.

/// The bytes of a message.
pub(crate) struct Message<'a> {
    /// Nanoseconds since 1970.
    pub(crate) log_time: u64,
    /// `cdr` or `ros1`.
    pub(crate) encoding: &'a str,
    pub(crate) data: &'a [u8],
}

//! Recordings of robots: MCAP.

pub(crate) mod chunk;
pub(crate) mod mcap;
pub(crate) mod message;
pub(crate) mod recording;
pub(crate) mod records;
pub(crate) mod ros_message;
pub(crate) mod topics;

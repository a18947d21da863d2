//! Recordings of robots: MCAP, bags of ROS 2.

pub(crate) mod bag_folder;
pub(crate) mod chunk;
pub(crate) mod mcap;
pub(crate) mod message;
pub(crate) mod metadata;
pub(crate) mod recording;
pub(crate) mod records;
pub(crate) mod ros_message;
#[cfg(feature = "rosbag2")]
pub(crate) mod rosbag2;
#[cfg(feature = "rosbag2")]
pub(crate) mod sqlite_file;
pub(crate) mod topics;

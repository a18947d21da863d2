//! One cloud after another: the same memory again, a time for each, and which keypoint was seen before.

mod detector;
mod realtime;
mod tracker;

pub use detector::FrameDetector;
pub use tracker::{Tracker, TrackerOptions};

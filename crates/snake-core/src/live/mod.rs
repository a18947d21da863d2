//! One cloud after another, in the same memory.

mod detector;

pub use detector::FrameDetector;

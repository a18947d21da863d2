//! A sequence of clouds, in the same memory.

mod detector;

pub use detector::FrameDetector;

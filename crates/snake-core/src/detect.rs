//! Keypoint detection (SNAKE Algorithm 1).

use crate::points::Point;

/// One keypoint, in the frame and units of the input cloud.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Keypoint {
    /// Position in cloud units.
    pub position: Point,
    /// Saliency in [0, 1]; the score that keypoints are ranked by.
    pub saliency: f32,
    /// Occupancy in [0, 1] at the position.
    pub occupancy: f32,
    /// Index of the nearest input point.
    pub nearest_index: usize,
}

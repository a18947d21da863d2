//! Keypoints.

use serde::{Deserialize, Serialize};

use crate::{Covariance, Point};

/// One keypoint, in the frame and units of the input cloud.
///
/// Serde writes the keys x, y, z, saliency, occupancy, nearest_index, confidence and covariance.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(from = "KeypointRecord", into = "KeypointRecord")]
pub struct Keypoint {
    /// Position in cloud units.
    pub position: Point,
    /// Saliency in [0, 1]. With mode seeking, it is the mean of the saliency at the candidate's start and the highest
    /// one near its end. Keypoints are ranked by it; in scenes, also by how well the points determine the position.
    pub saliency: f32,
    /// Occupancy in [0, 1] at the position.
    pub occupancy: f32,
    /// Index of the nearest input point in the given cloud.
    pub nearest_index: usize,
    /// Probability in [0, 1] that another view of the same surface finds it again: within 4 % of an object's radius, or within
    /// two voxels of a scene and at most 1/104 of its box's diagonal. `None` if the model's file has no map of confidences.
    pub confidence: Option<f32>,
    /// The covariance of the position, from the planes of the points around it.
    pub covariance: Covariance,
}

/// A [`Keypoint`] as it is stored in files.
#[derive(Serialize, Deserialize)]
struct KeypointRecord {
    x: f32,
    y: f32,
    z: f32,
    saliency: f32,
    occupancy: f32,
    nearest_index: usize,
    #[serde(default)]
    confidence: Option<f32>,
    #[serde(default = "unknown")]
    covariance: Covariance,
}

fn unknown() -> Covariance {
    Covariance::UNKNOWN
}

impl From<Keypoint> for KeypointRecord {
    fn from(
        Keypoint { position: [x, y, z], saliency, occupancy, nearest_index, confidence, covariance }: Keypoint,
    ) -> Self {
        Self { x, y, z, saliency, occupancy, nearest_index, confidence, covariance }
    }
}

impl From<KeypointRecord> for Keypoint {
    fn from(
        KeypointRecord { x, y, z, saliency, occupancy, nearest_index, confidence, covariance }: KeypointRecord,
    ) -> Self {
        Self { position: [x, y, z], saliency, occupancy, nearest_index, confidence, covariance }
    }
}

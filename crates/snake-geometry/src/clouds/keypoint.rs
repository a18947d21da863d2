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
    /// Saliency in [0, 1]; the score that keypoints are ranked by. With mode seeking it is the mean of the saliency where the
    /// candidate started and of the highest one where it ended.
    pub saliency: f32,
    /// Occupancy in [0, 1] at the position.
    pub occupancy: f32,
    /// Index of the nearest input point, in the cloud as it was given.
    pub nearest_index: usize,
    /// Probability in [0, 1] that another view of the same surface finds it again: within 4 % of the radius of an object, two
    /// voxels of a scene or less: at most a 104th of its box's diagonal. `None` if the model's file has no map of confidences.
    pub confidence: Option<f32>,
    /// The covariance of the position, by the planes of the points around it.
    pub covariance: Covariance,
}

/// A [`Keypoint`] in files.
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

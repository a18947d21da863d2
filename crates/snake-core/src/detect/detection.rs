//! The result of a detection.

use serde::{Deserialize, Serialize};

use crate::options::DetectOptions;
use snake_geometry::{Keypoint, Normalization};

/// The result of a detection: keypoints, counts and run times.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Detection {
    /// The keypoints, best first: by saliency, in scenes also by how well the points determine them; or corners first.
    pub keypoints: Vec<Keypoint>,
    /// Number of points of the cloud that were skipped because they are not finite, missing returns or outliers.
    pub num_skipped: usize,
    /// Number of points that were encoded.
    pub num_encoded: usize,
    /// The normalisation of the cloud; `None` before the first detection.
    pub normalization: Option<Normalization>,
    /// The size of a voxel of the volume in cloud units; `None` before the first detection.
    #[serde(default)]
    pub voxel_size: Option<f32>,
    /// Number of queries after each step.
    pub counts: Counts,
    /// Run time of each step; `timing_seconds` in JSON.
    #[serde(rename = "timing_seconds")]
    pub timing: Timing,
}

/// Two clouds with fewer keypoints hardly register; [`Detection::note`] then says why there are so few.
const FEW: usize = 8;

impl Detection {
    /// A sentence for the user if there are fewer than eight keypoints although the options allow more: what may find more.
    pub fn note(&self, options: &DetectOptions) -> Option<String> {
        let text = match self.counts {
            Counts { occupied: 0, .. } => "a lower `occupancy_threshold`, such as 0.3, may find some",
            Counts { above_threshold: 0, .. } => "a lower `saliency_threshold` may find some",
            _ if options.min_confidence.is_none() => "a smaller `nms_radius` may keep more",
            _ => {
                "few places are found again more often than chance, as on a flat wall: half or twice the `voxel_size` may show \
                 more, `min_confidence` 0 gives all; if it is one object, name the model `compact`"
            }
        };
        let number = match self.keypoints.len() {
            0 => "no keypoints".into(),
            1 => "one keypoint".into(),
            number => format!("{number} keypoints"),
        };
        (self.keypoints.len() < options.max_keypoints.min(FEW)).then(|| format!("{number}: {text}"))
    }
}

/// Number of queries after each step of [`Field::detect`](crate::Field::detect).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Counts {
    /// Queries of the query grid.
    pub queries: usize,
    /// Queries above the occupancy threshold.
    pub occupied: usize,
    /// Queries above the saliency threshold after refinement.
    pub above_threshold: usize,
    /// Keypoints after suppression.
    pub keypoints: usize,
}

impl Counts {
    /// Adds the counts of another tile.
    pub fn add(&mut self, other: &Self) {
        self.queries += other.queries;
        self.occupied += other.occupied;
        self.above_threshold += other.above_threshold;
    }
}

/// Run time of each step of detection, in seconds.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Timing {
    /// Encoding; 0 for [`Field::detect`](crate::Field::detect), which starts from a field.
    pub encode: f64,
    /// Occupancy of the query grid.
    pub occupancy: f64,
    /// Refinement.
    pub refine: f64,
    /// Threshold, suppression, nearest points.
    pub nms: f64,
}

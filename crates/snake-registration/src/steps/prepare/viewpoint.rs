//! The sensor's position.

use crate::cloud::depth_image::{COARSE, DepthImage};
use crate::result::ViewpointUsed;
use snake_geometry::{Point, Sensor, Vector};

/// Signs of normals are doubtful if less than this share of the cloud is visible. Unit: share of the voxels. Scans have 0.7
/// and more even if the sensor moved.
const MIN_VISIBLE: f64 = 0.65;

/// A sensor, and how it is known.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Viewpoint {
    pub(crate) sensor: Sensor,
    pub(crate) used: ViewpointUsed,
}

impl Viewpoint {
    /// The given viewpoint of a cloud, or else the one that is estimated from its points.
    pub(super) fn new(points: &[Point], given: Option<[f64; 3]>) -> Option<Self> {
        if let Some(given) = given {
            return Some(Self { sensor: Sensor::at(given, points), used: ViewpointUsed::Given });
        }
        let sensor = Sensor::find(points)?;
        let used = if sensor.position == [0.0; 3] { ViewpointUsed::Origin } else { ViewpointUsed::Found };
        Some(Self { sensor, used })
    }

    pub(crate) fn place(&self) -> Vector {
        self.sensor.position.into()
    }

    /// Whether most voxels of a cloud are visible from the sensor.
    pub(super) fn sees_most_of(&self, voxels: &[Vector], inlier_distance: f64) -> bool {
        DepthImage::new(voxels, self.place(), inlier_distance, COARSE).visible_share(voxels) >= MIN_VISIBLE
    }
}

//! The sensor's position.

use crate::cloud::depth_image::{COARSE, DepthImage};
use crate::result::ViewpointUsed;
use snake_geometry::{Point, Sensor, Vector};

/// The frame's origin is taken for the sensor's position if this share of the cloud is visible from there. Unit: share
/// of the voxels. Scans have 0.7 and more even if the sensor moved, whole objects about half.
const MIN_VISIBLE: f64 = 0.65;
/// And if all points lie ahead of it: the mean of the unit vectors to them is longer than this. Fused images of a camera
/// have 0.9 and more, a model about its origin 0 to 0.1, and so has what several scanners saw around them.
const MIN_AHEAD: f64 = 0.5;

/// A sensor, and how it is known.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Viewpoint {
    pub(crate) sensor: Sensor,
    pub(crate) used: ViewpointUsed,
}

impl Viewpoint {
    /// The viewpoint of a cloud as given, or as its points tell.
    pub(super) fn known(points: &[Point], given: Option<[f64; 3]>) -> Option<Self> {
        if let Some(given) = given {
            return Some(Self { sensor: Sensor::at(given, points), used: ViewpointUsed::Given });
        }
        let sensor = Sensor::find(points)?;
        let used = if sensor.position == [0.0; 3] { ViewpointUsed::Origin } else { ViewpointUsed::Found };
        Some(Self { sensor, used })
    }

    /// The origin of the frame of a cloud that has these voxels, if a camera may have been there, as of fused images.
    pub(super) fn at_origin(points: &[Point], voxels: &[Vector], inlier_distance: f64) -> Option<Self> {
        let ahead = voxels.iter().filter_map(|voxel| voxel.try_normalize(0.0)).sum::<Vector>() / voxels.len() as f64;
        let origin = Self { sensor: Sensor::at([0.0; 3], points), used: ViewpointUsed::Origin };
        (ahead.norm() > MIN_AHEAD && origin.sees_most_of(voxels, inlier_distance)).then_some(origin)
    }

    pub(crate) fn place(&self) -> Vector {
        self.sensor.position.into()
    }

    /// Whether most of a cloud is visible, as far as its voxels can show.
    pub(super) fn sees_most_of(&self, voxels: &[Vector], inlier_distance: f64) -> bool {
        DepthImage::new(voxels, self.place(), inlier_distance, COARSE).visible_share(voxels) >= MIN_VISIBLE
    }
}

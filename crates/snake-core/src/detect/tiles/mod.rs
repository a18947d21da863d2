//! Detection of one tile of a cloud that is too large for memory. Tiles give the keypoints of the whole cloud, bit for bit.
//!
//! The voxels of a scene lie on a lattice that begins below the lowest corner of the whole cloud. A tile owns
//! whole columns along x and y, as wide as a block of the network's coarsest level. The output of the network at
//! a voxel depends on the points of its column and of [`PlacedDetector::halo`] columns around it. Mode seeking
//! uses the candidates of some more columns ([`PlacedDetector::margin`]). [`PlacedDetector::fates`] suppresses
//! the candidates of all tiles together and tells where a tile needs more candidates of its neighbours.

mod candidate;
mod placed;
#[cfg(test)]
mod tests;

pub use self::candidate::{Candidate, TileCandidates, by_rank};
pub use self::placed::{PlacedDetector, TileOutcome};

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::{Counts, diagonal};
use crate::cloud::UsedCloud;
use crate::control::Control;
use crate::lattice::voxel_size;
use crate::network::Network;
use crate::options::{DetectOptions, Options, Preference, mode_of_scene};
use crate::{Error, Result};
use snake_geometry::{Length, Point};
use snake_kernels::BLOCK_SIDE;

/// A scene model with options for detection in tiles. [`TileDetector::place`] adapts it to one cloud.
#[derive(Debug, Clone)]
pub struct TileDetector {
    network: Arc<Network>,
    options: Options,
}

/// The fingerprint of everything that decides the candidates of a tile, apart from the cloud.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TileSettings {
    /// The BLAKE3 digest of the model's weight file.
    pub model: String,
    /// The options.
    pub options: Options,
}

impl TileDetector {
    /// A tile detector for a network, see [`TileDetector::new`].
    pub(crate) fn for_network(network: Arc<Network>, options: &Options) -> Result<Self> {
        let name = network.metadata.get("name").map_or("a model of objects", String::as_str);
        network.config.volume.check_tiles(name)?;
        network.check(options)?;
        check_parts(&options.detect, options.encode.max_points)?;
        let detector = Self { network, options: *options };
        if !detector.needs_voxel_size() {
            detector.voxel_size()?;
        }
        Ok(detector)
    }

    /// Whether the options have no voxel size.
    pub fn needs_voxel_size(&self) -> bool {
        self.options.encode.voxel_size.is_none()
    }

    /// Chooses the voxel size for all finite points of the cloud, as
    /// [`Model::encode`](crate::Model::encode) does, and stores it in the options.
    ///
    /// # Errors
    /// [`Error::Input`] for a cloud without extent.
    pub fn choose_voxel_size(&mut self, points: &[Point]) -> Result<()> {
        let chosen = voxel_size(None, &UsedCloud::new(points)?, &Control::default())?;
        self.options.encode.voxel_size = Some(Length::Units(chosen.into()));
        Ok(())
    }

    fn voxel_size(&self) -> Result<f32> {
        match self.options.encode.voxel_size {
            Some(length @ Length::Units(_)) => Ok(length.in_units("voxel_size", &[])? as f32),
            other => {
                let value = other.map_or("none".into(), |length| length.to_string());
                let allowed = "a length in cloud units in tiles, such as `0.1`";
                Err(Error::Option { name: "voxel_size", value, allowed })
            }
        }
    }

    /// The side of a column in cloud units.
    ///
    /// # Errors
    /// [`Error::Option`] without a voxel size.
    pub fn column_side(&self) -> Result<f64> {
        Ok(column_side(&self.network, self.voxel_size()?))
    }

    /// Whether the options give a length in multiples of the cloud's resolution.
    pub fn needs_resolution(&self) -> bool {
        let lengths = [self.options.detect.nms_radius, self.options.detect.mode_radius];
        lengths.iter().any(|length| matches!(length, Some(Length::Resolutions(_))))
    }

    /// The detector for the tiles of one cloud. `low` and `high` are the lowest and the highest coordinates
    /// of its finite points along each axis. The lattice and its columns begin at the lowest corner.
    ///
    /// Lengths in `r` are multiples of the [resolution](snake_geometry::resolution) of the whole cloud.
    /// Without it they are ignored, and the detector only tells which points are in which columns.
    ///
    /// # Errors
    /// [`Error::Option`] without a voxel size, and for a length out of its range.
    pub fn place(&self, [low, high]: [Point; 2], resolution: Option<f64>) -> Result<PlacedDetector> {
        let (mut detect, voxel_size) = (self.options.detect, self.voxel_size()?);
        for (name, length) in [("nms_radius", &mut detect.nms_radius), ("mode_radius", &mut detect.mode_radius)] {
            if let Some(multiple @ Length::Resolutions(_)) = *length {
                let known = resolution.map(|resolution| match name {
                    "mode_radius" => mode_of_scene(multiple, resolution, voxel_size),
                    _ => multiple.resolve(name, || resolution),
                });
                *length = known.transpose()?.map(Length::Units);
            }
        }
        let radii = detect.radii(&[], voxel_size, Some(diagonal(&[low, high])))?;
        Ok(PlacedDetector {
            network: self.network.clone(),
            options: self.options,
            voxel_size,
            lowest_corner: low,
            radii,
        })
    }

    /// The model and the options. Together with the cloud they decide the candidates of a tile.
    pub fn settings(&self) -> TileSettings {
        TileSettings { model: self.network.digest.clone(), options: self.options }
    }

    /// The options.
    pub fn options(&self) -> &Options {
        &self.options
    }
}

/// Number of voxels along the side of a column, which is one block of the coarsest level.
fn voxels_of_column(network: &Network) -> i32 {
    (BLOCK_SIDE as i32) << (network.config.unet_levels - 1)
}

/// The side of a column in cloud units.
fn column_side(network: &Network, voxel_size: f32) -> f64 {
    f64::from(voxels_of_column(network)) * f64::from(voxel_size)
}

/// Refuses options that need the whole cloud.
fn check_parts(detect: &DetectOptions, max_points: Option<usize>) -> Result<()> {
    let refused = |name, value: String, allowed| Err(Error::Option { name, value, allowed });
    if let Some(number) = max_points {
        return refused("max_points", number.to_string(), "none in tiles");
    }
    if detect.refine_steps > 0 {
        return refused("refine_steps", detect.refine_steps.to_string(), "0 in tiles");
    }
    if detect.prefer != Preference::Salient {
        return refused("prefer", "corners".into(), "salient in tiles");
    }
    if detect.snap {
        return refused("snap", "true".into(), "false in tiles");
    }
    for (name, length) in [("nms_radius", detect.nms_radius), ("mode_radius", detect.mode_radius)] {
        if let Some(length @ Length::Percent(_)) = length {
            let allowed = "a length in cloud units, in voxels as in `6v` or in resolutions as in `3r` in tiles";
            return refused(name, length.to_string(), allowed);
        }
    }
    Ok(())
}

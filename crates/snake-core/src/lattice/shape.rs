//! The shape of a model's volume, before a cloud is known.

use std::fmt;

use super::corner::{from_corner, lowest_corner};
use super::cube::VolumeFrame;
use super::voxel_size::{coarse_step, voxel_size};
use crate::cloud::{CoordinateStep, UsedCloud};
use crate::control::Control;
use crate::options::EncodeOptions;
use crate::{Error, Result};
use snake_geometry::rotations::{self, Rotation};
use snake_geometry::{Length, Normalization, NormalizationMethod};

/// The extent of a network's feature volume.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum VolumeShape {
    /// A cube to which every cloud is scaled, as in the paper.
    Cube(VolumeFrame),
    /// Voxels of a given size wherever the points of a scene reach
    /// ([`EncodeOptions::voxel_size`](crate::EncodeOptions::voxel_size)).
    Scene {
        /// A voxel's sum of features is divided by its total weight, but at least by this.
        scatter_mass: f32,
    },
}

impl VolumeShape {
    /// The frame of a cube; `None` for a scene model, whose volume follows the cloud.
    pub fn frame(&self) -> Option<VolumeFrame> {
        match self {
            Self::Cube(frame) => Some(*frame),
            Self::Scene { .. } => None,
        }
    }

    /// The frame of a cube.
    ///
    /// # Errors
    /// [`Error::Input`] for a scene model.
    pub(crate) fn cube(&self) -> Result<VolumeFrame> {
        let reason = "a scene model has no volume of its own: it follows the cloud";
        self.frame().ok_or_else(|| Error::Input { what: "model", reason: reason.into() })
    }

    /// The number of voxels; 0 for a scene model, where the cloud decides.
    pub(crate) fn num_voxels(&self) -> usize {
        self.frame().map_or(0, |frame| frame.resolution.iter().product())
    }

    /// Refuses options that this shape does not have.
    pub(crate) fn check(&self, options: &EncodeOptions) -> Result<()> {
        let refused = |name, value: String, allowed| Err(Error::Option { name, value, allowed });
        match (self, options.voxel_size) {
            (Self::Cube(_), None) => Ok(()),
            (Self::Cube(_), Some(size)) => {
                let allowed = "none with this model, whose volume is scaled to the cloud; use a scene model";
                refused("voxel_size", size.to_string(), allowed)
            }
            (Self::Scene { .. }, _) if options.rotations > 1 => {
                refused("rotations", options.rotations.to_string(), "1 for a scene model")
            }
            (Self::Scene { .. }, Some(size @ Length::Voxels(_))) => {
                refused("voxel_size", size.to_string(), "a length in cloud units, or as in `3r` resolutions")
            }
            (Self::Scene { .. }, _) => Ok(()),
        }
    }

    /// Refuses a volume that cannot be computed tile by tile. `name` is the model's name.
    pub(crate) fn check_tiles(&self, name: &str) -> Result<()> {
        match self {
            Self::Cube(_) => {
                let allowed = "`scenes` or another scene model in tiles";
                Err(Error::Option { name: "model", value: name.into(), allowed })
            }
            Self::Scene { .. } => Ok(()),
        }
    }

    /// The map from the cloud to the network's frame, and the rotation of the volume in that frame.
    pub(crate) fn place(
        &self,
        cloud: &UsedCloud,
        options: &EncodeOptions,
        control: &Control,
    ) -> Result<(Normalization, Rotation)> {
        match self {
            Self::Cube(_) => {
                let normalization = Normalization::from_finite(cloud.points(), options.normalization)?;
                let orientation = match options.normalization {
                    NormalizationMethod::PrincipalAxes => {
                        rotations::principal_axes(cloud.points(), normalization.center)
                    }
                    _ => rotations::IDENTITY,
                };
                Ok((normalization, orientation))
            }
            Self::Scene { .. } => {
                let scale = voxel_size(options.voxel_size, cloud, control)?;
                Ok((from_corner(lowest_corner(cloud.points()), scale), rotations::IDENTITY))
            }
        }
    }

    /// The step of a cloud's coordinates, if it is coarser than the voxels would be without it.
    pub(crate) fn coarse_step(&self, cloud: &UsedCloud, options: &EncodeOptions) -> Option<CoordinateStep> {
        match self {
            Self::Cube(frame) => {
                let scale = Normalization::from_finite(cloud.points(), options.normalization).ok()?.scale;
                cloud.coordinate_step().filter(|step| step.length > f64::from(frame.voxel_size(scale)))
            }
            Self::Scene { .. } => coarse_step(options.voxel_size, cloud),
        }
    }
}

/// Such as `32 x 32 x 32 voxels`.
impl fmt::Display for VolumeShape {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Self::Cube(VolumeFrame { resolution: [x, y, z], .. }) => write!(f, "{x} x {y} x {z} voxels"),
            Self::Scene { .. } => f.write_str("voxels where the points reach (a scene model)"),
        }
    }
}

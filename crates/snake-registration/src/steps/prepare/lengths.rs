//! The lengths of a registration: those that are given, and those that follow from the clouds.

use std::borrow::Cow;

use crate::cloud::normals::check_radius;
use crate::cloud::{lower_median, upper_median};
use crate::options::RegisterOptions;
use crate::steps::prepare::voxel_size as default_voxel_size;
use snake_core::Result;
use snake_geometry::{Length, Neighbors, Point, in_parallel, resolution};

/// Voxels are enlarged for clouds whose neighbouring voxels are farther apart than this many voxel
/// sizes. Half and twice change no outcome; it saves time for a sparse cloud beside a dense one.
const MAX_SPACING: f64 = 6.0;
/// Radius of the neighbourhood of a normal, unless it is given. Unit: spacings of the voxels. Half
/// and twice lose a synthetic pair.
const NORMAL_SPACINGS: f64 = 2.0;
/// Radius of the neighbourhood of FPFH, unless it is given. Unit: spacings of the voxels. Half and
/// twice lose a synthetic pair.
const FEATURE_SPACINGS: f64 = 5.0;
/// Inlier distance, unless it is given. Unit: spacings of the voxels. Half and twice lose a synthetic pair.
const INLIER_SPACINGS: f64 = 1.5;

/// The lengths with which clouds are prepared, in cloud units. Clouds that are registered with each other share them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lengths {
    /// Side of the voxels.
    pub voxel_size: f64,
    /// Radius of the neighbourhood of a normal.
    pub normal_radius: f64,
    /// Radius of the neighbourhood of FPFH.
    pub feature_radius: f64,
    /// Distance within which a match agrees with a transform, and voxels overlap.
    pub inlier_distance: f64,
}

impl Lengths {
    /// The default lengths of clouds whose neighbouring voxels are about `spacing` apart.
    pub fn from_spacing(voxel_size: f64, spacing: f64) -> Self {
        Self {
            voxel_size,
            normal_radius: NORMAL_SPACINGS * spacing,
            feature_radius: FEATURE_SPACINGS * spacing,
            inlier_distance: INLIER_SPACINGS * spacing,
        }
    }

    /// Refuses lengths that are not positive.
    pub(super) fn check(&self) -> Result<()> {
        check_radius("voxel_size", self.voxel_size)?;
        check_radius("normal_radius", self.normal_radius)?;
        check_radius("feature_radius", self.feature_radius)?;
        check_radius("inlier_distance", self.inlier_distance)
    }
}

/// The lengths that options set, in cloud units.
pub(super) struct GivenLengths {
    voxel_size: Option<f64>,
    normal_radius: Option<f64>,
    feature_radius: Option<f64>,
    inlier_distance: Option<f64>,
}

impl GivenLengths {
    /// Resolves the lengths of the options. Multiples of a resolution refer to the coarser of two clouds.
    pub(super) fn new(options: &RegisterOptions, clouds: &[Cow<[Point]>]) -> Result<Self> {
        let given = [options.voxel_size, options.normal_radius, options.feature_radius, options.inlier_distance];
        let is_multiple = |length: &Option<Length>| matches!(length, Some(Length::Resolutions(_)));
        let coarser = if given.iter().any(is_multiple) {
            let resolutions = clouds.iter().map(|points| resolution("points", points));
            upper_median(&resolutions.collect::<std::result::Result<Vec<f64>, _>>()?)
        } else {
            0.0
        };
        let resolve = |name, length: Option<Length>| -> Result<Option<f64>> {
            length.map(|length| length.resolve(name, || coarser)).transpose()
        };
        Ok(Self {
            voxel_size: resolve("voxel_size", options.voxel_size)?,
            normal_radius: resolve("normal_radius", options.normal_radius)?,
            feature_radius: resolve("feature_radius", options.feature_radius)?,
            inlier_distance: resolve("inlier_distance", options.inlier_distance)?,
        })
    }

    /// Downsamples clouds with the given voxel size, or with one that suits the smaller cloud. The spacing of the
    /// voxels then gives the lengths that the options do not set. `downsample` makes the voxels of all clouds.
    pub(super) fn downsample(
        &self,
        diameters: &[f64],
        downsample: impl Fn(f64) -> Result<Vec<Neighbors>>,
    ) -> Result<(Vec<Neighbors>, Lengths)> {
        let mut voxel_size = self.voxel_size.unwrap_or(default_voxel_size(lower_median(diameters)));
        let mut voxels = downsample(voxel_size)?;
        let mut spacing = spacing(&voxels, voxel_size);
        // The radii are multiples of the spacing: in a much denser cloud they would hold thousands of voxels.
        if spacing > MAX_SPACING * voxel_size {
            voxel_size = spacing / 2.0;
            voxels = downsample(voxel_size)?;
            spacing = self::spacing(&voxels, voxel_size);
        }
        let default = Lengths::from_spacing(voxel_size, spacing);
        let lengths = Lengths {
            voxel_size,
            normal_radius: self.normal_radius.unwrap_or(default.normal_radius),
            feature_radius: self.feature_radius.unwrap_or(default.feature_radius),
            inlier_distance: self.inlier_distance.unwrap_or(default.inlier_distance),
        };
        Ok((voxels, lengths))
    }
}

/// The distance between neighbouring voxels. In a sparse cloud most voxels hold one point, and the
/// distance exceeds the voxel size.
fn spacing(voxels: &[Neighbors], voxel_size: f64) -> f64 {
    let resolutions = in_parallel(voxels.iter(), Neighbors::resolution);
    voxel_size.max(upper_median(&resolutions))
}

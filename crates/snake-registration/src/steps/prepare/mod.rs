//! Step 1: each cloud is downsampled and measured once, for all its pairs.

mod cloud;
mod keypoints;
mod lengths;
mod pyramid;
mod viewpoint;
mod voxel_cloud;

use std::borrow::Cow;

use rayon::prelude::*;

pub use cloud::PreparedCloud;
pub(crate) use cloud::SelfMotion;
pub(crate) use cloud::diameter;
pub use lengths::Lengths;
pub(crate) use pyramid::{Given, Level, Pyramid};
pub(crate) use viewpoint::Viewpoint;
pub use voxel_cloud::VoxelCloud;

use crate::cloud::voxels::downsample;
use crate::options::RegisterOptions;
use cloud::UsedPoints;
use lengths::GivenLengths;
use snake_core::{Control, Error, Model, Result};
use snake_geometry::{Neighbors, Point, try_in_parallel};

/// Number of voxels along the diameter of the smaller cloud, unless the voxel size is given. Half
/// and twice lose a synthetic pair.
const VOXELS_PER_DIAMETER: f64 = 80.0;

/// The default voxel size of a cloud of this diameter.
pub(crate) fn voxel_size(diameter: f64) -> f64 {
    diameter / VOXELS_PER_DIAMETER
}

/// Clouds that are prepared with the same lengths.
pub struct PreparedClouds {
    /// The clouds, in the given order.
    pub clouds: Vec<PreparedCloud>,
    /// The lengths that all of them have.
    pub lengths: Lengths,
}

/// Prepares clouds `(N, 3)` that will be registered with each other: voxels, normals and keypoints,
/// with lengths that follow from the options and all of the clouds. `viewpoints` has the sensor's
/// position in the frame of each cloud, where it is known. [`PreparedCloud::new`] prepares one
/// cloud with the lengths of others, such as a scan that is registered to a map.
///
/// # Errors
/// [`Error::Input`] for a cloud without finite points or without extent, by its index;
/// [`Error::Option`] when a length is not positive or the detector or the descriptor runs a model
/// and there is none; [`Error::Cancelled`] and [`Error::DeadlineExceeded`].
pub fn prepare(
    clouds: &[&[Point]],
    viewpoints: &[Option<[f64; 3]>],
    model: Option<&Model>,
    options: &RegisterOptions,
    control: &Control,
) -> Result<PreparedClouds> {
    prepare_given(
        &Given { points: clouds.to_vec(), names: &[], viewpoints: viewpoints.to_vec(), model, options },
        control,
    )
}

/// [`prepare`] for clouds and options in one struct.
fn prepare_given(given: &Given, control: &Control) -> Result<PreparedClouds> {
    let Given { points: clouds, names, options, .. } = given;
    let model = options.model_to_run(given.model)?;
    let named = |index: usize| move |error| name_cloud(error, index, names);
    let used = UsedPoints::new_all(clouds, |index| given.viewpoint(index));
    let used = used.map_err(|(index, error)| named(index)(error))?;
    let points: Vec<Cow<[Point]>> = used.iter().map(|used| Cow::Borrowed(&used.points[..])).collect();
    let lengths = GivenLengths::new(options, &points)?;
    let each = || used.iter().enumerate();
    let diameters = try_in_parallel(each(), |(index, used)| used.diameter().map_err(named(index)))?;
    let (voxels, lengths) = lengths.downsample(&diameters, |voxel_size| {
        try_in_parallel(each(), |(index, used)| downsample(&used.points, voxel_size, control).map_err(named(index)))
    })?;
    let prepare = |(index, (used, voxels)): (usize, (&UsedPoints, Neighbors))| {
        // The clouds get different random keypoints. With one seed, equal clouds would have a
        // partner for every keypoint.
        let options = options.with_seed(options.seed.wrapping_add(index as u64));
        used.prepare(voxels, diameters[index], &lengths, model, &options, control).map_err(named(index))
    };
    let clouds = used.par_iter().zip(voxels).enumerate().map(prepare).collect::<Result<_>>()?;
    Ok(PreparedClouds { clouds, lengths })
}

/// Adds the name or the index of the cloud to an error.
fn name_cloud(error: Error, index: usize, names: &[&'static str]) -> Error {
    match (error, names.get(index)) {
        (Error::Input { reason, .. }, Some(name)) => Error::Input { what: name, reason },
        (Error::Input { reason, .. }, None) => {
            Error::Input { what: "clouds", reason: format!("cloud {index} (from 0): {reason}") }
        }
        (other, _) => other,
    }
}

//! A prepared cloud with everything that its pairs need.

use std::borrow::Cow;
use std::sync::OnceLock;

use nalgebra::IsometryMatrix3;

use super::lengths::Lengths;
use super::viewpoint::Viewpoint;
use super::voxel_cloud::VoxelCloud;
use super::{name_cloud, voxel_size};
use crate::cloud::normals::Orientation;
use crate::cloud::patches::FineCloud;
use crate::cloud::surface::Surface;
use crate::cloud::voxels::downsample;
use crate::options::{Descriptor, RegisterOptions};
use snake_core::{Control, Model, Result};
use snake_geometry::{
    FinitePoints, Neighbors, Normalization, NormalizationMethod, Outliers, Point, check_points, try_in_parallel,
};

/// A motion that maps a cloud onto itself, and the share of the cloud's self-matches that agree with it.
pub(crate) type SelfMotion = (IsometryMatrix3<f64>, f64);

/// A cloud with its voxels, normals, sensor and keypoints. Descriptors and planar patches are
/// computed when they are first needed, and kept.
pub struct PreparedCloud {
    pub(crate) voxels: VoxelCloud,
    pub(crate) lengths: Lengths,
    pub(crate) diameter: f64,
    /// Number of points that are not finite or stand for missing returns.
    pub(crate) num_skipped: usize,
    pub(crate) outliers: Option<Outliers>,
    /// The missing returns that were left out, in words.
    pub(crate) missing: Vec<String>,
    /// The sensor's position, if it is known.
    pub(crate) viewpoint: Option<Viewpoint>,
    /// Keypoints, each with the index of the nearest voxel.
    pub(crate) keypoints: Vec<(Point, usize)>,
    pub(crate) descriptor: Descriptor,
    /// Descriptors of the keypoints: from unsigned normals, and from signed ones.
    pub(crate) rows: [OnceLock<Vec<f32>>; 2],
    fine: OnceLock<FineCloud>,
    /// The motions under which the cloud is self-similar: from unsigned normals, and from signed ones.
    pub(crate) self_motions: [OnceLock<Vec<SelfMotion>>; 2],
}

impl PreparedCloud {
    /// Prepares one cloud `(N, 3)` with the lengths of others, such as those of a map that is kept. `viewpoint` is
    /// the sensor's position in the cloud's frame, if it is known. Clouds that are registered with each other need
    /// different seeds in their options if their keypoints are random.
    ///
    /// # Errors
    /// The errors of [`prepare`](crate::steps::prepare()).
    pub fn new(
        points: &[Point],
        viewpoint: Option<[f64; 3]>,
        lengths: &Lengths,
        model: Option<&Model>,
        options: &RegisterOptions,
        control: &Control,
    ) -> Result<Self> {
        let model = options.model_to_run(model)?;
        lengths.check()?;
        let prepare = || {
            let mut used = UsedPoints::new_all(&[points], |_| viewpoint).map_err(|(_, error)| error)?;
            let used = used.remove(0);
            let voxels = downsample(&used.points, lengths.voxel_size, control)?;
            used.prepare(voxels, used.diameter()?, lengths, model, options, control)
        };
        prepare().map_err(|error| name_cloud(error, 0, &["points"]))
    }

    /// The same cloud with other keypoints `(K, 3)` in its frame. A match takes the normal of the
    /// voxel nearest to a keypoint.
    ///
    /// # Errors
    /// [`Error::Input`](snake_core::Error::Input) when there are no keypoints or one is not finite.
    pub fn with_keypoints(mut self, keypoints: &[Point]) -> Result<Self> {
        check_points("keypoints", keypoints)?;
        self.keypoints = keypoints.iter().map(|&point| (point, self.voxels.nearest_voxel(point))).collect();
        self.rows = Default::default();
        self.self_motions = Default::default();
        Ok(self)
    }

    /// The keypoints `(K, 3)` in the cloud's frame. Row i of the descriptors is that of keypoint i.
    pub fn keypoints(&self) -> Vec<Point> {
        self.keypoints.iter().map(|(point, _)| *point).collect()
    }

    /// The lengths with which the cloud was prepared.
    pub fn lengths(&self) -> &Lengths {
        &self.lengths
    }

    /// The downsampled cloud.
    pub fn voxels(&self) -> &VoxelCloud {
        &self.voxels
    }

    /// The voxel size for a pair of clouds of this size.
    pub(crate) fn default_voxel_size(&self) -> f64 {
        voxel_size(self.diameter)
    }

    /// Whether most of the cloud's voxels are visible from its sensor; false if the sensor is not known.
    pub(crate) fn is_visible(&self) -> bool {
        let (voxels, distance) = (&self.voxels.voxels.points, self.lengths.inlier_distance);
        self.viewpoint.is_some_and(|viewpoint| viewpoint.sees_most_of(voxels, distance))
    }

    /// The voxels as a surface for pairs closer than `distance`; `signed` normals point to the sensor.
    pub(crate) fn surface(&self, signed: bool, distance: f64) -> Surface<'_> {
        let viewpoint = self.viewpoint.filter(|_| signed).map(|viewpoint| viewpoint.place());
        Surface::new(&self.voxels.voxels.points, &self.voxels.normals, viewpoint, distance)
    }

    /// The points in fine voxels.
    pub(crate) fn fine(&self) -> Result<&FineCloud> {
        if let Some(fine) = self.fine.get() {
            return Ok(fine);
        }
        let VoxelCloud { points, voxel_size, voxels, .. } = &self.voxels;
        let fine = FineCloud::new(points, *voxel_size, voxels.points.len())?;
        Ok(self.fine.get_or_init(|| fine))
    }
}

/// The points of a cloud that are used: finite ones, without missing returns and outliers.
pub(super) struct UsedPoints<'a> {
    pub(super) points: Cow<'a, [Point]>,
    num_skipped: usize,
    outliers: Option<Outliers>,
    missing: Vec<String>,
    viewpoint: Option<Viewpoint>,
}

impl<'a> UsedPoints<'a> {
    /// The points of all clouds; an error comes with the index of its cloud.
    pub(super) fn new_all(
        clouds: &[&'a [Point]],
        viewpoint: impl Fn(usize) -> Option<[f64; 3]> + Sync,
    ) -> std::result::Result<Vec<Self>, (usize, snake_core::Error)> {
        let clean = |(index, points): (usize, &&'a [Point])| {
            let used = FinitePoints::clean("points", points, viewpoint(index)).map_err(|error| (index, error))?;
            let (outliers, missing) = (used.outliers(), used.missing().to_vec());
            let viewpoint = Viewpoint::new(&used.points, viewpoint(index));
            Ok(Self {
                num_skipped: points.len() - used.points.len(),
                points: used.points,
                outliers,
                missing,
                viewpoint,
            })
        };
        try_in_parallel(clouds.iter().enumerate(), clean)
    }

    /// Twice the largest distance from the mean.
    pub(super) fn diameter(&self) -> Result<f64> {
        diameter(&self.points)
    }

    /// The prepared cloud of these points and their voxels.
    pub(super) fn prepare(
        &self,
        voxels: Neighbors,
        diameter: f64,
        lengths: &Lengths,
        model: Option<&Model>,
        options: &RegisterOptions,
        control: &Control,
    ) -> Result<PreparedCloud> {
        let viewpoint = self.viewpoint.filter(|_| options.use_viewpoints);
        let orientation =
            viewpoint.map_or(Orientation::Unsigned, |viewpoint| Orientation::Viewpoint(viewpoint.place()));
        let mut voxels = VoxelCloud::from_voxels(&self.points, voxels, lengths, orientation, control)?;
        if let Some(model) = model {
            voxels = voxels.with_model(model, VoxelCloud::default_options(model, lengths.voxel_size));
        }
        Ok(PreparedCloud {
            keypoints: voxels.anchored_keypoints(options, control)?,
            voxels,
            lengths: *lengths,
            diameter,
            num_skipped: self.num_skipped,
            outliers: self.outliers,
            missing: self.missing.clone(),
            viewpoint,
            descriptor: options.descriptor,
            rows: Default::default(),
            fine: OnceLock::new(),
            self_motions: Default::default(),
        })
    }
}

/// Twice the largest distance from the mean.
pub(crate) fn diameter(points: &[Point]) -> Result<f64> {
    Ok(Normalization::of(points, NormalizationMethod::UnitSphere)?.scale.into())
}

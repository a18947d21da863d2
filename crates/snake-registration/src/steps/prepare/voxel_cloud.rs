//! A downsampled cloud with normals, and the field and FPFH that are computed when they are first needed.

use std::num::NonZeroUsize;
use std::sync::OnceLock;

use super::lengths::Lengths;
use crate::cloud::normals::{Orientation, normals};
use crate::cloud::voxels::downsample;
use crate::options::no_model;
use snake_core::{Control, Field, Model, Options, Result};
use snake_geometry::{FinitePoints, Length, Neighbors, Normalization, NormalizationMethod, Point, Vector, vector};

/// Clouds are normalised to the cube, which scenes fill better than the sphere that suits objects.
/// A cube cannot be rotated within itself, so there are no rotated copies.
const NORMALIZATION: NormalizationMethod = NormalizationMethod::UnitCube;

/// A cloud downsampled to voxels, with normals. It finds keypoints by every [`Detector`](crate::Detector) and
/// describes points by every [`Descriptor`](crate::Descriptor). Intermediate results are computed once and kept. Only
/// [`Detector::Snake`](crate::Detector::Snake) and [`Descriptor::Field`](crate::Descriptor::Field) need a model,
/// which [`VoxelCloud::with_model`] adds.
pub struct VoxelCloud {
    pub(crate) voxels: Neighbors,
    pub(crate) normals: Vec<Vector>,
    pub(crate) voxel_size: f64,
    pub(crate) feature_radius: f64,
    pub(crate) orientation: Orientation,
    /// The finite points.
    pub(crate) points: Vec<Point>,
    /// The model of the field, and the options of its keypoints and field.
    model: Option<(Model, Options)>,
    field: OnceLock<Field>,
    /// FPFH of all voxels: from unsigned normals, and from signed ones.
    pub(crate) fpfh: [OnceLock<Vec<f32>>; 2],
}

impl VoxelCloud {
    /// Downsamples a cloud `(N, 3)`. Its normals point to the side of its mean.
    ///
    /// # Errors
    /// [`Error::Input`](snake_core::Error::Input) for a cloud without finite points or without
    /// extent; [`Error::Option`](snake_core::Error::Option) when a length is not positive;
    /// [`Error::Cancelled`](snake_core::Error::Cancelled) and
    /// [`Error::DeadlineExceeded`](snake_core::Error::DeadlineExceeded).
    pub fn new(points: &[Point], lengths: &Lengths, control: &Control) -> Result<Self> {
        lengths.check()?;
        let points = FinitePoints::clean("points", points, None)?.points;
        let voxels = downsample(&points, lengths.voxel_size, control)?;
        Self::from_voxels(&points, voxels, lengths, Orientation::Mean, control)
    }

    /// [`VoxelCloud::new`] of finite points and their voxels.
    pub(crate) fn from_voxels(
        points: &[Point],
        voxels: Neighbors,
        lengths: &Lengths,
        orientation: Orientation,
        control: &Control,
    ) -> Result<Self> {
        // This refuses extents that no model accepts, even where no model runs.
        Normalization::of(points, NORMALIZATION)?;
        voxels.check_density("normal_radius", lengths.normal_radius)?;
        voxels.check_density("feature_radius", lengths.feature_radius)?;
        let normals = normals(&voxels, lengths.normal_radius, orientation, control)?;
        Ok(Self {
            voxels,
            normals,
            voxel_size: lengths.voxel_size,
            feature_radius: lengths.feature_radius,
            orientation,
            points: points.to_vec(),
            model: None,
            field: OnceLock::new(),
            fpfh: Default::default(),
        })
    }

    /// The options of the model's keypoints and field. They are the recommended ones, but in the
    /// unit cube and without rotated copies. Every salient point is a keypoint: it moves onto the
    /// surface and is at least `voxel_size` from the others.
    pub fn default_options(model: &Model, voxel_size: f64) -> Options {
        let recommended = *model.recommended();
        let encode = recommended.encode.with_normalization(NORMALIZATION).with_rotations(1);
        // FPFH describes the surface, so keypoints are moved onto it.
        let detect = recommended.detect.with_saliency_threshold(0.0).with_mode_radius(None).with_min_confidence(None);
        let detect = detect.with_snap(true);
        recommended.with_encode(encode).with_detect(detect.with_nms_radius(Some(Length::Units(voxel_size))))
    }

    /// Adds a model with the options of its keypoints and field (see
    /// [`VoxelCloud::default_options`]). Their `max_keypoints` is not used.
    #[must_use]
    pub fn with_model(self, model: &Model, options: Options) -> Self {
        Self { model: Some((model.clone(), options)), field: OnceLock::new(), ..self }
    }

    /// The means of the voxels `(V, 3)`.
    pub fn points(&self) -> Vec<Point> {
        (0..self.voxels.points.len()).map(|index| self.voxel_mean(index)).collect()
    }

    /// The normals of the voxels `(V, 3)`; zero where a voxel has too few neighbours.
    pub fn normals(&self) -> Vec<Point> {
        self.normals.iter().map(|normal| normal.map(|v| v as f32).into()).collect()
    }

    pub(crate) fn model(&self) -> Result<&(Model, Options)> {
        self.model.as_ref().ok_or_else(no_model)
    }

    /// The field of the whole cloud, encoded at the first call.
    pub(crate) fn field(&self, control: &Control) -> Result<&Field> {
        if let Some(field) = self.field.get() {
            return Ok(field);
        }
        let (model, options) = self.model()?;
        let field = model.encode_with(&self.points, &options.encode, control)?;
        Ok(self.field.get_or_init(|| field))
    }

    pub(super) fn voxel_mean(&self, index: usize) -> Point {
        self.voxels.points[index].map(|v| v as f32).into()
    }

    /// The index of the voxel nearest to a point.
    pub(crate) fn nearest_voxel(&self, point: Point) -> usize {
        self.voxels.nearest(&vector(point), NonZeroUsize::MIN)[0].0
    }

    #[cfg(test)]
    pub(crate) fn encoded_field(&self) -> Option<&Field> {
        self.field.get()
    }
}

//! A cloud made ready to be matched: reduced, encoded, with keypoints of any detector and descriptors of any kind.

use std::num::NonZeroUsize;
use std::sync::OnceLock;

use serde::{Deserialize, Serialize};

use super::cloud::{check_radius, normals, voxel_means};
use super::fpfh::{self, FPFH_DIMENSION};
use crate::Result;
use crate::baselines::{Detector, Harris3dOptions, IssOptions, Protocol, Sift3dOptions};
use crate::detect::{DetectOptions, Preset, detect};
use crate::field::{EncodeOptions, Field};
use crate::length::Length;
use crate::model::Model;
use crate::neighbors::{Neighbors, Vector, vector};
use crate::points::{FinitePoints, NormalizationMethod, Point, check_points};
use crate::progress::{Counter, Progress};

/// What keypoints are found by: the model, or a classical detector of [`baselines`](crate::baselines) with its default
/// options, which picks among the points of the reduced cloud.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum KeypointDetector {
    /// The most salient points of the field, farther apart than the voxels.
    #[default]
    Snake,
    /// Intrinsic shape signatures.
    Iss,
    /// Harris' corners of the normals.
    Harris3d,
    /// Extrema of differences of Gaussians of the curvature.
    Sift3d,
    /// Farthest-point sampling.
    Fps,
    /// Random points.
    Random,
}

/// What keypoints are matched by.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Descriptor {
    /// FPFH of the down-sampled cloud at the point nearest to the keypoint: turns with the cloud.
    #[default]
    Fpfh,
    /// The field's own features. Nothing makes them independent of the cloud's rotation, and the built-in model has
    /// learnt that only in part.
    Field,
}

/// A cloud made ready to be matched. What takes long is done once for all detectors and descriptors.
pub struct Scan {
    pub(super) voxels: Neighbors,
    pub(super) normals: Vec<Vector>,
    voxel_size: f64,
    feature_radius: f64,
    field: Field,
    fpfh: OnceLock<Vec<f32>>,
}

impl Scan {
    /// Reduces a cloud to voxels of side `voxel_size` (cloud units), with normals of radius 2 and FPFH of radius 7 of
    /// these, and encodes it.
    ///
    /// # Errors
    /// [`Error::Input`](crate::Error::Input) for a cloud without finite points or without extent; [`Error::Option`](crate::Error::Option) when the voxel size is not positive.
    pub fn new(points: &[Point], model: &Model, voxel_size: f64) -> Result<Self> {
        check_radius("voxel_size", voxel_size)?;
        let voxels = reduce("points", points, voxel_size, model.progress())?;
        Self::of(points, voxels, model, [voxel_size, 2.0 * voxel_size, 7.0 * voxel_size])
    }

    /// [`Scan::new`] of a reduced cloud; the lengths are voxel size, radius of normals and radius of FPFH.
    pub(super) fn of(points: &[Point], voxels: Neighbors, model: &Model, lengths: [f64; 3]) -> Result<Self> {
        let [voxel_size, normal_radius, feature_radius] = lengths;
        // Scenes fill the volume better by the cube than by the sphere that suits objects; a cube cannot be turned in it.
        let normalization = NormalizationMethod::UnitCube;
        let field =
            model.encode(points, &EncodeOptions { normalization, rotations: 1, ..model.recommended().encode })?;
        voxels.check_crowding("normal_radius", normal_radius)?;
        voxels.check_crowding("feature_radius", feature_radius)?;
        let normals = normals(&voxels, normal_radius, model.progress());
        Ok(Self { voxels, normals, voxel_size, feature_radius, field, fpfh: OnceLock::new() })
    }

    /// At most `count` keypoints, and no more than the cloud has points, the best first. Only random points depend on the seed.
    ///
    /// # Errors
    /// [`Error::Input`](crate::Error::Input) when a classical detector finds a single voxel;
    /// [`Error::Option`](crate::Error::Option) when it is asked for none.
    pub fn keypoints(&self, detector: KeypointDetector, count: usize, seed: u64) -> Result<Vec<Point>> {
        // More than the points say nothing new, and matching takes time by the square of their number.
        let count = count.min(self.field.points().len());
        let classical = match detector {
            KeypointDetector::Snake => return self.salient_points(count),
            KeypointDetector::Iss => Detector::Iss(IssOptions::default()),
            KeypointDetector::Harris3d => Detector::Harris3d(Harris3dOptions::default()),
            KeypointDetector::Sift3d => Detector::Sift3d(Sift3dOptions::default()),
            KeypointDetector::Fps => Detector::FarthestPoint,
            KeypointDetector::Random => Detector::Random,
        };
        let voxels = self.voxel_means();
        Counter::begin(self.field.model().progress(), "keypoints", 0);
        let found = classical.keypoints(&voxels, count, Protocol::Ranked, seed)?;
        Ok(found.into_iter().map(|response| voxels[response.index]).collect())
    }

    fn voxel_means(&self) -> Vec<Point> {
        self.voxels.points.iter().map(|point| point.map(|v| v as f32).into()).collect()
    }

    fn salient_points(&self, most: usize) -> Result<Vec<Point>> {
        let model = self.field.model();
        let recommended = *model.recommended();
        let options = DetectOptions { saliency_threshold: 0.0, max_keypoints: most, ..recommended.detect };
        let uses_windows = match recommended.windows.window_radius {
            // Windows of hardly more than a voxel show nothing.
            Some(Length::Units(radius)) => radius >= 2.0 * self.voxel_size,
            radius => radius.is_some(),
        };
        let found = if uses_windows {
            model.detect(&self.voxel_means(), &Preset { detect: options, ..recommended })?
        } else {
            // The suppression radius that suits objects of any size is not one of this cloud's units; that of windows is.
            detect(&self.field, &DetectOptions { nms_radius: Length::Units(self.voxel_size), ..options })?
        };
        Ok(found.keypoints.into_iter().map(|keypoint| keypoint.position).collect())
    }

    /// Descriptors `(N, dimension)` of points `(N, 3)` in the cloud's frame, flat; see [`Scan::dimension`].
    ///
    /// # Errors
    /// [`Error::Input`](crate::Error::Input) for coordinates that are not finite.
    pub fn descriptors(&self, points: &[Point], descriptor: Descriptor) -> Result<Vec<f32>> {
        match descriptor {
            Descriptor::Fpfh => self.fpfh_at(points),
            Descriptor::Field => self.field.descriptors(points),
        }
    }

    /// Numbers per descriptor.
    pub fn dimension(&self, descriptor: Descriptor) -> usize {
        match descriptor {
            Descriptor::Fpfh => FPFH_DIMENSION,
            Descriptor::Field => self.field.model().config().c_dim,
        }
    }

    /// FPFH of the voxels nearest to the points.
    fn fpfh_at(&self, points: &[Point]) -> Result<Vec<f32>> {
        if !points.is_empty() {
            check_points("points", points)?;
        }
        let progress = self.field.model().progress();
        let describe = || fpfh::descriptors(&self.voxels, &self.normals, self.feature_radius, progress);
        let of_voxels = self.fpfh.get_or_init(describe);
        let nearest = |&point: &Point| self.voxels.nearest(&vector(point), NonZeroUsize::MIN)[0].0;
        let rows = points.iter().map(|point| &of_voxels[nearest(point) * FPFH_DIMENSION..][..FPFH_DIMENSION]);
        Ok(rows.flatten().copied().collect())
    }
}

/// The cloud's points by voxels.
pub(super) fn reduce(
    what: &'static str,
    points: &[Point],
    voxel_size: f64,
    progress: Option<&Progress>,
) -> Result<Neighbors> {
    let points = &FinitePoints::of(what, points)?.points;
    let counter = Counter::begin(progress, "voxels", points.len());
    Neighbors::new(voxel_means(points, voxel_size, &counter))
}

#[cfg(test)]
mod tests {
    use super::*;
    use KeypointDetector::{Fps, Harris3d, Iss, Random, Sift3d, Snake};

    fn sample() -> Vec<Point> {
        crate::io::read_points(concat!(env!("CARGO_MANIFEST_DIR"), "/../../samples/plane.ply").as_ref()).unwrap()
    }

    #[test]
    fn every_detector_has_keypoints_of_its_own_on_the_cloud_best_first() {
        let scan = Scan::new(&sample(), &Model::builtin().unwrap(), 0.02).unwrap();
        let mut earlier: Vec<Vec<Point>> = Vec::new();
        for detector in [Snake, Iss, Harris3d, Sift3d, Fps, Random] {
            let keypoints = |count, seed| scan.keypoints(detector, count, seed).unwrap();
            let found = keypoints(100, 0);
            assert!((5..=100).contains(&found.len()), "{detector:?}: {}", found.len());
            assert_eq!(keypoints(5, 0), found[..5], "{detector:?}");
            assert_eq!(keypoints(100, 1) == found, detector != Random, "{detector:?}");
            assert!(found.iter().all(|&point| scan.voxels.distance(&vector(point)) < 0.1), "{detector:?}");
            assert!(!earlier.contains(&found), "{detector:?}");
            earlier.push(found);
        }
        let sparse: Vec<Point> = sample().into_iter().step_by(20).collect();
        let scan_of_sparse = Scan::new(&sparse, &Model::builtin().unwrap(), 1e-3).unwrap();
        assert_eq!(scan_of_sparse.keypoints(Snake, 100_000, 0).unwrap().len(), sparse.len());
        let error = scan.keypoints(Iss, 0, 0).unwrap_err().to_string();
        assert!(error.contains("count"), "{error}");
    }

    #[test]
    fn a_model_that_sees_through_windows_does_so_with_its_own_suppression_radius() {
        let room: Vec<Point> = sample().iter().map(|point| point.map(|v| 3.0 * v)).collect();
        let model = Model::named("rooms").unwrap();
        let scan = Scan::new(&room, &model, 0.03).unwrap();
        let found = scan.keypoints(Snake, 50, 0).unwrap();
        let Length::Units(radius) = model.recommended().detect.nms_radius else { panic!("a length in metres") };
        let apart = |a: &Point, b: &Point| (vector(*a) - vector(*b)).norm() >= radius;
        assert!(found.len() > 10 && (1..found.len()).all(|i| found[..i].iter().all(|other| apart(other, &found[i]))));
        assert!(radius > 0.03 && model.recommended().windows.window_radius.is_some());
    }

    #[test]
    fn a_model_that_recommends_several_copies_encodes_one() {
        let model = Model::named("standard").unwrap();
        assert!(model.recommended().encode.rotations > 1);
        let scan = Scan::new(&sample(), &model, 0.05).unwrap();
        assert_eq!(scan.keypoints(Snake, 10, 0).unwrap().len(), 10);
    }

    #[test]
    fn descriptors_are_rows_of_the_voxel_nearest_to_each_point() {
        let scan = Scan::new(&sample(), &Model::builtin().unwrap(), 0.05).unwrap();
        let voxels: Vec<Point> = scan.voxels.points.iter().map(|point| point.map(|v| v as f32).into()).collect();
        for descriptor in [Descriptor::Fpfh, Descriptor::Field] {
            let all = scan.descriptors(&voxels, descriptor).unwrap();
            let dimension = scan.dimension(descriptor);
            assert_eq!(all.len(), voxels.len() * dimension);
            assert_eq!(scan.descriptors(&voxels[7..9], descriptor).unwrap(), all[7 * dimension..9 * dimension]);
            assert!(scan.descriptors(&[[f32::NAN; 3]], descriptor).is_err());
            assert!(scan.descriptors(&[], descriptor).unwrap().is_empty());
        }
        let beside = voxels[3].map(|v| v + 1e-4);
        let fpfh = |points: &[Point]| scan.descriptors(points, Descriptor::Fpfh).unwrap();
        assert_eq!(fpfh(&[beside]), fpfh(&voxels[3..4]));
    }

    #[test]
    fn clouds_and_sizes_that_cannot_be_used_are_refused() {
        let model = Model::builtin().unwrap();
        let scan = |points: &[Point], size| Scan::new(points, &model, size).err().unwrap().to_string();
        assert!(scan(&[], 0.1).contains("no points"));
        assert!(scan(&[[f32::NAN; 3]; 2], 0.1).contains("finite"));
        assert!(scan(&[[1.0; 3]; 4], 0.1).contains("two different"));
        assert!(scan(&sample(), 0.0).contains("voxel_size"));
    }
}

//! A cloud with the data for matching: voxels, field, keypoints and descriptors.

use std::num::NonZeroUsize;
use std::sync::OnceLock;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::detectors::{Detector, Harris3dOptions, IssOptions, Protocol, Sift3dOptions};
use crate::options::{Descriptor, KeypointDetector, RegisterOptions};
use crate::pair::model::no_model;
use crate::parts::cloud::{Orientation, check_radius, normals, voxel_means};
use crate::parts::fast_fpfh;
use crate::parts::fpfh::FPFH_DIMENSION;
use snake_core::Control;
use snake_core::Field;
use snake_core::Model;
use snake_core::Options;
use snake_core::Result;
use snake_geometry::{
    FinitePoints, Length, Neighbors, Normalization, NormalizationMethod, Point, Vector, check_points,
    suppress_to_count, vector,
};

/// A cloud with the data for matching. Each part is computed when it is first needed and then kept for all detectors
/// and descriptors. Only [`KeypointDetector::Snake`] and [`Descriptor::Field`] need a model, which [`Scan::with_model`] brings.
pub struct Scan {
    pub(crate) voxels: Neighbors,
    pub(crate) normals: Vec<Vector>,
    pub(crate) voxel_size: f64,
    feature_radius: f64,
    orientation: Orientation,
    /// The finite points.
    pub(crate) points: Vec<Point>,
    /// The model of the field, and the options of its keypoints and field.
    model: Option<(Model, Options)>,
    field: OnceLock<Field>,
    /// FPFH of all voxels: of normals without a sign, and with one.
    fpfh: [OnceLock<Vec<f32>>; 2],
}

impl Scan {
    /// Reduces a cloud `(N, 3)` to voxels of side `voxel_size` (cloud units). The radius of normals is 2 voxels and the
    /// radius of FPFH 7 voxels.
    ///
    /// # Errors
    /// [`Error::Input`](snake_core::Error::Input) for a cloud without finite points or without extent;
    /// [`Error::Option`](snake_core::Error::Option) when the voxel size is not positive.
    pub fn new(points: &[Point], voxel_size: f64) -> Result<Self> {
        Self::new_with(points, voxel_size, &Control::default())
    }

    /// [`Scan::new`] with progress and cancellation.
    ///
    /// # Errors
    /// The errors of [`Scan::new`]; [`Error::Cancelled`](snake_core::Error::Cancelled) and
    /// [`Error::DeadlineExceeded`](snake_core::Error::DeadlineExceeded).
    pub fn new_with(points: &[Point], voxel_size: f64, control: &Control) -> Result<Self> {
        check_radius("voxel_size", voxel_size)?;
        let points = FinitePoints::of("points", points)?.points;
        let voxels = reduce(&points, voxel_size, control)?;
        Self::of(&points, voxels, [voxel_size, 2.0 * voxel_size, 7.0 * voxel_size], Orientation::Mean, control)
    }

    /// [`Scan::new`] of finite points and their voxels; `lengths` are voxel size, radius of normals and radius of FPFH.
    pub(crate) fn of(
        points: &[Point],
        voxels: Neighbors,
        lengths: [f64; 3],
        orientation: Orientation,
        control: &Control,
    ) -> Result<Self> {
        let [voxel_size, normal_radius, feature_radius] = lengths;
        // This refuses extents that no model accepts, even where no model runs.
        Normalization::of(points, NORMALIZATION)?;
        voxels.check_density("normal_radius", normal_radius)?;
        voxels.check_density("feature_radius", feature_radius)?;
        let normals = normals(&voxels, normal_radius, orientation, control)?;
        Ok(Self {
            voxels,
            normals,
            voxel_size,
            feature_radius,
            orientation,
            points: points.to_vec(),
            model: None,
            field: OnceLock::new(),
            fpfh: Default::default(),
        })
    }

    /// The options of the model's keypoints and field: those that it recommends, but in the unit cube, without rotated copies,
    /// and with every salient point, moved onto the surface, that is a voxel from the others.
    pub fn default_options(model: &Model, voxel_size: f64) -> Options {
        let recommended = *model.recommended();
        let encode = recommended.encode.with_normalization(NORMALIZATION).with_rotations(1);
        // FPFH describes the surface, so keypoints are moved onto it.
        let detect = recommended.detect.with_saliency_threshold(0.0).with_mode_radius(None).with_snap(true);
        recommended.with_encode(encode).with_detect(detect.with_nms_radius(Some(Length::Units(voxel_size))))
    }

    /// Adds the model of [`KeypointDetector::Snake`] and [`Descriptor::Field`], with the options of its keypoints and field
    /// (see [`Scan::default_options`]). Their `max_keypoints` is not used.
    #[must_use]
    pub fn with_model(self, model: &Model, options: Options) -> Self {
        Self { model: Some((model.clone(), options)), field: OnceLock::new(), ..self }
    }

    fn model(&self) -> Result<&(Model, Options)> {
        self.model.as_ref().ok_or_else(no_model)
    }

    /// At most `count` keypoints `(K, 3)` in the cloud's frame, best first, and no more than the cloud has points. Only
    /// random points depend on the seed.
    ///
    /// # Errors
    /// [`Error::Input`](snake_core::Error::Input) when a classical detector is used on a single voxel;
    /// [`Error::Option`](snake_core::Error::Option) when `count` is 0 or the scan has no model for its keypoints;
    /// [`Error::Weights`](snake_core::Error::Weights) when the model overflows.
    pub fn keypoints(&self, detector: KeypointDetector, count: usize, seed: u64) -> Result<Vec<Point>> {
        self.keypoints_with(detector, count, seed, &Control::default())
    }

    /// [`Scan::keypoints`] with progress and cancellation; a classical detector is not interrupted.
    ///
    /// # Errors
    /// The errors of [`Scan::keypoints`]; [`Error::Cancelled`](snake_core::Error::Cancelled) and
    /// [`Error::DeadlineExceeded`](snake_core::Error::DeadlineExceeded).
    pub fn keypoints_with(
        &self,
        detector: KeypointDetector,
        count: usize,
        seed: u64,
        control: &Control,
    ) -> Result<Vec<Point>> {
        // More keypoints than points add no information, and matching takes time in the square of their number.
        let count = count.min(self.points.len());
        let classical = match detector {
            KeypointDetector::Voxels => {
                return Ok(self.voxel_sample(count, seed).map(|i| self.voxel_mean(i)).collect());
            }
            KeypointDetector::Snake => return self.salient_points(count, control),
            KeypointDetector::Iss => Detector::Iss(IssOptions::default()),
            KeypointDetector::Harris3d => Detector::Harris3d(Harris3dOptions::default()),
            KeypointDetector::Sift3d => Detector::Sift3d(Sift3dOptions::default()),
            KeypointDetector::Fps => Detector::FarthestPoint,
            KeypointDetector::Random => Detector::Random,
        };
        let voxels = self.voxel_means();
        control.begin("keypoints", 0).check()?;
        let found = classical.keypoints(&voxels, count, Protocol::Ranked, seed)?;
        Ok(found.into_iter().map(|response| voxels[response.index]).collect())
    }

    /// `count` keypoints `(K, 3)` in the cloud's frame, best first, that are spread over the cloud (see
    /// [`suppress_to_count`]); fewer if the detector finds fewer. Voxels have no rank: they are drawn by the seed.
    ///
    /// # Errors
    /// The errors of [`Scan::keypoints_with`].
    pub fn spread_keypoints_with(
        &self,
        detector: KeypointDetector,
        count: usize,
        seed: u64,
        control: &Control,
    ) -> Result<Vec<Point>> {
        let ranked = match detector {
            // These are spread by themselves.
            KeypointDetector::Fps => return self.keypoints_with(detector, count, seed, control),
            KeypointDetector::Voxels => {
                self.keypoints_with(KeypointDetector::Random, self.voxels.points.len(), seed, control)?
            }
            _ => self.keypoints_with(detector, self.voxels.points.len(), seed, control)?,
        };
        let (kept, _) = suppress_to_count(&ranked, count)?;
        Ok(kept.into_iter().map(|index| ranked[index]).collect())
    }

    fn voxel_mean(&self, index: usize) -> Point {
        self.voxels.points[index].map(|v| v as f32).into()
    }

    fn voxel_means(&self) -> Vec<Point> {
        (0..self.voxels.points.len()).map(|index| self.voxel_mean(index)).collect()
    }

    /// Indices of all voxels, or of `count` random ones, ascending.
    fn voxel_sample(&self, count: usize, seed: u64) -> impl Iterator<Item = usize> + use<> {
        let total = self.voxels.points.len();
        let mut sample: Vec<usize> = match count < total {
            true => rand::seq::index::sample(&mut ChaCha8Rng::seed_from_u64(seed), total, count).into_vec(),
            false => (0..total).collect(),
        };
        sample.sort_unstable();
        sample.into_iter()
    }

    /// The keypoints that the options ask for, each with the index of the nearest voxel.
    pub(crate) fn anchored_keypoints(
        &self,
        options: &RegisterOptions,
        seed: u64,
        control: &Control,
    ) -> Result<Vec<(Point, usize)>> {
        let RegisterOptions { detector, max_keypoints, .. } = *options;
        let keypoints = match options.num_keypoints {
            Some(count) => self.spread_keypoints_with(detector, count, seed, control)?,
            None if detector == KeypointDetector::Voxels => {
                let sample = self.voxel_sample(max_keypoints, seed);
                return Ok(sample.map(|index| (self.voxel_mean(index), index)).collect());
            }
            None => self.keypoints_with(detector, max_keypoints, seed, control)?,
        };
        Ok(keypoints.into_iter().map(|point| (point, self.nearest_voxel(point))).collect())
    }

    fn nearest_voxel(&self, point: Point) -> usize {
        self.voxels.nearest(&vector(point), NonZeroUsize::MIN)[0].0
    }

    /// The field of the whole cloud, encoded at the first call.
    fn field(&self, control: &Control) -> Result<&Field> {
        if let Some(field) = self.field.get() {
            return Ok(field);
        }
        let (model, options) = self.model()?;
        let field = model.encode_with(&self.points, &options.encode, control)?;
        Ok(self.field.get_or_init(|| field))
    }

    fn salient_points(&self, most: usize, control: &Control) -> Result<Vec<Point>> {
        let options = self.model()?.1.detect.with_max_keypoints(most);
        let found = self.field(control)?.detect_with(&options, control)?;
        Ok(found.keypoints.into_iter().map(|keypoint| keypoint.position).collect())
    }

    /// Descriptors `(N, dimension)` of points `(N, 3)` in the cloud's frame, flat; see [`Scan::dimension`].
    ///
    /// # Errors
    /// [`Error::Input`](snake_core::Error::Input) for coordinates that are not finite;
    /// [`Error::Option`](snake_core::Error::Option) for descriptors of the field of a scan without a model;
    /// [`Error::Weights`](snake_core::Error::Weights) when the model overflows.
    pub fn descriptors(&self, points: &[Point], descriptor: Descriptor) -> Result<Vec<f32>> {
        self.descriptors_with(points, descriptor, &Control::default())
    }

    /// [`Scan::descriptors`] with progress and cancellation.
    ///
    /// # Errors
    /// The errors of [`Scan::descriptors`]; [`Error::Cancelled`](snake_core::Error::Cancelled) and
    /// [`Error::DeadlineExceeded`](snake_core::Error::DeadlineExceeded).
    pub fn descriptors_with(&self, points: &[Point], descriptor: Descriptor, control: &Control) -> Result<Vec<f32>> {
        match descriptor {
            Descriptor::Fpfh => self.fpfh_at(points, control),
            Descriptor::Field => self.field(control)?.descriptors(points),
        }
    }

    /// Length of a descriptor.
    ///
    /// # Errors
    /// [`Error::Option`](snake_core::Error::Option) for descriptors of the field of a scan without a model.
    pub fn dimension(&self, descriptor: Descriptor) -> Result<usize> {
        match descriptor {
            Descriptor::Fpfh => Ok(FPFH_DIMENSION),
            Descriptor::Field => Ok(self.model()?.0.config().c_dim),
        }
    }

    /// FPFH at the voxels nearest to the points.
    fn fpfh_at(&self, points: &[Point], control: &Control) -> Result<Vec<f32>> {
        if !points.is_empty() {
            check_points("points", points)?;
        }
        let voxels: Vec<usize> = points.iter().map(|&point| self.nearest_voxel(point)).collect();
        self.fpfh_of(&voxels, self.orientation != Orientation::Unsigned, control)
    }

    /// FPFH of voxels, of normals with a sign or without one.
    pub(crate) fn fpfh_of(&self, voxels: &[usize], signed: bool, control: &Control) -> Result<Vec<f32>> {
        let slot = &self.fpfh[usize::from(signed)];
        let all = match slot.get() {
            Some(all) => all,
            None => {
                let (points, normals) = (&self.voxels.points, &self.normals);
                let made = fast_fpfh::descriptors(points, normals, signed, self.feature_radius, control)?;
                slot.get_or_init(|| made)
            }
        };
        let rows = voxels.iter().map(|voxel| &all[voxel * FPFH_DIMENSION..][..FPFH_DIMENSION]);
        Ok(rows.flatten().copied().collect())
    }
}

/// Scenes are normalised to the cube, which they fill better than the sphere that suits objects. A cube cannot be
/// rotated within itself.
const NORMALIZATION: NormalizationMethod = NormalizationMethod::UnitCube;

/// Reduces finite points to voxel means.
pub(crate) fn reduce(points: &[Point], voxel_size: f64, control: &Control) -> Result<Neighbors> {
    let counter = control.begin("voxels", points.len());
    Ok(Neighbors::new(voxel_means(points, voxel_size, &counter)?)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use KeypointDetector::{Fps, Harris3d, Iss, Random, Sift3d, Snake, Voxels};
    use snake_core::Builtin;

    fn sample() -> Vec<Point> {
        snake_io::read_points(concat!(env!("CARGO_MANIFEST_DIR"), "/../../samples/plane.ply").as_ref()).unwrap()
    }

    fn with_model(scan: Scan, model: &Model) -> Scan {
        let options = Scan::default_options(model, scan.voxel_size);
        scan.with_model(model, options)
    }

    fn scan_of(points: &[Point], voxel_size: f64) -> Scan {
        with_model(Scan::new(points, voxel_size).unwrap(), &Model::builtin(Builtin::Compact))
    }

    #[test]
    fn every_detector_has_keypoints_of_its_own_on_the_cloud_best_first() {
        let scan = scan_of(&sample(), 0.02);
        let mut earlier: Vec<Vec<Point>> = Vec::new();
        for detector in [Voxels, Snake, Iss, Harris3d, Sift3d, Fps, Random] {
            let keypoints = |count, seed| scan.keypoints(detector, count, seed).unwrap();
            let found = keypoints(100, 0);
            assert!((5..=100).contains(&found.len()), "{detector:?}: {}", found.len());
            let drawn = [Voxels, Random].contains(&detector);
            assert!(detector == Voxels || keypoints(5, 0) == found[..5], "{detector:?}");
            assert_eq!(keypoints(100, 1) == found, !drawn, "{detector:?}");
            assert!(found.iter().all(|&point| scan.voxels.distance(&vector(point)) < 0.1), "{detector:?}");
            assert!(!earlier.contains(&found), "{detector:?}");
            earlier.push(found);
        }
        let sparse: Vec<Point> = sample().into_iter().step_by(20).collect();
        let scan_of_sparse = scan_of(&sparse, 1e-3);
        assert_eq!(scan_of_sparse.keypoints(Snake, 100_000, 0).unwrap().len(), sparse.len());
        let error = scan.keypoints(Iss, 0, 0).unwrap_err().to_string();
        assert!(error.contains("count"), "{error}");
    }

    #[test]
    fn spread_keypoints_have_the_wanted_number_and_cover_the_cloud() {
        let scan = scan_of(&sample(), 0.02);
        let uncovered = |keypoints: &[Point]| {
            let tree = Neighbors::new(keypoints.iter().map(|&point| vector(point)).collect()).unwrap();
            scan.voxels.points.iter().map(|voxel| tree.distance(voxel)).sum::<f64>()
        };
        for detector in [Voxels, Snake, Random, Fps] {
            let spread = |count, seed| scan.spread_keypoints_with(detector, count, seed, &Control::default()).unwrap();
            let (found, best) = (spread(60, 0), scan.keypoints(detector, 60, 0).unwrap());
            assert_eq!(found.len(), 60, "{detector:?}");
            let [spread_out, clustered] = [&found, &best].map(|keypoints| uncovered(keypoints));
            let most = if detector == Fps { 1.0 } else { 0.9 };
            assert!(spread_out <= most * clustered, "{detector:?}: {spread_out} {clustered}");
            assert_eq!(spread(60, 1) == found, ![Voxels, Random].contains(&detector), "{detector:?}");
        }
        // ISS finds fewer than are wanted.
        let all = scan.keypoints(Iss, 5000, 0).unwrap();
        assert_eq!(scan.spread_keypoints_with(Iss, 5000, 0, &Control::default()).unwrap(), all);
    }

    #[test]
    fn a_model_that_recommends_several_copies_encodes_one() {
        let model = Model::named("standard").unwrap();
        assert!(model.recommended().encode.rotations > 1);
        let scan = with_model(Scan::new(&sample(), 0.05).unwrap(), &model);
        assert_eq!(scan.keypoints(Snake, 10, 0).unwrap().len(), 10);
    }

    #[test]
    fn the_model_runs_only_for_what_asks_for_its_field_and_once() {
        for name in Model::NAMES {
            let scan = with_model(Scan::new(&sample(), 0.05).unwrap(), &Model::named(name).unwrap());
            scan.keypoints(Iss, 10, 0).unwrap();
            scan.descriptors(&sample()[..3], Descriptor::Fpfh).unwrap();
            assert!(scan.field.get().is_none(), "{name}");
            scan.keypoints(Snake, 10, 0).unwrap();
            scan.descriptors(&sample()[..3], Descriptor::Field).unwrap();
            let first: *const Field = scan.field.get().unwrap();
            scan.descriptors(&sample()[..3], Descriptor::Field).unwrap();
            assert!(std::ptr::eq(first, scan.field.get().unwrap()), "{name}");
        }
    }

    #[test]
    fn a_scan_without_a_model_has_all_but_its_keypoints_and_descriptors() {
        let scan = Scan::new(&sample(), 0.05).unwrap();
        for detector in [Voxels, Iss, Harris3d, Sift3d, Fps, Random] {
            assert!(!scan.keypoints(detector, 10, 0).unwrap().is_empty(), "{detector:?}");
        }
        assert_eq!(scan.descriptors(&sample()[..3], Descriptor::Fpfh).unwrap().len(), 3 * FPFH_DIMENSION);
        let refused = [
            scan.keypoints(Snake, 10, 0).err(),
            scan.spread_keypoints_with(Snake, 10, 0, &Control::default()).err(),
            scan.descriptors(&sample()[..3], Descriptor::Field).err(),
            scan.dimension(Descriptor::Field).err(),
        ];
        for error in refused {
            let error = error.unwrap().to_string();
            assert!(error.contains("`model` is none"), "{error}");
        }
    }

    #[test]
    fn descriptors_are_rows_of_the_voxel_nearest_to_each_point() {
        let scan = scan_of(&sample(), 0.05);
        let voxels: Vec<Point> = scan.voxels.points.iter().map(|point| point.map(|v| v as f32).into()).collect();
        for descriptor in [Descriptor::Fpfh, Descriptor::Field] {
            let all = scan.descriptors(&voxels, descriptor).unwrap();
            let dimension = scan.dimension(descriptor).unwrap();
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
        let scan = |points: &[Point], size| Scan::new(points, size).err().unwrap().to_string();
        assert!(scan(&[], 0.1).contains("no points"));
        assert!(scan(&[[f32::NAN; 3]; 2], 0.1).contains("finite"));
        assert!(scan(&[[1.0; 3]; 4], 0.1).contains("two different"));
        assert!(scan(&sample(), 0.0).contains("voxel_size"));
    }
}

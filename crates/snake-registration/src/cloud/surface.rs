//! How well two surfaces fit under a transform.

use nalgebra::IsometryMatrix3;
use rayon::prelude::*;

use crate::cloud::depth_image::{COARSE, DepthImage, FINE, Sight};
use crate::cloud::near_grid::NearGrid;
use crate::rigid::moved;
use snake_geometry::{Vector, some_in_parallel};

/// Two normals agree if their cosine is above this. Set by hand.
pub(crate) const AGREEING_COSINE: f64 = 0.7;
/// Tolerance of a coarse depth image. Unit: inlier distances. Half and twice change no outcome.
pub(crate) const DEPTH_MARGIN: f64 = 1.5;
/// Weight of violated free space relative to the overlap in a transform's score. Unit: overlap per share of violated
/// free space. Chosen on pairs of indoor scans.
const VIOLATION_WEIGHT: f64 = 2.0;
/// Weight of an inlier relative to the overlap in a transform's score. Unit: overlap per inlier. Chosen on pairs of
/// indoor scans.
const INLIER_WEIGHT: f64 = 0.005;
/// Largest share of opposite normals on the overlap if the sensors were at the origins. Unit: share of the overlap.
/// Scans have 0.05 and less, simulated sweeps 0.14, objects around the origin 0.2 to 0.5.
pub(crate) const MAX_OPPOSED: f64 = 0.15;
/// Maximum number of the source's voxels in a coarse comparison of transforms. Half and twice change no outcome.
const COARSE_VOXELS: usize = 700;

/// The voxels of a cloud, indexed for the comparison with another cloud.
pub(crate) struct Surface<'a> {
    pub(crate) points: &'a [Vector],
    pub(crate) normals: &'a [Vector],
    /// Finds voxels within the inlier distance.
    pub(crate) grid: NearGrid,
    /// Whether normals point to the sensor.
    signed: bool,
    /// What the sensor saw; `None` if it is not known.
    image: Option<DepthImage>,
}

/// How well a source fits a target under a transform.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Agreement {
    /// Share of the source's points that lie on the target and whose normals agree.
    pub(crate) overlap: f64,
    /// Share of both clouds' points in free space: the other cloud's sensor saw through them.
    pub(crate) violation: f64,
}

impl Agreement {
    /// The score that ranks transforms. Planes overlap under many wrong transforms, so the inliers count too.
    pub(crate) fn score(&self, num_inliers: usize) -> f64 {
        self.fit() + INLIER_WEIGHT * num_inliers as f64
    }

    /// The overlap less the violated free space.
    pub(crate) fn fit(&self) -> f64 {
        self.overlap - VIOLATION_WEIGHT * self.violation
    }
}

/// The step with which a coarse comparison samples a cloud of `voxels` voxels.
pub(crate) fn coarse_step(voxels: usize) -> usize {
    voxels.div_ceil(COARSE_VOXELS)
}

impl<'a> Surface<'a> {
    pub(crate) fn new(
        points: &'a [Vector],
        normals: &'a [Vector],
        viewpoint: Option<Vector>,
        inlier_distance: f64,
    ) -> Self {
        let margin = DEPTH_MARGIN * inlier_distance;
        let image = viewpoint.map(|viewpoint| DepthImage::new(points, viewpoint, margin, COARSE));
        Self { points, normals, grid: NearGrid::new(points, inlier_distance), signed: image.is_some(), image }
    }

    /// The same surface with unsigned normals.
    pub(crate) fn without_signs(self) -> Self {
        Self { signed: false, ..self }
    }

    /// Whether normals point to the sensor.
    pub(crate) fn is_signed(&self) -> bool {
        self.signed
    }

    /// Whether two normals agree; normals without a sign may be opposite.
    fn agree(&self, a: &Vector, b: &Vector) -> bool {
        let cosine = a.dot(b);
        (if self.is_signed() { cosine } else { cosine.abs() }) > AGREEING_COSINE
    }

    /// The unit bisector of two normals; `None` if they do not agree.
    pub(crate) fn common_normal(&self, a: &Vector, b: &Vector) -> Option<Vector> {
        self.agree(a, b).then(|| (if a.dot(b) < 0.0 { b - a } else { a + b }).normalize())
    }

    /// Compares every `step`-th point of the source, and as many of the target, with the other surface.
    pub(crate) fn agreement(source: &Self, target: &Self, transform: &IsometryMatrix3<f64>, step: usize) -> Agreement {
        let on_target = |index| source.is_on(index, target, transform);
        let count = |surface: &Self, step, is_one: &(dyn Fn(usize) -> bool + Sync)| {
            some_in_parallel((0..surface.points.len()).step_by(step), |index| is_one(index).then_some(())).len()
        };
        let source_count = source.points.len().div_ceil(step);
        let overlapping = count(source, step, &on_target);
        let target_step = target.points.len().div_ceil(source_count);
        let target_count = target.points.len().div_ceil(target_step);
        let inverse = transform.inverse();
        let violating = count(source, step, &|i| target.saw_through(&moved(transform, &source.points[i])));
        let seen_through = count(target, target_step, &|i| source.saw_through(&moved(&inverse, &target.points[i])));
        Agreement {
            overlap: overlapping as f64 / source_count as f64,
            violation: (violating + seen_through) as f64 / (source_count + target_count) as f64,
        }
    }

    /// Whether a point lies on the target under the transform, and the normals agree.
    pub(crate) fn is_on(&self, index: usize, target: &Self, transform: &IsometryMatrix3<f64>) -> bool {
        self.partner(index, target, transform).is_some()
    }

    /// The target point nearest to a point under the transform; `None` if none is near or the normals do not agree.
    pub(crate) fn partner(&self, index: usize, target: &Self, transform: &IsometryMatrix3<f64>) -> Option<usize> {
        let normal = transform.rotation * self.normals[index];
        let (nearest, _) = target.grid.nearest(&moved(transform, &self.points[index]))?;
        target.agree(&normal, &target.normals[nearest]).then_some(nearest)
    }

    pub(crate) fn viewpoint(&self) -> Option<Vector> {
        self.image.as_ref().map(|image| image.viewpoint)
    }

    /// Share of opposite normals among the source's points that lie on the target and whose normals are
    /// parallel; 0 without any.
    pub(crate) fn opposed(source: &Self, target: &Self, transform: &IsometryMatrix3<f64>) -> f64 {
        let cosine = |index: usize| {
            let (other, _) = target.grid.nearest(&moved(transform, &source.points[index]))?;
            Some((transform.rotation * source.normals[index]).dot(&target.normals[other]))
        };
        let mut parallel = some_in_parallel(0..source.points.len(), cosine);
        parallel.retain(|cosine| cosine.abs() > AGREEING_COSINE);
        parallel.iter().filter(|cosine| **cosine < 0.0).count() as f64 / parallel.len().max(1) as f64
    }

    /// Share of both clouds' points that lie in free space according to a fine depth image of the other
    /// cloud; 0 if the viewpoints are not known.
    pub(crate) fn fine_violation(surfaces: &[Self; 2], transform: &IsometryMatrix3<f64>) -> f64 {
        Self::violation(surfaces, &surfaces.each_ref().map(Self::fine_image), transform, 1)
    }

    /// Share of every `step`-th point of both clouds that lies in free space according to the image of
    /// the other cloud.
    pub(crate) fn violation(
        [source, target]: &[Self; 2],
        [source_image, target_image]: &[Option<DepthImage>; 2],
        transform: &IsometryMatrix3<f64>,
        step: usize,
    ) -> f64 {
        let free = |surface: &Self, image: &Option<DepthImage>, transform: &IsometryMatrix3<f64>| {
            let Some(image) = image else { return 0 };
            let is_free = |point| (image.sight(&moved(transform, point)) == Sight::Free).then_some(());
            some_in_parallel(surface.points.iter().step_by(step), is_free).len()
        };
        let count = free(source, target_image, transform) + free(target, source_image, &transform.inverse());
        let points = source.points.len().div_ceil(step) + target.points.len().div_ceil(step);
        count as f64 / points as f64
    }

    /// A fine depth image of what the sensor saw; `None` if it is not known.
    pub(crate) fn fine_image(&self) -> Option<DepthImage> {
        let coarse = self.image.as_ref()?;
        Some(DepthImage::new(self.points, coarse.viewpoint, self.grid.distance(), FINE))
    }

    fn saw_through(&self, point: &Vector) -> bool {
        self.image.as_ref().is_some_and(|image| image.sight(point) == Sight::Free)
    }
}

/// The quality of a transform, as in Open3D's `evaluate_registration`: the share of source points closer than the
/// grid's distance to the target, and the root mean square distance of these points; 0 without any.
pub(crate) fn fitness(source: &[Vector], target: &NearGrid, transform: &IsometryMatrix3<f64>) -> (f64, f64) {
    let squared = |point: &Vector| target.nearest(&moved(transform, point)).map(|(_, squared)| squared);
    let squared: Vec<f64> = source.par_iter().filter_map(squared).collect();
    let count = squared.len() as f64;
    let sum = squared.iter().fold(0.0, |sum, squared| sum + squared);
    (count / source.len().max(1) as f64, (sum / count.max(1.0)).sqrt())
}

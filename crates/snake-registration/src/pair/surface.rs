//! How well two surfaces fit under a transform.

use nalgebra::IsometryMatrix3;
use rayon::prelude::*;

use crate::parts::depth_image::{COARSE, DepthImage, FINE, Sight};
use crate::parts::near_grid::NearGrid;
use crate::parts::rigid::moved;
use snake_geometry::Vector;

/// The cosine from which on two normals agree.
pub(crate) const AGREEING_COSINE: f64 = 0.7;
/// Tolerance of distances from the viewpoint, in inlier distances.
const DEPTH_MARGIN: f64 = 1.5;

/// The voxels of a cloud with what verification needs of them.
pub(crate) struct Surface<'a> {
    pub(crate) points: &'a [Vector],
    pub(crate) normals: &'a [Vector],
    /// Finds voxels within the inlier distance.
    pub(crate) grid: NearGrid,
    /// What the sensor saw; `None` if normals have no sign.
    image: Option<DepthImage>,
}

/// How well a source fits a target under a transform.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Agreement {
    /// Share of the source's points on the target with agreeing normals.
    pub(crate) overlap: f64,
    /// Share of the points of both that lie in space that the other's sensor saw to be free.
    pub(crate) violation: f64,
}

impl Agreement {
    /// What ranks transforms. Planes overlap under many wrong transforms, so that the matches that agree count too.
    pub(crate) fn score(&self, num_inliers: usize) -> f64 {
        self.fit() + PER_INLIER * num_inliers as f64
    }

    /// The overlap less the violated free space.
    pub(crate) fn fit(&self) -> f64 {
        self.overlap - PER_VIOLATION * self.violation
    }
}

/// Weights of the score beside the overlap, chosen on pairs of indoor scans.
const PER_VIOLATION: f64 = 2.0;
const PER_INLIER: f64 = 0.005;

/// Number of the source's voxels that compare transforms coarsely.
const COARSE_VOXELS: usize = 700;

/// Every so many voxels take part in a coarse comparison.
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
        Self { points, normals, grid: NearGrid::new(points, inlier_distance), image }
    }

    /// Whether normals point to the sensor.
    pub(crate) fn is_signed(&self) -> bool {
        self.image.is_some()
    }

    /// Whether two normals agree; normals without a sign may be opposite.
    fn agree(&self, a: &Vector, b: &Vector) -> bool {
        let cosine = a.dot(b);
        (if self.is_signed() { cosine } else { cosine.abs() }) > AGREEING_COSINE
    }

    /// The unit vector between two normals that agree.
    pub(crate) fn common_normal(&self, a: &Vector, b: &Vector) -> Option<Vector> {
        self.agree(a, b).then(|| (if a.dot(b) < 0.0 { b - a } else { a + b }).normalize())
    }

    /// Compares every `step`-th point of the source, and as many of the target, with the other surface.
    pub(crate) fn agreement(source: &Self, target: &Self, transform: &IsometryMatrix3<f64>, step: usize) -> Agreement {
        let on_target = |index: &usize| source.is_on(*index, target, transform);
        let indices = |surface: &Self, step| (0..surface.points.len()).into_par_iter().step_by(step);
        let of_source = source.points.len().div_ceil(step);
        let overlapping = indices(source, step).filter(on_target).count();
        let step_of_target = target.points.len().div_ceil(of_source);
        let of_target = target.points.len().div_ceil(step_of_target);
        let inverse = transform.inverse();
        let violating = indices(source, step).filter(|&i| target.saw_through(&moved(transform, &source.points[i])));
        let seen_through =
            indices(target, step_of_target).filter(|&i| source.saw_through(&moved(&inverse, &target.points[i])));
        Agreement {
            overlap: overlapping as f64 / of_source as f64,
            violation: (violating.count() + seen_through.count()) as f64 / (of_source + of_target) as f64,
        }
    }

    /// Whether the transform brings a point to the target, with normals that agree.
    pub(crate) fn is_on(&self, index: usize, target: &Self, transform: &IsometryMatrix3<f64>) -> bool {
        let normal = transform.rotation * self.normals[index];
        let nearest = target.grid.nearest(&moved(transform, &self.points[index]));
        nearest.is_some_and(|(other, _)| target.agree(&normal, &target.normals[other]))
    }

    pub(crate) fn viewpoint(&self) -> Option<Vector> {
        self.image.as_ref().map(|image| image.viewpoint)
    }

    /// Whether the sensor would see a surface here; of a cloud without a known sensor, everywhere.
    pub(crate) fn sees(&self, point: &Vector) -> bool {
        self.image.as_ref().is_none_or(|image| matches!(image.sight(point), Sight::Free | Sight::Surface))
    }

    /// Of the source's points on the target with parallel normals, the share whose normals are opposite; 0 without any.
    pub(crate) fn opposed(source: &Self, target: &Self, transform: &IsometryMatrix3<f64>) -> f64 {
        let cosine = |index: usize| {
            let (other, _) = target.grid.nearest(&moved(transform, &source.points[index]))?;
            Some((transform.rotation * source.normals[index]).dot(&target.normals[other]))
        };
        let cosines = (0..source.points.len()).into_par_iter().filter_map(cosine);
        let parallel: Vec<f64> = cosines.filter(|cosine| cosine.abs() > AGREEING_COSINE).collect();
        parallel.iter().filter(|cosine| **cosine < 0.0).count() as f64 / parallel.len().max(1) as f64
    }

    /// The share of the points of both that lie in space that a fine depth image of the other shows to be free; 0 if the
    /// viewpoints are not known.
    pub(crate) fn fine_violation([source, target]: &[Self; 2], transform: &IsometryMatrix3<f64>) -> f64 {
        let free = |points: &Self, seen: &Self, transform: &IsometryMatrix3<f64>| {
            let Some(coarse) = &seen.image else { return 0 };
            let image = DepthImage::new(seen.points, coarse.viewpoint, seen.grid.distance(), FINE);
            points.points.par_iter().filter(|point| image.sight(&moved(transform, point)) == Sight::Free).count()
        };
        let count = free(source, target, transform) + free(target, source, &transform.inverse());
        count as f64 / (source.points.len() + target.points.len()) as f64
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

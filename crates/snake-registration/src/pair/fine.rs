//! Planar patches of clouds as they were measured: what they constrain, and the last refinement.

use std::num::NonZeroUsize;
use std::sync::OnceLock;

use nalgebra::IsometryMatrix3;
use rayon::prelude::*;

use crate::pair::icp::{PlanePair, iterate};
use crate::parts::cloud::voxel_means;
use crate::parts::rigid::moved;
use snake_core::{Counter, Result};
use snake_geometry::{Neighbors, Point, Vector, eigen};

/// The side of a fine voxel, in voxels,
const SIDE: f64 = 0.125;
/// or so large that a cloud has about this many.
const MOST_VOXELS: f64 = 60_000.0;
/// A refinement on fine voxels is worth its time if there are so many for a voxel.
const LEAST_RATIO: usize = 4;
/// Number of neighbours that a normal follows from.
const NEIGHBORS: NonZeroUsize = NonZeroUsize::new(16).unwrap();
/// A neighbourhood is a planar patch if the variance across it is less than this share of that along it,
const MOST_THICKNESS: f64 = 0.15;
/// and that along it is more than this share of the squared radius; of a filled disc it is 0.25. Points where a beam crosses
/// an edge lie on a plane too, but on none of the surface.
const LEAST_WIDTH: f64 = 0.1;
/// The cosine from which on two normals agree.
pub(crate) const AGREEING_COSINE: f64 = 0.9;
/// Number of source points that are paired.
const SAMPLES: usize = 2500;
/// Pairs are closer than this many fine voxels, in two rounds of so many steps at most.
const ROUNDS: [(f64, usize); 2] = [(4.0, 4), (2.0, 8)];
/// Of all pairs, those farther than this many medians are left out.
const MOST_MEDIANS: f64 = 4.0;
/// Points can show that surfaces lie apart if fine voxels are smaller than this share of a voxel.
const MOST_SIDE: f64 = 0.2;
/// Patches tell what the overlap leaves open if they are at least this share of it. They are 0.7 and more of corridors, tunnels
/// and balls.
const LEAST_PLANAR: f64 = 0.5;
/// Two patches coincide if the distance between them is less than this times their thickness.
const COINCIDING: f64 = 2.0;
/// With fewer pairs the rough transform stays.
const LEAST_PAIRS: usize = 100;

/// The normal of a planar patch, without a sign, and the standard deviation across it.
#[derive(Clone, Copy)]
struct Patch {
    normal: Vector,
    thickness: f64,
}

/// A cloud in fine voxels, with normals that are computed when they are needed.
pub(crate) struct FineCloud {
    cloud: Neighbors,
    patches: Vec<OnceLock<Option<Patch>>>,
    side: f64,
    /// Whether the cloud is much finer than the voxels.
    is_finer: bool,
}

impl FineCloud {
    /// A cloud that has `count` voxels of side `voxel_size`.
    pub(crate) fn new(points: &[Point], voxel_size: f64, count: usize) -> Result<Self> {
        // The number of voxels of a surface follows from the square of their side.
        let side = voxel_size * SIDE.max((count as f64 / MOST_VOXELS).sqrt());
        let means = voxel_means(points, side, &Counter::default())?;
        let patches = (0..means.len()).map(|_| OnceLock::new()).collect();
        let is_finer = means.len() >= LEAST_RATIO * count;
        Ok(Self { cloud: Neighbors::new(means)?, patches, side, is_finer })
    }

    /// The planar patch around a point.
    fn patch(&self, index: usize) -> Option<Patch> {
        *self.patches[index].get_or_init(|| {
            let near = self.cloud.nearest(&self.cloud.points[index], NEIGHBORS);
            let (_, radius) = *near.last()?;
            let near: Vec<usize> = near.into_iter().map(|(index, _)| index).collect();
            let ([across, width, _], normal) = eigen(self.cloud.covariance(&near));
            (across < MOST_THICKNESS * width && width > LEAST_WIDTH * radius * radius)
                .then(|| Patch { normal, thickness: across.max(0.0).sqrt() })
        })
    }
}

impl FineCloud {
    /// The point nearest to a place, if it lies closer than `most` on a planar patch with about this normal, which passes the
    /// place within `tolerance`.
    pub(crate) fn patch_at(&self, place: &Vector, normal: &Vector, most: f64, tolerance: f64) -> Option<Vector> {
        let (nearest, distance) = *self.cloud.nearest(place, NonZeroUsize::MIN).first()?;
        let point = self.cloud.points[nearest];
        let is_on = distance < most && normal.dot(&(point - place)).abs() < tolerance;
        (is_on && self.patch(nearest)?.normal.dot(normal).abs() > AGREEING_COSINE).then_some(point)
    }
}

/// Refines a transform on the planar patches of both clouds, if they are much finer than the voxels.
pub(crate) fn refine_finely(
    clouds: [&FineCloud; 2],
    rough: IsometryMatrix3<f64>,
    gravity: Option<Vector>,
    counter: &Counter,
) -> Result<IsometryMatrix3<f64>> {
    if !clouds.iter().all(|cloud| cloud.is_finer) {
        return Ok(rough);
    }
    let mut transform = rough;
    for (factor, steps) in ROUNDS {
        let distance = factor * clouds[0].side.max(clouds[1].side);
        let pairs = |transform: &IsometryMatrix3<f64>| without_far(overlap(clouds, transform, distance).patches);
        transform = iterate(pairs, transform, gravity, (steps, distance), counter)?;
    }
    Ok(transform)
}

/// Planar patches that both clouds have.
pub(crate) struct Overlap {
    /// Points of the source, each with the plane between its patch and that of the nearest target point.
    pub(crate) patches: Vec<PlanePair>,
    /// The share of the patches that coincide within their thickness.
    coinciding: f64,
    /// The share of the source's points on the target that lie on patches of both.
    planar: f64,
}

/// Some of the patches of the overlap, closer than `most`.
pub(crate) fn overlap([source, target]: [&FineCloud; 2], transform: &IsometryMatrix3<f64>, most: f64) -> Overlap {
    let near = |index: usize| {
        let point = moved(transform, &source.cloud.points[index]);
        let (nearest, distance) = *target.cloud.nearest(&point, NonZeroUsize::MIN).first()?;
        (distance <= most).then_some((index, point, nearest))
    };
    let pair = |(index, point, nearest): (usize, Vector, usize)| {
        let (of_source, of_target) = (source.patch(index)?, target.patch(nearest)?);
        let (a, b) = (transform.rotation * of_source.normal, of_target.normal);
        let cosine = a.dot(&b);
        let normal = (if cosine < 0.0 { b - a } else { a + b }).normalize();
        let distance = normal.dot(&(target.cloud.points[nearest] - point));
        let coincides = distance.abs() < COINCIDING * of_source.thickness.hypot(of_target.thickness);
        (cosine.abs() > AGREEING_COSINE).then_some((PlanePair { point, normal, distance }, coincides))
    };
    let step = source.cloud.points.len().div_ceil(SAMPLES);
    let indices = (0..source.cloud.points.len()).into_par_iter().step_by(step);
    let pairs: Vec<Option<(PlanePair, bool)>> = indices.filter_map(near).map(pair).collect();
    let count = pairs.len().max(1) as f64;
    let (patches, coincide): (Vec<PlanePair>, Vec<bool>) = pairs.into_iter().flatten().unzip();
    let coinciding = coincide.iter().filter(|coincides| **coincides).count() as f64 / patches.len().max(1) as f64;
    Overlap { coinciding, planar: patches.len() as f64 / count, patches }
}

impl Overlap {
    /// Whether most of the overlap lies on planar patches. Otherwise they do not tell what the rest fixes.
    pub(crate) fn is_planar(&self) -> bool {
        self.planar >= LEAST_PLANAR
    }

    /// The share of the patches that coincide, if the points of both clouds are so much finer than the voxels that they can
    /// show it: coarse voxels hide such errors.
    pub(crate) fn coinciding(&self, clouds: [&FineCloud; 2], voxel_size: f64) -> Option<f64> {
        let is_fine = |cloud: &&FineCloud| cloud.is_finer && cloud.side < MOST_SIDE * voxel_size;
        (self.patches.len() >= LEAST_PAIRS && clouds.iter().all(is_fine)).then_some(self.coinciding)
    }
}

/// The pairs without those whose planes are much farther than most; none of too few.
fn without_far(mut pairs: Vec<PlanePair>) -> Vec<PlanePair> {
    if pairs.len() < LEAST_PAIRS {
        return Vec::new();
    }
    let mut distances: Vec<f64> = pairs.iter().map(|pair| pair.distance.abs()).collect();
    let middle = distances.len() / 2;
    let (_, median, _) = distances.select_nth_unstable_by(middle, f64::total_cmp);
    let limit = MOST_MEDIANS * *median;
    pairs.retain(|pair| pair.distance.abs() <= limit);
    pairs
}

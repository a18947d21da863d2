//! Planar patches of the original clouds in fine voxels, and the patches that two clouds share.

use std::collections::HashSet;
use std::num::NonZeroUsize;
use std::sync::OnceLock;

use nalgebra::IsometryMatrix3;

use crate::cloud::planes::PlanePair;
use crate::cloud::upper_median;
use crate::cloud::voxels::voxel_means;
use crate::rigid::moved;
use snake_core::{Counter, Result};
use snake_geometry::{Neighbors, Point, Vector, eigen, in_parallel, some_in_parallel};

/// Smallest side of a fine voxel. Unit: voxels. Set by hand.
const MIN_SIDE: f64 = 0.125;
/// Approximate maximum number of fine voxels of a cloud, which determines their side. Set by hand.
const MAX_VOXELS: f64 = 60_000.0;
/// A cloud is finer than its voxels if it has at least this many fine voxels per voxel. Otherwise a refinement on fine
/// voxels is not worth its time. Unit: fine voxels per voxel. Half and twice change no outcome.
const MIN_RATIO: usize = 4;
/// Number of nearest fine voxels whose covariance gives a normal. Half and twice change no outcome.
const NEIGHBORS: NonZeroUsize = NonZeroUsize::new(16).unwrap();
/// Largest ratio of the variance across a planar patch to the smaller variance along it. Unit: ratio of variances. Half
/// and twice change no outcome.
const MAX_THICKNESS: f64 = 0.15;
/// The same ratio for a patch that the last refinement weighs by its noise, such as on a far wall of a depth frame.
/// Chosen on synthetic rooms of depth frames.
const MAX_NOISY_THICKNESS: f64 = 0.3;
/// Smallest ratio of the smaller variance along a planar patch to its squared radius. A filled disc has 0.25. Patches
/// where a beam crosses an edge have less: they lie on a plane that is not part of the surface. Unit: ratio of
/// variances. Set by hand.
const MIN_WIDTH: f64 = 0.1;
/// The normals of two patches agree if the absolute value of their cosine is above this. Set by hand.
pub(crate) const AGREEING_COSINE: f64 = 0.9;
/// The same cosine for patches that are weighed by their noise. Chosen on synthetic rooms of depth frames.
const AGREEING_NOISY_COSINE: f64 = 0.8;
/// Maximum number of the source's fine voxels that are paired. Set for time (0.08 instead of 0.11 s of CPU for a pair
/// of synthetic streets).
const SAMPLES: usize = 2500;
/// Patches show what the overlap leaves open if they make up this share of it. Unit: share of the overlap. Corridors,
/// tunnels and balls have 0.7 and more, wires and rough objects less.
const MIN_PLANAR: f64 = 0.5;
/// A surface is apart from a plane beyond this many times their joint thickness. Unit: standard deviations.
const APART: f64 = 4.0;
/// It is apart by this at least, because surfaces without noise have no thickness. Unit: greatest distances.
const MIN_APART: f64 = 0.05;
/// Two patches are apart if they are also by this many times the median thickness: fused rooms drift by up to that. Unit: standard deviations.
const MEDIANS: f64 = 15.0;
/// If the median patch lies farther away than this, all lie apart. Unit: inlier distances. Right answers have at most 0.23
/// (real rooms), 0.1 (made ones); other objects that lie through each other 0.14 to 0.39.
const MAX_MEDIAN: f64 = 0.27;
/// Minimum noise of a pair of patches. Unit: fine voxels. Set by hand.
const MIN_NOISE: f64 = 0.05;
/// A surface farther from a place does not show whether the place lies on it. Unit: inlier distances. Half and twice
/// change no outcome.
pub(crate) const NEAR: f64 = 0.5;
/// A place on a planar patch lies on another patch if the plane is closer than this. Unit: inlier distances. Half and
/// twice change no outcome.
pub(crate) const MAX_OFFSET: f64 = 0.15;
/// Other places lie on a surface that is closer than this. Unit: inlier distances. Half and twice change no outcome.
const MAX_APART: f64 = 0.25;
/// Fewer pairs of patches do not show whether the surfaces coincide. Half and twice change no outcome.
pub(crate) const MIN_PAIRS: usize = 100;
/// Of those along one axis, fewer are enough. Motorways have 50 to 132 that face along the road.
const MIN_FACING: usize = 20;

/// A planar patch: its mean, its normal without a sign, and the standard deviation across it.
#[derive(Clone, Copy)]
struct Patch {
    mean: Vector,
    normal: Vector,
    thickness: f64,
    /// Whether it is within [`MAX_THICKNESS`], so that its plane constrains a transform without weighting.
    is_thin: bool,
}

/// The neighbourhood of a fine voxel.
#[derive(Clone, Copy)]
struct Surroundings {
    /// The planar patch, if it is one.
    patch: Option<Patch>,
    /// Distance to the farthest of the nearest fine voxels. A place closer than this may lie in a gap between samples.
    radius: f64,
}

/// A point, with the normal of its patch if that is planar.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Place {
    pub(crate) point: Vector,
    pub(crate) normal: Option<Vector>,
}

impl Place {
    /// The place under a transform.
    pub(crate) fn moved(&self, transform: &IsometryMatrix3<f64>) -> Self {
        let normal = self.normal.map(|normal| transform.rotation * normal);
        Self { point: moved(transform, &self.point), normal }
    }
}

/// A cloud in fine voxels, with normals that are computed on demand.
pub(crate) struct FineCloud {
    cloud: Neighbors,
    surroundings: Vec<OnceLock<Surroundings>>,
    /// Side of a fine voxel, in cloud units.
    pub(crate) side: f64,
    /// Whether the cloud is much finer than its voxels.
    pub(crate) is_finer: bool,
}

impl FineCloud {
    /// The fine voxels of a cloud that has `count` voxels of side `voxel_size`.
    pub(crate) fn new(points: &[Point], voxel_size: f64, count: usize) -> Result<Self> {
        // The number of voxels on a surface is inversely proportional to the square of their side.
        let side = voxel_size * MIN_SIDE.max((count as f64 / MAX_VOXELS).sqrt());
        let means = voxel_means(points, side, &Counter::default())?;
        let surroundings = (0..means.len()).map(|_| OnceLock::new()).collect();
        let is_finer = means.len() >= MIN_RATIO * count;
        Ok(Self { cloud: Neighbors::new(means)?, surroundings, side, is_finer })
    }

    /// The thin planar patch around a point.
    fn patch(&self, index: usize) -> Option<Patch> {
        self.surroundings(index).patch.filter(|patch| patch.is_thin)
    }

    fn surroundings(&self, index: usize) -> Surroundings {
        *self.surroundings[index].get_or_init(|| {
            let near = self.cloud.nearest(&self.cloud.points[index], NEIGHBORS);
            let radius = near.last().map_or(0.0, |(_, distance)| *distance);
            let near: Vec<usize> = near.into_iter().map(|(index, _)| index).collect();
            let ([across, width, _], normal) = eigen(self.cloud.covariance(&near));
            let is_planar = across < MAX_NOISY_THICKNESS * width && width > MIN_WIDTH * radius * radius;
            let mean = near.iter().map(|&index| self.cloud.points[index]).sum::<Vector>() / near.len() as f64;
            let (thickness, is_thin) = (across.max(0.0).sqrt(), across < MAX_THICKNESS * width);
            Surroundings { patch: is_planar.then_some(Patch { mean, normal, thickness, is_thin }), radius }
        })
    }

    /// The points of the fine voxels.
    pub(crate) fn points(&self) -> &[Vector] {
        &self.cloud.points
    }

    /// At most `count` of the fine voxels, no two in one cube of side `spacing`.
    pub(crate) fn thinned(&self, spacing: f64, count: usize) -> Vec<Place> {
        let points = &self.cloud.points;
        let mut cells = HashSet::new();
        let is_new = |index: &usize| cells.insert(points[*index].map(|v| (v / spacing).floor() as i64));
        let kept: Vec<usize> = (0..points.len()).filter(is_new).collect();
        let place =
            |&index: &usize| Place { point: points[index], normal: self.patch(index).map(|patch| patch.normal) };
        in_parallel(kept.iter().step_by(kept.len().div_ceil(count).max(1)), place)
    }

    /// At most `count` of the fine voxels under a transform. Voxels that are then `max_distance` or
    /// farther from another cloud are left out.
    pub(crate) fn places(
        &self,
        transform: &IsometryMatrix3<f64>,
        other: &Self,
        max_distance: f64,
        count: usize,
    ) -> Vec<Place> {
        let points = &self.cloud.points;
        let place = |index: usize| {
            let normal = self.patch(index).map(|patch| patch.normal);
            let place = Place { point: points[index], normal }.moved(transform);
            (other.distance(&place.point) < max_distance).then_some(place)
        };
        let step = points.len().div_ceil(count).max(1);
        some_in_parallel((0..points.len()).step_by(step), place)
    }

    /// The distance from a point to the cloud.
    pub(crate) fn distance(&self, point: &Vector) -> f64 {
        self.cloud.nearest(point, NonZeroUsize::MIN).first().map_or(f64::INFINITY, |(_, distance)| *distance)
    }

    /// Whether a place lies on the nearest surface; `None` if no surface is near, and if the place may lie in a gap between
    /// samples.
    pub(crate) fn lies_on(&self, place: &Place, inlier_distance: f64) -> Option<bool> {
        let (nearest, distance) = *self.cloud.nearest(&place.point, NonZeroUsize::MIN).first()?;
        if distance > NEAR * inlier_distance {
            return None;
        }
        let offset = self.cloud.points[nearest] - place.point;
        match (&place.normal, self.patch(nearest)) {
            (Some(normal), Some(patch)) => Some(
                patch.normal.dot(normal).abs() > AGREEING_COSINE
                    && normal.dot(&offset).abs() < MAX_OFFSET * inlier_distance,
            ),
            _ if distance < MAX_APART * inlier_distance => Some(true),
            _ => (distance > self.surroundings(nearest).radius).then_some(false),
        }
    }
}

/// Planar patches that both clouds share.
pub(crate) struct Overlap {
    /// Points of the source near the target, with the normals of their patches or the target's, and the distance at which a plane lies
    /// apart.
    pub(crate) places: Vec<(Place, f64)>,
    /// Points of the source, each with the mean plane of its patch and of the patch at the nearest target point.
    pub(crate) patches: Vec<PlanePair>,
    /// The pairs of these and of thicker patches, at the patches' means. Normals and distances are divided by the standard
    /// deviation across both patches, which is the noise of their points.
    pub(crate) weighed: Vec<PlanePair>,
    /// For each of the patches, whether it is apart, given its thickness.
    are_apart: Vec<bool>,
    /// The share of paired points whose patches in both clouds are thin and agree.
    planar: f64,
}

/// A sample of the patches that the clouds share under a transform, at most `max_distance` apart.
pub(crate) fn overlap(
    [source, target]: [&FineCloud; 2],
    transform: &IsometryMatrix3<f64>,
    max_distance: f64,
) -> Overlap {
    let near = |index: usize| {
        let point = moved(transform, &source.cloud.points[index]);
        let (nearest, distance) = *target.cloud.nearest(&point, NonZeroUsize::MIN).first()?;
        (distance <= max_distance).then_some((index, point, nearest))
    };
    let apart = |thickness: f64| (APART * thickness).max(MIN_APART * max_distance);
    let place = |(index, point, nearest): (usize, Vector, usize)| {
        let own = source.surroundings(index).patch;
        let own = own.map(|patch| Patch { normal: transform.rotation * patch.normal, ..patch });
        let patch = own.or(target.surroundings(nearest).patch);
        let place = Place { point, normal: patch.map(|patch| patch.normal) };
        (place, patch.map_or(max_distance, |patch| apart(patch.thickness)))
    };
    let pair = |(index, point, nearest): (usize, Vector, usize)| {
        let patches = [source.surroundings(index).patch?, target.surroundings(nearest).patch?];
        let [a, b] = [transform.rotation * patches[0].normal, patches[1].normal];
        let cosine = a.dot(&b);
        let normal = (if cosine < 0.0 { b - a } else { a + b }).normalize();
        let thickness = patches[0].thickness.hypot(patches[1].thickness);
        let thin = (patches.iter().all(|patch| patch.is_thin) && cosine.abs() > AGREEING_COSINE).then(|| {
            let distance = normal.dot(&(target.cloud.points[nearest] - point));
            (PlanePair { point, normal, distance }, thickness)
        });
        let (mean, noise) = (moved(transform, &patches[0].mean), thickness.max(MIN_NOISE * target.side));
        let distance = normal.dot(&(patches[1].mean - mean)) / noise;
        let weighed = PlanePair { point: mean, normal: normal / noise, distance };
        Some((thin, (cosine.abs() > AGREEING_NOISY_COSINE).then_some(weighed)))
    };
    let step = source.cloud.points.len().div_ceil(SAMPLES);
    let indices = (0..source.cloud.points.len()).step_by(step);
    let pairs = some_in_parallel(indices, |index| near(index).map(|near| (place(near), pair(near))));
    let (places, pairs): (Vec<_>, Vec<_>) = pairs.into_iter().unzip();
    let count = pairs.len().max(1) as f64;
    let (thin, weighed): (Vec<_>, Vec<_>) = pairs.into_iter().flatten().unzip();
    let (patches, thicknesses): (Vec<PlanePair>, Vec<f64>) = thin.into_iter().flatten().unzip();
    let distances: Vec<f64> = patches.iter().map(|pair| pair.distance.abs()).collect();
    let touches = upper_median(&distances) < MAX_MEDIAN * max_distance;
    let usual = MEDIANS * upper_median(&thicknesses);
    let is_apart = |(distance, own): (&f64, &f64)| !touches || *distance > usual.max(apart(*own));
    let are_apart = distances.iter().zip(&thicknesses).map(is_apart).collect();
    let planar = patches.len() as f64 / count;
    Overlap { places, planar, patches, are_apart, weighed: weighed.into_iter().flatten().collect() }
}

impl Overlap {
    /// Whether enough of the overlap is planar to show what it leaves open.
    pub(crate) fn is_planar(&self) -> bool {
        self.planar >= MIN_PLANAR
    }

    /// The share that is apart of the patches, or of those that face along an axis; 0 for fewer than [`MIN_PAIRS`] or [`MIN_FACING`].
    pub(crate) fn apart(&self, axis: Option<&Vector>) -> f64 {
        let counts = |patch: &PlanePair| axis.is_none_or(|axis| patch.normal.dot(axis).abs() > AGREEING_COSINE);
        let counted = self.patches.iter().zip(&self.are_apart).filter(|(patch, _)| counts(patch));
        let apart: Vec<bool> = counted.map(|(_, is_apart)| *is_apart).collect();
        let number = apart.iter().filter(|is_apart| **is_apart).count();
        let min = if axis.is_some() { MIN_FACING } else { MIN_PAIRS };
        if apart.len() < min { 0.0 } else { number as f64 / apart.len() as f64 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_contradicts_dense_samples_and_not_a_gap_between_beams() {
        let grid = |columns: usize, rows: usize, apart: f32| -> Vec<Point> {
            (0..columns * rows).map(|i| [(i % columns) as f32 * 0.1, (i / columns) as f32 * apart, 0.0]).collect()
        };
        let [dense, beams] =
            [grid(30, 30, 0.1), grid(30, 4, 1.0)].map(|points| FineCloud::new(&points, 0.4, 1).unwrap());
        let lies_on =
            |cloud: &FineCloud, point: [f64; 3]| cloud.lies_on(&Place { point: point.into(), normal: None }, 1.5);
        assert_eq!(lies_on(&dense, [1.5, 1.5, 0.3]), Some(true));
        assert_eq!(lies_on(&dense, [1.5, 1.5, 0.5]), Some(false));
        assert_eq!(lies_on(&beams, [1.5, 1.5, 0.0]), None);
        assert_eq!(lies_on(&beams, [1.5, 1.1, 0.0]), Some(true));
        // Nothing is near.
        assert_eq!(lies_on(&dense, [1.5, 1.5, 0.9]), None);
    }
    #[test]
    fn windows_elsewhere_lie_apart_and_drift_does_not() {
        let wall = |windows: std::ops::Range<usize>, drift: f32| {
            let point = |i: usize| {
                let (x, y, noise) = (i % 80, i / 80, (i * 7919 % 17) as f32 * 1e-3);
                let out = if windows.contains(&x) && windows.contains(&y) { 0.15 } else { 0.0 };
                [x as f32 * 0.1, y as f32 * 0.1, out + noise + drift]
            };
            FineCloud::new(&(0..6400).map(point).collect::<Vec<_>>(), 0.4, 1).unwrap()
        };
        let apart = |source, target| overlap([&source, &target], &IsometryMatrix3::identity(), 0.4).apart(None);
        assert_eq!(apart(wall(10..30, 0.0), wall(10..30, 0.05)), 0.0);
        assert!(apart(wall(10..30, 0.0), wall(50..70, 0.0)) > 0.1);
        let [far, near] = [wall(0..0, 0.0), wall(0..0, 0.09)];
        assert_eq!(overlap([&far, &near], &IsometryMatrix3::identity(), 0.3).apart(None), 1.0);
    }
}

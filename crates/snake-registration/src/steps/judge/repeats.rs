//! Slides under which the target looks alike, as along a row of equal pillars: a source that fits
//! at one place of the row fits at the others as well.

use super::constants::REPEAT_PARALLEL;
use std::collections::HashSet;

use nalgebra::Matrix3;
use rayon::prelude::*;

use crate::cloud::near_grid::NearGrid;
use crate::cloud::patches::{self, FineCloud};
use crate::cloud::planes::PlanePair;
use crate::cloud::surface::Surface;
use snake_geometry::Vector;

/// A patch tells whether a shift is right if the cosine between its normal and the shift is above this: a floor agrees
/// with all shifts along it. Set by hand.
const REPEAT_COSINE: f64 = 0.5;
/// Number of patches that are compared for a shift, at most. Half and twice change no outcome.
const REPEAT_PATCHES: usize = 40;
/// Number of normals among which the most frequent directions are searched, at most. Half and twice change no outcome.
const REPEAT_NORMALS: usize = 50;
/// Number of patches that a shift needs. Half and twice change no outcome.
const MIN_REPEAT_PATCHES: usize = 7;
/// Shifts that settle closer to each other are one. Unit: inlier distances. Set for time.
const REPEAT_SETTLED: f64 = 0.1;
/// A shifted patch agrees with a patch whose plane is closer than this. Unit: inlier distances. Half and twice change
/// no outcome.
const REPEAT_TOLERANCE: f64 = 0.12;
/// A shift is dropped early if too few of every so many patches are near other patches. Set for time.
const REPEAT_PROBE: usize = 4;
/// Number of least-squares steps by which a shift settles. Set for time.
const REPEAT_STEPS: usize = 2;
/// Length of the shortest shift. Unit: inlier distances. Half and twice change no outcome.
const MIN_REPEAT: f64 = 1.0;
/// Length of the longest shift. Unit: inlier distances. Set for time.
const MAX_REPEAT: f64 = 10.0;
/// Share of the patches that must agree with a shift; the others may have left the view. Half and twice change no
/// outcome.
const MIN_REPEAT_SHARE: f64 = 0.2;
/// Shares of the patches up to this are treated as zero. Unit: share of the patches in view. Half and twice change no
/// outcome.
const MIN_REPEAT_FIT: f64 = 0.3;
/// Parts of a shift at one of which the surfaces must fit worse. Unit: share of the shift. Half and twice change no
/// outcome.
const REPEAT_PARTS: [f64; 3] = [0.35, 0.5, 0.65];
/// Surfaces fit worse part of the way if less than this share of the agreement is left. Half and twice change no
/// outcome.
const REPEAT_VALLEY: f64 = 0.6;
/// A normal lies across another if this much of it is left without the other's direction. Unit: length. Set by hand.
const MIN_ACROSS: f64 = 0.5;

/// The greatest share of patches that agree after a slide, among those that end where the target's
/// sensor saw; 0 if the target looks alike nowhere. `patches` are of the overlap, in the target's
/// frame.
pub(super) fn repeated_share(patches: &[PlanePair], fine: &FineCloud, target: &Surface) -> f64 {
    let axes = axes(patches).into_iter().flatten();
    axes.map(|axis| repeated_across(&axis, patches, fine, target)).fold(0.0, f64::max)
}

/// [`repeated_share`] of slides across an axis, as along a floor.
fn repeated_across(axis: &Vector, patches: &[PlanePair], fine: &FineCloud, target: &Surface) -> f64 {
    let distance = target.grid.distance();
    let facing = Facing::new(axis, patches, distance);
    let u = axis.cross(&Vector::ith(axis.iamin(), 1.0)).normalize();
    let (v, side) = (axis.cross(&u), (MAX_REPEAT / patches::NEAR) as i32);
    let starts = (-side..=side).into_par_iter().flat_map_iter(|i| (-side..=side).map(move |j| [i, j]));
    let starts = starts.map(|[i, j]| patches::NEAR * distance * (f64::from(i) * u + f64::from(j) * v));
    let starts = starts.filter(|start| start.norm() < MAX_REPEAT * distance);
    let mut slides: Vec<Vector> = starts.filter_map(|start| facing.settled(start, distance)).collect();
    let mut cells = HashSet::new();
    slides.retain(|slide| slide.norm() > MIN_REPEAT * distance && cells.insert(cell(slide, REPEAT_SETTLED * distance)));
    let shares = slides.par_iter().filter_map(|slide| {
        let telling = facing.telling(slide);
        let fit = share(&telling, slide, fine, target);
        let is_worse = |part: f64| share(&telling, &(part * slide), fine, target) < REPEAT_VALLEY * fit;
        (fit > MIN_REPEAT_FIT && REPEAT_PARTS.into_iter().any(is_worse)).then_some(fit)
    });
    shares.reduce(|| 0.0, f64::max)
}

fn cell(point: &Vector, side: f64) -> [i64; 3] {
    point.map(|v| (v / side).floor() as i64).into()
}

/// The patches that face across an axis, about evenly spread.
struct Facing<'a> {
    axis: Vector,
    patches: Vec<&'a PlanePair>,
    grid: NearGrid,
}

impl<'a> Facing<'a> {
    fn new(axis: &Vector, patches: &'a [PlanePair], distance: f64) -> Self {
        let faces = |patch: &&PlanePair| patch.normal.cross(axis).norm() > REPEAT_COSINE;
        let mut cells = HashSet::new();
        // Near the sensor there are more.
        let is_new =
            |patch: &&PlanePair| cells.insert((cell(&patch.point, patches::NEAR * distance), patch.normal.iamax()));
        let patches: Vec<&PlanePair> = patches.iter().filter(faces).filter(is_new).collect();
        let points: Vec<Vector> = patches.iter().map(|patch| patch.point).collect();
        Self { axis: *axis, patches, grid: NearGrid::new(&points, distance) }
    }

    /// Some of the patches that tell whether a slide is right.
    fn telling(&self, slide: &Vector) -> Vec<&'a PlanePair> {
        let tells = |patch: &&&PlanePair| patch.normal.dot(slide).abs() > REPEAT_COSINE * slide.norm();
        let all: Vec<&PlanePair> = self.patches.iter().filter(tells).copied().collect();
        all.iter().step_by(all.len().div_ceil(REPEAT_PATCHES).max(1)).copied().collect()
    }

    /// The distance along a patch's normal to the nearest one after a slide, if that is parallel.
    fn offset(&self, patch: &PlanePair, slide: &Vector) -> Option<f64> {
        let place = patch.point + slide;
        let other = self.patches[self.grid.nearest(&place)?.0];
        let is_parallel = other.normal.dot(&patch.normal).abs() > patches::AGREEING_COSINE;
        is_parallel.then(|| patch.normal.dot(&(other.point - place)))
    }

    /// The slide near another with which the patches lie on others; `None` where few are near any.
    fn settled(&self, start: Vector, distance: f64) -> Option<Vector> {
        let telling = self.telling(&start);
        let probes = telling.iter().step_by(REPEAT_PROBE);
        let least = MIN_REPEAT_SHARE * probes.len() as f64;
        if (probes.filter(|patch| self.offset(patch, &start).is_some()).count() as f64) < least {
            return None;
        }
        let mut slide = start;
        for _ in 0..REPEAT_STEPS {
            // What the patches do not fix stays.
            let (mut information, mut residual, mut count) = (Matrix3::<f64>::identity() * 1e-3, Vector::zeros(), 0);
            for patch in &telling {
                let Some(offset) = self.offset(patch, &slide) else { continue };
                let normal = patch.normal - self.axis * patch.normal.dot(&self.axis);
                information += normal * normal.transpose();
                residual += normal * offset;
                count += 1;
            }
            if count < MIN_REPEAT_PATCHES || (count as f64) < MIN_REPEAT_SHARE * telling.len() as f64 {
                return None;
            }
            slide += information.cholesky()?.solve(&residual);
        }
        ((slide - start).norm() < distance).then_some(slide)
    }
}

/// The normal that most patches have, that which most have across it, and the direction across
/// both.
pub(super) fn axes(patches: &[PlanePair]) -> [Option<Vector>; 3] {
    let first = most_frequent(&patches.iter().map(|patch| patch.normal).collect::<Vec<_>>());
    let across = |first: Vector| {
        let across = patches.iter().map(|patch| patch.normal - first * patch.normal.dot(&first));
        let across = across.filter(|normal| normal.norm() > MIN_ACROSS).map(|normal| normal.normalize());
        most_frequent(&across.collect::<Vec<_>>())
    };
    let second = first.and_then(across);
    [first, second, first.zip(second).map(|(first, second)| first.cross(&second))]
}

/// The mean of the unit normals about that which has the most others about it, of either sign: one
/// normal alone is some degrees off.
fn most_frequent(normals: &[Vector]) -> Option<Vector> {
    let is_near = |normal: &Vector, other: &Vector| normal.dot(other).abs() > REPEAT_PARALLEL;
    let count = |normal: &&Vector| normals.iter().filter(|other| is_near(normal, other)).count();
    let tried = normals.iter().step_by(normals.len().div_ceil(REPEAT_NORMALS).max(1));
    let most = tried.max_by_key(count)?;
    let near = normals.iter().filter(|normal| is_near(normal, most));
    Some(near.map(|normal| normal * normal.dot(most).signum()).sum::<Vector>().normalize())
}

/// The share of patches that a slide moves onto the target's patches, among those that end where
/// its sensor saw; 0 if few do.
fn share(telling: &[&PlanePair], slide: &Vector, fine: &FineCloud, target: &Surface) -> f64 {
    let distance = target.grid.distance();
    let agrees = |PlanePair { point, normal, .. }: &PlanePair| {
        // The side from which the sensor saw a patch must be that from which it sees the other.
        let is_same_side = |other: &Vector| match target.viewpoint() {
            Some(viewpoint) => normal.dot(&(viewpoint - point)) * normal.dot(&(viewpoint - other)) > 0.0,
            None => true,
        };
        let on = fine.patch_at(&(point + slide), normal, patches::NEAR * distance, REPEAT_TOLERANCE * distance);
        on.is_some_and(|other| is_same_side(&other))
    };
    let (mut agree, mut contradict) = (0_usize, 0_usize);
    for patch in telling {
        if agrees(patch) {
            agree += 1;
        } else if target.sees(&(patch.point + slide)) {
            contradict += 1;
        }
    }
    let is_seen = agree as f64 >= MIN_REPEAT_SHARE * telling.len() as f64 && agree >= MIN_REPEAT_PATCHES;
    if is_seen { agree as f64 / (agree + contradict) as f64 } else { 0.0 }
}

//! Slides under which the overlap looks alike, as along a row of equal pillars: a source that fits at one place of the row
//! fits at the others as well.

use super::constants::{MIN_SHIFT, REPEAT_PARALLEL, TRIES};
use std::collections::HashSet;

use nalgebra::Matrix3;
use rayon::prelude::*;

use crate::cloud::near_grid::NearGrid;
use crate::cloud::patches;
use crate::cloud::planes::PlanePair;
use snake_geometry::Vector;

/// A patch tells whether a shift is right if the cosine between its normal and the shift is above this: a floor agrees
/// with all shifts along it. Set by hand.
const REPEAT_COSINE: f64 = 0.5;
/// Number of patches that settle a shift, at most. Half and twice change no outcome.
const REPEAT_PATCHES: usize = 40;
/// Number of normals among which the most frequent directions are searched, at most. Half and twice change no outcome.
const REPEAT_NORMALS: usize = 50;
/// Number of patches that a shift needs. Half and twice change no outcome.
const MIN_REPEAT_PATCHES: usize = 7;
/// Shifts that settle closer to each other are one. Unit: inlier distances. Set for time.
const REPEAT_SETTLED: f64 = 0.1;
/// A shift is dropped early if too few of every so many patches are near other patches. Set for time.
const REPEAT_PROBE: usize = 4;
/// Number of least-squares steps by which a shift settles. Set for time.
const REPEAT_STEPS: usize = 2;
/// Length of the longest shift. Unit: inlier distances. Tiers of stadiums have 9.
const MAX_REPEAT: f64 = 10.0;
/// Share of the patches that must agree with a shift; the others may have left the view. Half and twice change no
/// outcome.
const MIN_REPEAT_SHARE: f64 = 0.2;
/// A normal lies across another if this much of it is left without the other's direction. Unit: length. Set by hand.
const MIN_ACROSS: f64 = 0.5;

/// The slides across each axis, as along a floor, after which most patches of the overlap lie on others. `patches` are in
/// the target's frame.
pub(super) fn slides(patches: &[PlanePair], axes: &[Vector; 3], distance: f64) -> Vec<Vector> {
    axes.iter().flat_map(|axis| slides_across(axis, patches, distance)).collect()
}

fn slides_across(axis: &Vector, patches: &[PlanePair], distance: f64) -> Vec<Vector> {
    let facing = Facing::new(axis, patches, distance);
    let u = axis.cross(&Vector::ith(axis.iamin(), 1.0)).normalize();
    let (v, side) = (axis.cross(&u), (MAX_REPEAT / patches::NEAR) as i32);
    let starts = (-side..=side).into_par_iter().flat_map_iter(|i| (-side..=side).map(move |j| [i, j]));
    let starts = starts.map(|[i, j]| patches::NEAR * distance * (f64::from(i) * u + f64::from(j) * v));
    let starts = starts.filter(|start| start.norm() < MAX_REPEAT * distance);
    let mut slides: Vec<(usize, Vector)> = starts.filter_map(|start| facing.settled(start, distance)).collect();
    slides.sort_by_key(|(count, _)| std::cmp::Reverse(*count));
    let mut cells = HashSet::new();
    slides.retain(|(_, slide)| {
        slide.norm() > MIN_SHIFT * distance && cells.insert(cell(slide, REPEAT_SETTLED * distance))
    });
    slides.into_iter().take(TRIES).map(|(_, slide)| slide).collect()
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

    /// The slide near another with which the patches lie on others, and their number; `None` where few are near any.
    fn settled(&self, start: Vector, distance: f64) -> Option<(usize, Vector)> {
        let telling = self.telling(&start);
        let probes = telling.iter().step_by(REPEAT_PROBE);
        let least = MIN_REPEAT_SHARE * probes.len() as f64;
        if (probes.filter(|patch| self.offset(patch, &start).is_some()).count() as f64) < least {
            return None;
        }
        let (mut slide, mut count) = (start, 0);
        for _ in 0..REPEAT_STEPS {
            // What the patches do not fix stays.
            let (mut information, mut residual) = (Matrix3::<f64>::identity() * 1e-3, Vector::zeros());
            count = 0;
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
        ((slide - start).norm() < distance).then_some((count, slide))
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

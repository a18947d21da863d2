//! Slides under which the surface looks alike, as along a row of equal pillars: a source that fits at one place of the row
//! fits at the others as well.

use std::collections::HashSet;

use nalgebra::Matrix3;
use rayon::prelude::*;

use crate::pair::fine::{AGREEING_COSINE, FineCloud};
use crate::pair::icp::PlanePair;
use crate::pair::surface::Surface;
use crate::parts::near_grid::NearGrid;
use snake_geometry::Vector;

/// A patch tells whether a slide is right if the cosine between its normal and the slide is at least this: a floor agrees
/// with all slides along it.
const TELLING_COSINE: f64 = 0.5;
/// Number of patches that are compared, and the least number that tells of a slide.
const PATCHES: usize = 40;
const LEAST_TELLING: usize = 7;
/// In inlier distances: between the starts of slides, between patches of one face, between slides that have settled, and along
/// and across patches that agree.
const STEP: f64 = 0.5;
const THINNED: f64 = 0.5;
const SETTLED: f64 = 0.1;
const NEAR: f64 = 0.5;
const TOLERANCE: f64 = 0.12;
/// If few of one of every so many are near other patches, few of all are.
const PROBED: usize = 4;
/// Number of least-squares steps to settle.
const SETTLING: usize = 2;
/// The shortest and the longest slide, in inlier distances.
const SHORTEST: f64 = 1.0;
const LONGEST: f64 = 10.0;
/// At least this share of the patches must agree with a slide; the others may have left the view.
const LEAST_SHARE: f64 = 0.2;
/// Of those that are seen, a share up to this is none.
const LEAST_FOUND: f64 = 0.3;
/// At one of these parts of the way to a slide that looks alike, less than this share of its agreement is left.
const PARTS: [f64; 3] = [0.35, 0.5, 0.65];
const VALLEY: f64 = 0.6;
/// Patches whose normals have a greater cosine are parallel, to one of so many.
const PARALLEL: f64 = 0.98;
const NORMALS: usize = 50;
/// A normal is across another if so much of it is.
const LEAST_ACROSS: f64 = 0.5;

/// The greatest share of patches that agree under a slide, of those whose place the target's sensor saw; 0 if the target looks
/// alike nowhere. `patches` are of the overlap, in the target's frame.
pub(crate) fn repeated_share(patches: &[PlanePair], fine: &FineCloud, target: &Surface) -> f64 {
    let axes = axes(patches).into_iter().flatten();
    axes.map(|axis| repeated_across(&axis, patches, fine, target)).fold(0.0, f64::max)
}

/// The same for slides across an axis, as along a floor.
fn repeated_across(axis: &Vector, patches: &[PlanePair], fine: &FineCloud, target: &Surface) -> f64 {
    let distance = target.grid.distance();
    let facing = Facing::new(axis, patches, distance);
    let u = axis.cross(&Vector::ith(axis.iamin(), 1.0)).normalize();
    let (v, side) = (axis.cross(&u), (LONGEST / STEP) as i32);
    let starts = (-side..=side).into_par_iter().flat_map_iter(|i| (-side..=side).map(move |j| [i, j]));
    let starts = starts.map(|[i, j]| STEP * distance * (f64::from(i) * u + f64::from(j) * v));
    let starts = starts.filter(|start| start.norm() < LONGEST * distance);
    let mut slides: Vec<Vector> = starts.filter_map(|start| facing.settled(start, distance)).collect();
    let mut cells = HashSet::new();
    slides.retain(|slide| slide.norm() > SHORTEST * distance && cells.insert(cell(slide, SETTLED * distance)));
    let shares = slides.par_iter().filter_map(|slide| {
        let telling = facing.telling(slide);
        let found = share(&telling, slide, fine, target);
        let is_worse = |part: f64| share(&telling, &(part * slide), fine, target) < VALLEY * found;
        (found > LEAST_FOUND && PARTS.into_iter().any(is_worse)).then_some(found)
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
        let faces = |patch: &&PlanePair| patch.normal.cross(axis).norm() > TELLING_COSINE;
        let mut cells = HashSet::new();
        // Near the sensor there are more.
        let is_new = |patch: &&PlanePair| cells.insert((cell(&patch.point, THINNED * distance), patch.normal.iamax()));
        let patches: Vec<&PlanePair> = patches.iter().filter(faces).filter(is_new).collect();
        let points: Vec<Vector> = patches.iter().map(|patch| patch.point).collect();
        Self { axis: *axis, patches, grid: NearGrid::new(&points, distance) }
    }

    /// Some of the patches that tell whether a slide is right.
    fn telling(&self, slide: &Vector) -> Vec<&'a PlanePair> {
        let tells = |patch: &&&PlanePair| patch.normal.dot(slide).abs() > TELLING_COSINE * slide.norm();
        let all: Vec<&PlanePair> = self.patches.iter().filter(tells).copied().collect();
        all.iter().step_by(all.len().div_ceil(PATCHES).max(1)).copied().collect()
    }

    /// The distance along a patch's normal to the nearest one after a slide, if that is parallel.
    fn offset(&self, patch: &PlanePair, slide: &Vector) -> Option<f64> {
        let place = patch.point + slide;
        let other = self.patches[self.grid.nearest(&place)?.0];
        let is_parallel = other.normal.dot(&patch.normal).abs() > AGREEING_COSINE;
        is_parallel.then(|| patch.normal.dot(&(other.point - place)))
    }

    /// The slide near another with which the patches lie on others; `None` where few are near any.
    fn settled(&self, start: Vector, distance: f64) -> Option<Vector> {
        let telling = self.telling(&start);
        let probes = telling.iter().step_by(PROBED);
        let least = LEAST_SHARE * probes.len() as f64;
        if (probes.filter(|patch| self.offset(patch, &start).is_some()).count() as f64) < least {
            return None;
        }
        let mut slide = start;
        for _ in 0..SETTLING {
            // What the patches do not fix stays.
            let (mut information, mut residual, mut count) = (Matrix3::<f64>::identity() * 1e-3, Vector::zeros(), 0);
            for patch in &telling {
                let Some(offset) = self.offset(patch, &slide) else { continue };
                let normal = patch.normal - self.axis * patch.normal.dot(&self.axis);
                information += normal * normal.transpose();
                residual += normal * offset;
                count += 1;
            }
            if count < LEAST_TELLING || (count as f64) < LEAST_SHARE * telling.len() as f64 {
                return None;
            }
            slide += information.cholesky()?.solve(&residual);
        }
        ((slide - start).norm() < distance).then_some(slide)
    }
}

/// The normal that most patches have, that which most have across it, and the direction across both.
fn axes(patches: &[PlanePair]) -> [Option<Vector>; 3] {
    let count = |normal: &Vector| patches.iter().filter(|patch| patch.normal.dot(normal).abs() > PARALLEL).count();
    let normals = patches.iter().step_by(patches.len().div_ceil(NORMALS).max(1)).map(|patch| patch.normal);
    let first = normals.clone().max_by_key(count);
    let across = |first: Vector| {
        normals
            .map(move |normal| normal - first * normal.dot(&first))
            .filter(|n| n.norm() > LEAST_ACROSS)
            .map(|n| n.normalize())
            .max_by_key(count)
    };
    let second = first.and_then(across);
    [first, second, first.zip(second).map(|(first, second)| first.cross(&second))]
}

/// Of the patches, moved by a slide, whose place the target's sensor saw, the share on the target's patches; 0 if few are.
fn share(telling: &[&PlanePair], slide: &Vector, fine: &FineCloud, target: &Surface) -> f64 {
    let distance = target.grid.distance();
    let agrees = |PlanePair { point, normal, .. }: &PlanePair| {
        // The side from which the sensor saw a patch must be that from which it sees the other.
        let is_same_side = |other: &Vector| match target.viewpoint() {
            Some(viewpoint) => normal.dot(&(viewpoint - point)) * normal.dot(&(viewpoint - other)) > 0.0,
            None => true,
        };
        let on = fine.patch_at(&(point + slide), normal, NEAR * distance, TOLERANCE * distance);
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
    let is_seen = agree as f64 >= LEAST_SHARE * telling.len() as f64 && agree >= LEAST_TELLING;
    if is_seen { agree as f64 / (agree + contradict) as f64 } else { 0.0 }
}

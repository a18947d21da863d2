//! Slides under which the target looks alike, as along a row of equal pillars: a source that fits
//! at one place of the row fits at the others as well.

use std::collections::HashSet;

use nalgebra::Matrix3;
use rayon::prelude::*;

use super::tuning::TUNING;
use crate::cloud::near_grid::NearGrid;
use crate::cloud::patches::{self, FineCloud};
use crate::cloud::planes::PlanePair;
use crate::cloud::surface::Surface;
use snake_geometry::Vector;

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
    let (v, side) = (axis.cross(&u), (TUNING.max_repeat / patches::TUNING.near) as i32);
    let starts = (-side..=side).into_par_iter().flat_map_iter(|i| (-side..=side).map(move |j| [i, j]));
    let starts = starts.map(|[i, j]| patches::TUNING.near * distance * (f64::from(i) * u + f64::from(j) * v));
    let starts = starts.filter(|start| start.norm() < TUNING.max_repeat * distance);
    let mut slides: Vec<Vector> = starts.filter_map(|start| facing.settled(start, distance)).collect();
    let mut cells = HashSet::new();
    slides.retain(|slide| {
        slide.norm() > TUNING.min_repeat * distance && cells.insert(cell(slide, TUNING.repeat_settled * distance))
    });
    let shares = slides.par_iter().filter_map(|slide| {
        let telling = facing.telling(slide);
        let fit = share(&telling, slide, fine, target);
        let is_worse = |part: f64| share(&telling, &(part * slide), fine, target) < TUNING.repeat_valley * fit;
        (fit > TUNING.min_repeat_fit && TUNING.repeat_parts.into_iter().any(is_worse)).then_some(fit)
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
        let faces = |patch: &&PlanePair| patch.normal.cross(axis).norm() > TUNING.repeat_cosine;
        let mut cells = HashSet::new();
        // Near the sensor there are more.
        let is_new = |patch: &&PlanePair| {
            cells.insert((cell(&patch.point, patches::TUNING.near * distance), patch.normal.iamax()))
        };
        let patches: Vec<&PlanePair> = patches.iter().filter(faces).filter(is_new).collect();
        let points: Vec<Vector> = patches.iter().map(|patch| patch.point).collect();
        Self { axis: *axis, patches, grid: NearGrid::new(&points, distance) }
    }

    /// Some of the patches that tell whether a slide is right.
    fn telling(&self, slide: &Vector) -> Vec<&'a PlanePair> {
        let tells = |patch: &&&PlanePair| patch.normal.dot(slide).abs() > TUNING.repeat_cosine * slide.norm();
        let all: Vec<&PlanePair> = self.patches.iter().filter(tells).copied().collect();
        all.iter().step_by(all.len().div_ceil(TUNING.repeat_patches).max(1)).copied().collect()
    }

    /// The distance along a patch's normal to the nearest one after a slide, if that is parallel.
    fn offset(&self, patch: &PlanePair, slide: &Vector) -> Option<f64> {
        let place = patch.point + slide;
        let other = self.patches[self.grid.nearest(&place)?.0];
        let is_parallel = other.normal.dot(&patch.normal).abs() > patches::TUNING.agreeing_cosine;
        is_parallel.then(|| patch.normal.dot(&(other.point - place)))
    }

    /// The slide near another with which the patches lie on others; `None` where few are near any.
    fn settled(&self, start: Vector, distance: f64) -> Option<Vector> {
        let telling = self.telling(&start);
        let probes = telling.iter().step_by(TUNING.repeat_probe);
        let least = TUNING.min_repeat_share * probes.len() as f64;
        if (probes.filter(|patch| self.offset(patch, &start).is_some()).count() as f64) < least {
            return None;
        }
        let mut slide = start;
        for _ in 0..TUNING.repeat_steps {
            // What the patches do not fix stays.
            let (mut information, mut residual, mut count) = (Matrix3::<f64>::identity() * 1e-3, Vector::zeros(), 0);
            for patch in &telling {
                let Some(offset) = self.offset(patch, &slide) else { continue };
                let normal = patch.normal - self.axis * patch.normal.dot(&self.axis);
                information += normal * normal.transpose();
                residual += normal * offset;
                count += 1;
            }
            if count < TUNING.min_repeat_patches || (count as f64) < TUNING.min_repeat_share * telling.len() as f64 {
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
        let across = across.filter(|normal| normal.norm() > TUNING.min_across).map(|normal| normal.normalize());
        most_frequent(&across.collect::<Vec<_>>())
    };
    let second = first.and_then(across);
    [first, second, first.zip(second).map(|(first, second)| first.cross(&second))]
}

/// The mean of the unit normals about that which has the most others about it, of either sign: one
/// normal alone is some degrees off.
fn most_frequent(normals: &[Vector]) -> Option<Vector> {
    let is_near = |normal: &Vector, other: &Vector| normal.dot(other).abs() > TUNING.repeat_parallel;
    let count = |normal: &&Vector| normals.iter().filter(|other| is_near(normal, other)).count();
    let tried = normals.iter().step_by(normals.len().div_ceil(TUNING.repeat_normals).max(1));
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
        let on = fine.patch_at(
            &(point + slide),
            normal,
            patches::TUNING.near * distance,
            TUNING.repeat_tolerance * distance,
        );
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
    let is_seen = agree as f64 >= TUNING.min_repeat_share * telling.len() as f64 && agree >= TUNING.min_repeat_patches;
    if is_seen { agree as f64 / (agree + contradict) as f64 } else { 0.0 }
}

//! Slides under which the target is self-similar, as along a row of equal pillars: a source that
//! fits at one place of the row fits at the others as well.

use std::collections::HashSet;

use nalgebra::Matrix3;

use super::constants::{MIN_SHIFT, REPEAT_PARALLEL};
use crate::cloud::near_grid::NearGrid;
use crate::cloud::patches;
use crate::cloud::planes::PlanePair;
use snake_geometry::{Vector, some_in_parallel};

/// A patch can test a slide if the cosine between its normal and the slide is above this. A floor
/// agrees with all slides along it. Set by hand.
const TELLING_COSINE: f64 = 0.5;
/// Number of patches that are compared for a slide, at most. Half and twice change no outcome.
const PATCHES: usize = 40;
/// Number of normals among which the most frequent directions are searched, at most. Half and twice change no outcome.
const NORMALS: usize = 50;
/// Number of patches that a slide needs. Half and twice change no outcome.
const MIN_PATCHES: u32 = 7;
/// Share of the patches that must agree with a slide; the others may have left the view. Half and twice change no
/// outcome.
const MIN_SHARE: f64 = 0.2;
/// Step between the patches that test a slide first: it is dropped early if too few are near others. Set for time.
const PROBE: usize = 4;
/// Number of least-squares steps that refine a slide. Set for time.
const STEPS: usize = 2;
/// Length of the longest slide. Unit: inlier distances. Set for time.
const MAX_SLIDE: f64 = 10.0;
/// Number of slides across an axis, at most. Set for time.
const SLIDES: usize = 4;
/// Slides that differ by at most this count as one. Unit: inlier distances. The same as for candidates.
const MIN_DIFFERENCE: f64 = 2.0;
/// A normal lies across another if its perpendicular component is longer than this. Unit: length. Set by hand.
const MIN_ACROSS: f64 = 0.5;

/// The slides perpendicular to each axis with which most `patches` of the overlap lie on others, in the target's frame.
pub(super) fn slides(patches: &[PlanePair], axes: &[Vector; 3], distance: f64) -> Vec<Vector> {
    axes.iter().flat_map(|axis| Facing::new(axis, patches, distance).slides()).collect()
}

/// The patches whose normals are far from an axis, such as walls for the axis of a floor, about evenly spread.
struct Facing<'a> {
    axis: Vector,
    patches: Vec<&'a PlanePair>,
    grid: NearGrid,
}

impl<'a> Facing<'a> {
    fn new(axis: &Vector, patches: &'a [PlanePair], distance: f64) -> Self {
        let faces = |patch: &&PlanePair| patch.normal.cross(axis).norm() > TELLING_COSINE;
        let mut cells = HashSet::new();
        // Patches are denser near the sensor: each cell keeps one for each axis they face.
        let cell = |point: &Vector| point.map(|v| (v / (patches::NEAR * distance)).floor() as i64);
        let is_new = |patch: &&PlanePair| cells.insert((cell(&patch.point), patch.normal.iamax()));
        let patches: Vec<&PlanePair> = patches.iter().filter(faces).filter(is_new).collect();
        let points: Vec<Vector> = patches.iter().map(|patch| patch.point).collect();
        Self { axis: *axis, patches, grid: NearGrid::new(&points, distance) }
    }

    /// The distinct slides with which most of the patches lie on others.
    fn slides(&self) -> Vec<Vector> {
        let distance = self.grid.distance();
        let u = self.axis.cross(&Vector::ith(self.axis.iamin(), 1.0)).normalize();
        let (v, side) = (self.axis.cross(&u), (MAX_SLIDE / patches::NEAR) as i32);
        let starts = (-side..=side).flat_map(|i| (-side..=side).map(move |j| [i, j]));
        let starts = starts.map(|[i, j]| patches::NEAR * distance * (f64::from(i) * u + f64::from(j) * v));
        let starts: Vec<Vector> = starts.filter(|start| start.norm() < MAX_SLIDE * distance).collect();
        let mut settled = some_in_parallel(starts.iter(), |start| self.settled(*start));
        settled.retain(|(_, slide)| slide.norm() > MIN_SHIFT * distance);
        settled.sort_by(|(a, _), (b, _)| b.total_cmp(a));
        let mut best: Vec<Vector> = Vec::new();
        for (_, slide) in settled {
            let differs = |other: &Vector| (other - slide).norm() > MIN_DIFFERENCE * distance;
            if best.len() < SLIDES && best.iter().all(differs) {
                best.push(slide);
            }
        }
        best
    }

    /// A sample of the patches that can test a slide.
    fn telling(&self, slide: &Vector) -> Vec<&'a PlanePair> {
        let tells = |patch: &&&PlanePair| patch.normal.dot(slide).abs() > TELLING_COSINE * slide.norm();
        let all: Vec<&PlanePair> = self.patches.iter().filter(tells).copied().collect();
        all.iter().step_by(all.len().div_ceil(PATCHES).max(1)).copied().collect()
    }

    /// The distance along a patch's normal to the nearest patch after a slide; `None` without a parallel patch nearby.
    fn offset(&self, patch: &PlanePair, slide: &Vector) -> Option<f64> {
        let place = patch.point + slide;
        let other = self.patches[self.grid.nearest(&place)?.0];
        let is_parallel = other.normal.dot(&patch.normal).abs() > patches::AGREEING_COSINE;
        is_parallel.then(|| patch.normal.dot(&(other.point - place)))
    }

    /// Refines a slide so that the patches lie on others. Returns the share of the patches that do,
    /// and the slide; `None` if few patches are near others, or if the slide moves too far.
    fn settled(&self, start: Vector) -> Option<(f64, Vector)> {
        let telling = self.telling(&start);
        let probes = telling.iter().step_by(PROBE);
        let least = MIN_SHARE * probes.len() as f64;
        if (probes.filter(|patch| self.offset(patch, &start).is_some()).count() as f64) < least {
            return None;
        }
        let (mut share, mut slide) = (0.0, start);
        for _ in 0..STEPS {
            // The regularization keeps components that the patches do not fix.
            let (mut information, mut residual, mut count) =
                (Matrix3::<f64>::identity() * 1e-3, Vector::zeros(), 0_u32);
            for patch in &telling {
                let Some(offset) = self.offset(patch, &slide) else { continue };
                let normal = patch.normal - self.axis * patch.normal.dot(&self.axis);
                information += normal * normal.transpose();
                residual += normal * offset;
                count += 1;
            }
            share = f64::from(count) / telling.len() as f64;
            if count < MIN_PATCHES || share < MIN_SHARE {
                return None;
            }
            slide += information.cholesky()?.solve(&residual);
        }
        ((slide - start).norm() < self.grid.distance()).then_some((share, slide))
    }
}

/// The most frequent normal of the patches, the most frequent direction perpendicular to it, and
/// the direction perpendicular to both.
pub(super) fn axes(patches: &[PlanePair]) -> Option<[Vector; 3]> {
    let first = most_frequent(&patches.iter().map(|patch| patch.normal).collect::<Vec<_>>())?;
    let across = patches.iter().map(|patch| patch.normal - first * patch.normal.dot(&first));
    let across = across.filter(|normal| normal.norm() > MIN_ACROSS).map(|normal| normal.normalize());
    let second = most_frequent(&across.collect::<Vec<_>>())?;
    Some([first, second, first.cross(&second)])
}

/// The mean of the unit normals, of either sign, near the normal with the most others near it: a
/// single normal is some degrees off.
fn most_frequent(normals: &[Vector]) -> Option<Vector> {
    let is_near = |normal: &Vector, other: &Vector| normal.dot(other).abs() > REPEAT_PARALLEL;
    let count = |normal: &&Vector| normals.iter().filter(|other| is_near(normal, other)).count();
    let tried = normals.iter().step_by(normals.len().div_ceil(NORMALS).max(1));
    let most = tried.max_by_key(count)?;
    let near = normals.iter().filter(|normal| is_near(normal, most));
    Some(near.map(|normal| normal * normal.dot(most).signum()).sum::<Vector>().normalize())
}

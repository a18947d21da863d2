//! Slides under which the surface looks alike, as along a row of equal pillars: a source that fits at one place of the row
//! fits at the others as well.

use nalgebra::Matrix3;
use rayon::prelude::*;

use super::fine::FineCloud;
use super::icp::PlanePair;
use super::surface::Surface;
use snake_core::space::Vector;

/// A patch tells whether a slide is right if the cosine between its normal and the slide is at least this: a floor agrees
/// with all slides along it.
const TELLING_COSINE: f64 = 0.5;
/// Number of patches that are compared.
const PATCHES: usize = 40;
/// If not one of every so many agrees, few of all do.
const PROBED: usize = 4;
/// The tolerance across a patch, and the difference between slides, in inlier distances.
const TOLERANCE: f64 = 0.12;
const STEP: f64 = 0.2;
/// The longest slide, in inlier distances.
const LONGEST: f64 = 20.0;
/// At least this share of the patches must agree with a slide; the others may have left the view.
const LEAST_SHARE: f64 = 0.2;
/// Before a slide that looks alike, one with less than this share of its agreement has been passed.
const VALLEY: f64 = 0.6;
/// Directions with a greater cosine are one: within 4 degrees, a slide by a few pillars ends at a pillar.
const SAME_DIRECTION: f64 = 0.998;

/// The greatest share of patches that agree under a slide, of those whose place the target's sensor saw; 0 if the target looks
/// alike nowhere. `patches` are of the overlap, in the target's frame.
pub(super) fn repeated_share(patches: &[PlanePair], fine: &FineCloud, target: &Surface) -> f64 {
    let directions = directions(patches);
    let along = |direction: &Vector| {
        let telling: Vec<&PlanePair> =
            patches.iter().filter(|patch| patch.normal.dot(direction).abs() > TELLING_COSINE).collect();
        let telling: Vec<&PlanePair> =
            telling.iter().step_by(telling.len().div_ceil(PATCHES).max(1)).copied().collect();
        let shares = [1.0, -1.0].map(|sign| along(&telling, &(sign * direction), fine, target));
        shares[0].max(shares[1])
    };
    let shares: Vec<f64> = directions.par_iter().map(along).collect();
    shares.into_iter().fold(0.0, f64::max)
}

/// The greatest share for slides in one direction, behind a valley.
fn along(telling: &[&PlanePair], direction: &Vector, fine: &FineCloud, target: &Surface) -> f64 {
    let distance = target.grid.distance();
    let step = STEP * distance;
    let shares = (1..=(LONGEST / STEP) as usize).map(|i| share(telling, &(i as f64 * step * direction), fine, target));
    let (mut lowest, mut best) = (1.0_f64, 0.0_f64);
    for share in shares {
        if lowest < VALLEY * share {
            best = best.max(share);
        }
        lowest = lowest.min(share);
    }
    best
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
        let on = fine.patch_at(&(point + slide), normal, 0.5 * distance, TOLERANCE * distance);
        on.is_some_and(|other| is_same_side(&other))
    };
    if !telling.iter().step_by(PROBED).any(|patch| agrees(patch)) {
        return 0.0;
    }
    let (mut agree, mut contradict) = (0, 0);
    for patch in telling {
        if agrees(patch) {
            agree += 1;
        } else if target.sees(&(patch.point + slide)) {
            contradict += 1;
        }
    }
    let is_seen = f64::from(agree) >= LEAST_SHARE * telling.len() as f64 && agree > 2;
    if is_seen { f64::from(agree) / f64::from(agree + contradict) } else { 0.0 }
}

/// Directions in which a surface may repeat itself: those in which the patches constrain a slide, and those in which the
/// patches are spread that constrain it, the least constrained first.
fn directions(patches: &[PlanePair]) -> Vec<Vector> {
    let information: Matrix3<f64> = patches.iter().map(|patch| patch.normal * patch.normal.transpose()).sum();
    let eigen = information.symmetric_eigen();
    let mut order = [0, 1, 2];
    order.sort_by(|&a, &b| eigen.eigenvalues[a].total_cmp(&eigen.eigenvalues[b]));
    let mut found: Vec<Vector> = Vec::new();
    for axis in order.map(|index| Vector::from(eigen.eigenvectors.column(index))) {
        let points: Vec<Vector> = patches
            .iter()
            .filter(|patch| patch.normal.dot(&axis).abs() > TELLING_COSINE)
            .map(|patch| patch.point)
            .collect();
        let mean = points.iter().sum::<Vector>() / points.len().max(1) as f64;
        let scatter: Matrix3<f64> = points.iter().map(|point| (point - mean) * (point - mean).transpose()).sum();
        let spread = scatter.symmetric_eigen();
        let widest = Vector::from(spread.eigenvectors.column(spread.eigenvalues.imax()));
        for direction in [axis, widest] {
            if found.iter().all(|other| other.dot(&direction).abs() < SAME_DIRECTION) {
                found.push(direction);
            }
        }
    }
    found
}

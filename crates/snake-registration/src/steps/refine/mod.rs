//! Step 5: ICP refines transforms, and the clouds rank them.

pub(crate) mod icp;
pub(crate) mod patches;

use nalgebra::IsometryMatrix3;
use rayon::prelude::*;

use crate::cloud::surface::{Agreement, Surface, coarse_step};
use crate::rigid::displacement;
use crate::steps::matches::{Criteria, Match, inliers};
use crate::steps::pair::Pair;
use crate::tuning::tuning;
use icp::{one_way_icp, symmetric_icp};
use patches::refine_on_patches;
use snake_core::{Control, Result};
use snake_geometry::{RigidTransform, Vector};

tuning! {
    /// Number of ICP steps before transforms are compared.
    coarse_steps: usize = 5, unit "steps", from "set by hand in 3738705";
    /// Number of transforms that are refined on all voxels, at least.
    min_refined: usize = 3, unit "transforms", from "set by hand in 3738705";
    /// A guess is first refined with pairs up to this far apart.
    wide: f64 = 4.0, unit "inlier distances", from "set by hand in 3738705";
    /// Two candidates are one if the clouds are not moved farther apart than this (root mean
    /// square).
    min_difference: f64 = 2.0, unit "inlier distances", from "set by hand in 3738705";
    /// ICP ends when the translation is below this share of the distance between pairs, and the
    /// rotation below this angle.
    tolerance: f64 = 1e-5, unit "share of the distance, and radians", from "set by hand in 5d56655";
    /// Distance between pairs of planar patches and number of steps, round by round.
    patch_rounds: [(f64, usize); 2] = [(4.0, 4), (2.0, 8)], unit "fine voxels, steps",
        from "set for time in 8e0d76d (0.08 instead of 0.11 s of CPU for a pair of made streets)";
    /// Pairs of patches farther apart than this are left out.
    max_medians: f64 = 4.0, unit "medians of all pairs", from "set by hand in b0e7886";
    /// With fewer pairs of patches the rough transform stays.
    min_patch_pairs: usize = 100, unit "pairs", from "set by hand in b0e7886";
}

/// A transform with the figures that rank it.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Candidate {
    /// Maps source points to the target frame.
    pub t_target_source: RigidTransform,
    /// Number of matches that agreed with the transform before ICP.
    pub num_inliers: usize,
    /// Root mean square distance of these matches before ICP, in cloud units; 0 without any.
    pub rmse: f64,
    pub(crate) agreement: Agreement,
}

impl Candidate {
    /// A transform of any origin, measured on the clouds and the matches as it is.
    pub fn measure(pair: &Pair, matches: &[Match], t_target_source: &RigidTransform) -> Self {
        let [source, target] = pair.surfaces();
        let transform = t_target_source.isometry();
        let (num_inliers, rmse) = inliers(matches, transform, pair.criteria());
        let agreement = Surface::agreement(source, target, transform, 1);
        Self { t_target_source: *t_target_source, num_inliers, rmse, agreement }
    }

    /// Share of the source's voxels on the target with agreeing normals, 0 to 1.
    pub fn overlap(&self) -> f64 {
        self.agreement.overlap
    }

    /// Share of the voxels of both clouds, 0 to 1, that lie where the other cloud's sensor saw
    /// through; 0 if the sensors are not known.
    pub fn free_space_violation(&self) -> f64 {
        self.agreement.violation
    }

    /// The score that ranks candidates: the overlap, less twice the violated free space, plus 0.005
    /// for each inlier.
    pub fn score(&self) -> f64 {
        self.agreement.score(self.num_inliers)
    }
}

/// The best of the transforms, refined by ICP, best first and distinct: at least `count` of them,
/// where there are so many.
///
/// All are compared after a few ICP steps on some of the voxels. The best are refined by symmetric
/// ICP on all voxels, and the very best on planar patches, if the clouds are much finer than their
/// voxels. Without `icp_steps` transforms stay as they are.
///
/// # Errors
/// [`Error::Cancelled`](snake_core::Error::Cancelled) and
/// [`Error::DeadlineExceeded`](snake_core::Error::DeadlineExceeded).
pub fn refine(
    pair: &Pair,
    matches: &[Match],
    guesses: &[RigidTransform],
    icp_steps: usize,
    count: usize,
    control: &Control,
) -> Result<Vec<Candidate>> {
    let surfaces = pair.surfaces();
    let [source, target] = surfaces;
    let criteria = pair.criteria();
    let counter = control.begin("ICP", guesses.len());
    let step = coarse_step(source.points.len());
    let coarse: Vec<Vector> = source.points.iter().step_by(step).copied().collect();
    let candidates = guesses.par_iter().map(|guess| {
        counter.add(1);
        let rough = guess.isometry();
        let steps = TUNING.coarse_steps.min(icp_steps);
        let refined = level(criteria, |gravity| one_way_icp(&coarse, target, *rough, gravity, steps, &counter))?;
        let agreement = Surface::agreement(source, target, &refined, step);
        let (num_inliers, rmse) = inliers(matches, rough, criteria);
        Ok(Candidate { t_target_source: refined.into(), num_inliers, rmse, agreement })
    });
    // Otherwise the best few may all be one transform, and a rival is not seen.
    let mut candidates = distinct(candidates.collect::<Result<_>>()?, &coarse, criteria.inlier_distance);
    candidates.truncate(TUNING.min_refined.max(count));
    for candidate in &mut candidates {
        let rough = *candidate.t_target_source.isometry();
        let refined = level(criteria, |gravity| symmetric_icp(surfaces, rough, gravity, icp_steps, &counter))?;
        candidate.t_target_source = refined.into();
        candidate.agreement = Surface::agreement(source, target, &refined, 1);
    }
    let mut candidates = distinct(candidates, &coarse, criteria.inlier_distance);
    if let Some(best) = candidates.first_mut()
        && icp_steps > 0
    {
        let rough = *best.t_target_source.isometry();
        let fine = pair.fine()?;
        let refined = level(criteria, |gravity| refine_on_patches(fine, rough, gravity, &counter))?;
        if displacement(&refined, &rough, &coarse) < criteria.inlier_distance {
            best.t_target_source = refined.into();
        }
    }
    Ok(candidates)
}

/// A guess after ICP with distant pairs, for [`refine`].
///
/// # Errors
/// [`Error::Cancelled`](snake_core::Error::Cancelled) and
/// [`Error::DeadlineExceeded`](snake_core::Error::DeadlineExceeded).
pub fn approach(pair: &Pair, guess: &RigidTransform, icp_steps: usize, control: &Control) -> Result<RigidTransform> {
    let mut transform = *guess.isometry();
    for factor in [TUNING.wide, TUNING.wide.sqrt()] {
        let [source, target] = pair.surfaces_within(factor * pair.criteria().inlier_distance);
        let counter = control.begin("ICP", 0);
        transform = level(pair.criteria(), |gravity| {
            one_way_icp(source.points, &target, transform, gravity, icp_steps, &counter)
        })?;
    }
    Ok(transform.into())
}

/// A transform after at most `icp_steps` steps of symmetric point-to-plane ICP on the voxels of
/// both clouds, with pairs closer than the inlier distance whose normals agree. Directions that the
/// pairs do not constrain stay.
///
/// # Errors
/// [`Error::Cancelled`](snake_core::Error::Cancelled) and
/// [`Error::DeadlineExceeded`](snake_core::Error::DeadlineExceeded).
pub fn icp(pair: &Pair, guess: &RigidTransform, icp_steps: usize, control: &Control) -> Result<RigidTransform> {
    let counter = control.begin("ICP", 0);
    let run = |gravity| symmetric_icp(pair.surfaces(), *guess.isometry(), gravity, icp_steps, &counter);
    Ok(level(pair.criteria(), run)?.into())
}

/// The transform after ICP with any rotation or, where that tilts a known axis too far, with one
/// about the axis.
fn level(
    criteria: &Criteria,
    icp: impl Fn(Option<Vector>) -> Result<IsometryMatrix3<f64>>,
) -> Result<IsometryMatrix3<f64>> {
    let free = icp(None)?;
    if criteria.is_level(&free.rotation) { Ok(free) } else { icp(criteria.gravity) }
}

/// The candidates best first, without those that move the points to about the same places as a
/// better one.
fn distinct(mut candidates: Vec<Candidate>, points: &[Vector], inlier_distance: f64) -> Vec<Candidate> {
    // The order decides between equals.
    candidates.sort_by(|a, b| b.score().total_cmp(&a.score()));
    let mut distinct: Vec<Candidate> = Vec::new();
    for candidate in candidates {
        let transform = candidate.t_target_source.isometry();
        let differs = |other: &Candidate| {
            displacement(transform, other.t_target_source.isometry(), points) > TUNING.min_difference * inlier_distance
        };
        if distinct.iter().all(differs) {
            distinct.push(candidate);
        }
    }
    distinct
}

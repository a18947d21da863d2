//! Step 5: ICP refines the transforms, and their fit to the clouds ranks them.

pub(crate) mod icp;
pub(crate) mod patches;

use nalgebra::IsometryMatrix3;

use crate::cloud::surface::{Agreement, Surface, coarse_step};
use crate::rigid::displacement;
use crate::steps::matches::{Criteria, Match, inliers};
use crate::steps::pair::Pair;
use crate::steps::single_matches::Voters;
use icp::{one_way_icp, symmetric_icp};
use patches::refine_on_patches;
use snake_core::{Control, Result};
use snake_geometry::{RigidTransform, Vector, try_in_parallel};

/// Number of ICP steps before transforms are compared. Half and twice change no outcome.
const COARSE_STEPS: usize = 5;
/// Number of transforms that are refined on all voxels, at least. Half and twice change no outcome.
const MIN_REFINED: usize = 3;
/// A guess is first refined with pairs up to this far apart. Unit: inlier distances. Half and twice change no outcome.
const WIDE: f64 = 4.0;
/// Two candidates count as one if they put the source's points at most this far apart (root mean
/// square). Unit: inlier distances. Set by hand.
pub(crate) const MIN_DIFFERENCE: f64 = 2.0;
/// Weight of a single match that supports a transform, relative to the overlap. Unit: overlap per
/// transform. Chosen on pairs of hotel_uc and redkitchen that overlap by 0.1 to 0.3.
const SUPPORT_WEIGHT: f64 = 0.002;
/// Weight of the violated free space of a finer image, where single matches are compared. Unit: overlap per share of
/// violated free space. Chosen on pairs of hotel_uc and redkitchen that overlap by 0.1 to 0.3.
const FINE_VIOLATION_WEIGHT: f64 = 6.0;

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
    /// The part of the score from single matches and the fine free space, if they were compared.
    support: Option<f64>,
}

impl Candidate {
    /// Measures a transform from any source on the clouds and the matches, without refining it.
    pub fn measure(pair: &Pair, matches: &[Match], t_target_source: &RigidTransform) -> Self {
        let [source, target] = pair.surfaces();
        let transform = t_target_source.isometry();
        let (num_inliers, rmse) = inliers(matches, transform, pair.criteria());
        let agreement = Surface::agreement(source, target, transform, 1);
        Self::new(*t_target_source, num_inliers, rmse, agreement)
    }

    pub(crate) fn new(t_target_source: RigidTransform, num_inliers: usize, rmse: f64, agreement: Agreement) -> Self {
        Self { t_target_source, num_inliers, rmse, agreement, support: None }
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
    /// for each inlier. Where single matches were compared, each that supports the transform adds
    /// 0.002, and violations of a finer image of the free space are subtracted six times.
    pub fn score(&self) -> f64 {
        self.agreement.score(self.num_inliers) + self.support.unwrap_or_default()
    }

    /// The lead of the score over that of the next candidate, if single matches were compared.
    /// Without a next candidate, it is the whole score.
    pub(crate) fn lead(&self, next: Option<&Self>) -> Option<f64> {
        self.support.map(|_| self.score() - next.map_or(0.0, Self::score))
    }
}

/// Refines transforms by ICP and returns the best distinct ones, best first: at most `count` or 3
/// of them, whichever is more.
///
/// All transforms are compared after a few ICP steps on some of the voxels. Symmetric ICP then
/// refines the best of them on all voxels. The very best is refined on planar patches if both
/// clouds are much finer than their voxels. If `icp_steps` is 0, the transforms stay as they are.
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
    let measure = |guess: &IsometryMatrix3<f64>, refined: &IsometryMatrix3<f64>, step| {
        let [source, target] = pair.surfaces();
        let agreement = Surface::agreement(source, target, refined, step);
        let (num_inliers, rmse) = inliers(matches, guess, pair.criteria());
        Candidate::new((*refined).into(), num_inliers, rmse, agreement)
    };
    refine_by(measure, pair, guesses, icp_steps, count, control)
}

/// [`refine`] for transforms of single matches beside others. The support of the single matches and
/// a finer image of the free space also enter the score.
pub(crate) fn refine_supported(
    pair: &Pair,
    matches: &[Match],
    voters: &Voters,
    guesses: &[RigidTransform],
    icp_steps: usize,
    count: usize,
    control: &Control,
) -> Result<Vec<Candidate>> {
    let surfaces = pair.surfaces();
    let images = surfaces.each_ref().map(Surface::fine_image);
    let measure = |_: &IsometryMatrix3<f64>, refined: &IsometryMatrix3<f64>, step| {
        let agreement = Surface::agreement(&surfaces[0], &surfaces[1], refined, step);
        // The angle of a single match is rough, so the matches are counted under the refined transform.
        let (num_inliers, rmse) = inliers(matches, refined, pair.criteria());
        let violation = Surface::violation(surfaces, &images, refined, step);
        let support = SUPPORT_WEIGHT * voters.support(refined) as f64 - FINE_VIOLATION_WEIGHT * violation;
        Candidate { support: Some(support), ..Candidate::new((*refined).into(), num_inliers, rmse, agreement) }
    };
    refine_by(measure, pair, guesses, icp_steps, count, control)
}

/// The best of the transforms after ICP. `measure` takes a guess, its refined transform and the
/// step between the voxels that are used.
fn refine_by(
    measure: impl Fn(&IsometryMatrix3<f64>, &IsometryMatrix3<f64>, usize) -> Candidate + Sync,
    pair: &Pair,
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
    let candidates = try_in_parallel(guesses.iter(), |guess| {
        counter.add(1);
        let guess = guess.isometry();
        let steps = COARSE_STEPS.min(icp_steps);
        let refined = level(criteria, |gravity| one_way_icp(&coarse, target, *guess, gravity, steps, &counter))?;
        Ok((*guess, measure(guess, &refined, step)))
    });
    // Without this, the best few may all be the same transform and hide a rival.
    let mut candidates = distinct(candidates?, &coarse, criteria.inlier_distance);
    candidates.truncate(MIN_REFINED.max(count));
    for (guess, candidate) in &mut candidates {
        let rough = *candidate.t_target_source.isometry();
        let refined = level(criteria, |gravity| symmetric_icp(surfaces, rough, gravity, icp_steps, &counter))?;
        *candidate = measure(guess, &refined, 1);
    }
    let candidates = distinct(candidates, &coarse, criteria.inlier_distance);
    let mut candidates: Vec<Candidate> = candidates.into_iter().map(|(_, candidate)| candidate).collect();
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

/// Refines a guess by ICP with distant pairs, as a start for [`refine`].
///
/// # Errors
/// [`Error::Cancelled`](snake_core::Error::Cancelled) and
/// [`Error::DeadlineExceeded`](snake_core::Error::DeadlineExceeded).
pub fn approach(pair: &Pair, guess: &RigidTransform, icp_steps: usize, control: &Control) -> Result<RigidTransform> {
    let mut transform = *guess.isometry();
    for factor in [WIDE, WIDE.sqrt()] {
        let [source, target] = pair.surfaces_within(factor * pair.criteria().inlier_distance);
        let counter = control.begin("ICP", 0);
        transform = level(pair.criteria(), |gravity| {
            one_way_icp(source.points, &target, transform, gravity, icp_steps, &counter)
        })?;
    }
    Ok(transform.into())
}

/// The transform after ICP with a free rotation. If that tilts the known up axis too far, ICP runs
/// again with rotations about this axis only.
fn level(
    criteria: &Criteria,
    icp: impl Fn(Option<Vector>) -> Result<IsometryMatrix3<f64>>,
) -> Result<IsometryMatrix3<f64>> {
    let free = icp(None)?;
    if criteria.is_level(&free.rotation) { Ok(free) } else { icp(criteria.gravity) }
}

/// A transform before ICP, and the candidate after ICP.
type Refined = (IsometryMatrix3<f64>, Candidate);

/// Sorts candidates best first and drops those that move the points to about the same places as a better one.
fn distinct(mut candidates: Vec<Refined>, points: &[Vector], inlier_distance: f64) -> Vec<Refined> {
    // The sort is stable: the order decides ties.
    candidates.sort_by(|(_, a), (_, b)| b.score().total_cmp(&a.score()));
    let mut distinct: Vec<Refined> = Vec::new();
    for (guess, candidate) in candidates {
        let transform = candidate.t_target_source.isometry();
        let differs = |(_, other): &Refined| {
            displacement(transform, other.t_target_source.isometry(), points) > MIN_DIFFERENCE * inlier_distance
        };
        if distinct.iter().all(differs) {
            distinct.push((guess, candidate));
        }
    }
    distinct
}

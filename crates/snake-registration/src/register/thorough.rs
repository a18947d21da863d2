//! The thorough search of a pair whose first result is not reliable: transforms of single matches.

use snake_core::{Control, Result};
use snake_geometry::RigidTransform;

use super::second_look::{is_finer, less_confident};
use crate::options::{PairOptions, RegisterOptions};
use crate::result::Registration;
use crate::steps::refine::refine_supported;
use crate::steps::single_matches::Voters;
use crate::steps::{Match, Pair, challenge, judge};
use crate::tuning::tuning;

tuning! {
    /// Number of matches beside those of the usual search.
    matches: f64 = 2.5, unit "ratio",
        from "with 1, two of 35 validation pairs fewer are right";
    /// Number of transforms of single matches that are compared on the clouds, at most.
    candidates: usize = 40, unit "transforms", from "100 find no more on validation pairs";
    /// Number of transforms that are refined on all voxels.
    refined: usize = 12, unit "transforms", from "60 find no more on validation pairs";
}

/// Number of matches for the thorough search, where the usual one has `max_matches`.
pub(super) fn num_matches(max_matches: usize) -> usize {
    (TUNING.matches * max_matches as f64) as usize
}

/// The best of the transforms `guesses` and of those of single matches, by the support of the single
/// matches too.
pub(super) fn search_single_matches(
    pair: &Pair,
    matches: &[Match],
    indices: &[[usize; 2]],
    guesses: &[RigidTransform],
    options: &RegisterOptions,
    pair_options: &PairOptions,
    control: &Control,
) -> Result<Registration> {
    let voters = Voters::new(pair, indices, control)?;
    let single = voters.transforms(TUNING.candidates).into_iter().map(RigidTransform::from);
    let guesses: Vec<RigidTransform> = guesses.iter().copied().chain(single).collect();
    let count = TUNING.refined.max(pair_options.hypotheses);
    let candidates = refine_supported(pair, matches, &voters, &guesses, options.icp_steps, count, control)?;
    let mut registration = judge(pair, matches, &candidates)?;
    challenge(pair, matches, &mut registration)?;
    let mut registration = less_confident(registration);
    if is_finer(pair.clouds())? {
        // On voxels so coarse, what fits best may be off: the second look has to confirm it.
        let verdict = &mut registration.verdict;
        verdict.confidence = verdict.confidence.min(judge::TUNING.max_doubtful);
        verdict.is_reliable = false;
    }
    Ok(registration)
}

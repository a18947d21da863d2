//! A table of all ways to search for the transform of a pair.

use crate::options::{PairOptions, RegisterOptions};
use crate::result::Registration;
use crate::rigid::displacement;
use crate::steps::judge::less_confident;
use crate::steps::prepare::{Given, Level};
use crate::steps::refine::refine_supported;
use crate::steps::single_matches::Voters;
use crate::steps::{self, Match, Pair, approach, challenge, consensus, describe, judge, match_rows, refine};
use snake_core::{Control, Error, Result};
use snake_geometry::RigidTransform;

/// Number of matches for transforms of single matches, as a multiple of the usual number. With 1, two fewer of 35
/// validation pairs are right.
const MATCHES: f64 = 2.5;
/// Maximum number of transforms of single matches that are compared on the clouds. 100 find no more on validation
/// pairs.
const CANDIDATES: usize = 40;
/// Number of transforms that are refined on all voxels. 60 find no more on validation pairs.
const REFINED: usize = 12;
/// A try on finer voxels confirms a transform if the two move the source by less than this relative to each other.
/// Unit: inlier distances. Three of three right ones have 0.1 to 0.27.
const CONFIRMED: f64 = 0.5;

/// One try: a row of [`TRIES`].
struct Try {
    /// Whether it can change the result so far, which is not reliable.
    applies: fn(&Search, &Tried) -> bool,
    /// How it prepares the clouds and guesses transforms.
    run: fn(&Search, &mut Tried) -> Result<Registration>,
    /// Lowers the confidence by the cost of the try.
    cost: fn(&Search, Registration) -> Result<Registration>,
    keep: Keep,
}

/// Which result replaces the best one so far. Without one, any result is kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Keep {
    Always,
    MoreConfident,
    Reliable,
}

/// The tries in order; the search stops once a result is reliable.
const TRIES: [Try; 4] = [
    // Transforms on which matches agree.
    Try {
        applies: |_, _| true,
        run: |search, tried| search.by_matches(search.pair, tried),
        cost: |_, registration| Ok(registration),
        keep: Keep::Always,
    },
    // Also transforms of single matches.
    Try {
        applies: |search, tried| search.has_single_matches(tried) && !tried.repeats(),
        run: |search, tried| search.by_single_matches(tried),
        cost: |search, registration| search.unconfirmed(registration),
        // This try has compared the transforms of the first try, too.
        keep: Keep::Always,
    },
    // This try ignores the signs of normals, where the pair has them.
    Try {
        applies: |search, tried| tried.is_signed() && search.pair.has_doubtful_signs(),
        run: |search, tried| search.by_matches(&search.pair.without_signs(), tried),
        cost: |_, registration| Ok(registration),
        keep: Keep::MoreConfident,
    },
    // On finer voxels. Repetitive structure repeats at any voxel size.
    Try {
        applies: |search, tried| search.given.is_some() && !tried.repeats(),
        run: |search, tried| search.on_finer_voxels(tried),
        cost: |_, registration| Ok(less_confident(registration)),
        keep: Keep::Reliable,
    },
];

/// The effort of a search.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Effort {
    /// The transforms on which matches agree.
    Usual,
    /// Also transforms of single matches, if the first result is not reliable.
    Thorough,
}

/// A pair with prior knowledge, and how to search for its transform.
pub(crate) struct Search<'a, 'p> {
    pub(crate) pair: &'a Pair<'p>,
    pub(crate) options: &'a RegisterOptions,
    pub(crate) pair_options: &'a PairOptions,
    /// Further transforms to compare with those that the search finds.
    pub(crate) guesses: &'a [RigidTransform],
    pub(crate) effort: Effort,
    /// The original clouds, if they may be prepared again.
    pub(crate) given: Option<(&'a Given<'a>, &'a Level)>,
    pub(crate) control: &'a Control,
}

/// What the tries so far found.
#[derive(Default)]
struct Tried {
    best: Option<Registration>,
    matched: Option<Matched>,
    /// The best result from single matches, before the cost is applied.
    single: Option<Registration>,
}

/// The matches of a pair, and the transforms from matches and options.
struct Matched {
    is_signed: bool,
    indices: Vec<[usize; 2]>,
    matches: Vec<Match>,
    guesses: Vec<RigidTransform>,
}

impl Tried {
    fn is_signed(&self) -> bool {
        self.matched.as_ref().is_some_and(|matched| matched.is_signed)
    }

    /// Whether the target repeats itself, so that another try would not change the verdict.
    fn repeats(&self) -> bool {
        self.best.as_ref().is_some_and(|best| best.verdict.repeat_fit > judge::REPEATED)
    }
}

impl<'a, 'p> Search<'a, 'p> {
    /// A pair without prior knowledge, which is not prepared again.
    pub(crate) fn new(
        pair: &'a Pair<'p>,
        options: &'a RegisterOptions,
        pair_options: &'a PairOptions,
        effort: Effort,
        control: &'a Control,
    ) -> Self {
        Self { pair, options, pair_options, guesses: &[], effort, given: None, control }
    }

    /// The registration by the tries that apply.
    pub(crate) fn register(&self) -> Result<Registration> {
        let mut registration = self.run()?;
        registration.hypotheses.truncate(self.pair_options.hypotheses);
        note_rounding(&mut registration, self.pair_options);
        Ok(registration)
    }

    fn run(&self) -> Result<Registration> {
        let (mut tried, mut missing) = (Tried::default(), None);
        for one in &TRIES {
            if tried.best.as_ref().is_some_and(|best| best.verdict.is_reliable) {
                break;
            }
            if (one.applies)(self, &tried) {
                let outcome = (one.run)(self, &mut tried).and_then(|registration| (one.cost)(self, registration));
                missing = missing.or(keep(&mut tried.best, outcome, one.keep)?);
            }
        }
        let reason = || Error::NoTransform { reason: "nothing was tried".into() };
        tried.best.ok_or_else(|| missing.unwrap_or_else(reason))
    }

    /// The six steps for a pair; without signs of normals if the result contradicts the viewpoints.
    fn by_matches(&self, pair: &Pair, tried: &mut Tried) -> Result<Registration> {
        let Self { options, pair_options, control, .. } = self;
        let rows = describe(pair, control)?;
        let num_matches = (MATCHES * options.max_matches as f64) as usize;
        let indices = match_rows(&rows[0], &rows[1], num_matches, control)?;
        let matches = pair.matches(&indices[..indices.len().min(options.max_matches)])?;
        let mut guesses = match &pair_options.initial {
            Some(guess) => vec![approach(pair, &guess.with_exact_rotation(), options.icp_steps, control)?],
            None => consensus(&matches, pair.criteria(), steps::consensus::CANDIDATES, control)?,
        };
        guesses.extend_from_slice(self.guesses);
        let candidates = refine(pair, &matches, &guesses, options.icp_steps, pair_options.hypotheses, control)?;
        if candidates.first().is_some_and(|best| pair.contradicts_viewpoints(&best.t_target_source)) {
            return self.by_matches(&pair.without_signs(), tried);
        }
        let mut registration = judge(pair, &matches, &candidates)?;
        if pair_options.initial.is_none() {
            challenge(pair, &matches, &mut registration, options.icp_steps, control)?;
        }
        tried.matched = Some(Matched { is_signed: pair.is_signed(), indices, matches, guesses });
        Ok(registration)
    }

    /// Whether to search for transforms of single matches: they need signs, and without ICP the angle
    /// of a single match is too imprecise.
    fn has_single_matches(&self, tried: &Tried) -> bool {
        let is_possible = self.options.icp_steps > 0 && self.pair_options.initial.is_none();
        self.effort == Effort::Thorough && is_possible && tried.is_signed()
    }

    /// The best of the transforms so far and of those from single matches; the support of the single
    /// matches counts, too.
    fn by_single_matches(&self, tried: &mut Tried) -> Result<Registration> {
        let Some(Matched { indices, matches, guesses, .. }) = &tried.matched else {
            return Err(Error::NoTransform { reason: "no matches".into() });
        };
        let (pair, control) = (self.pair, self.control);
        let voters = Voters::new(pair, indices, control)?;
        let single = voters.transforms(CANDIDATES).into_iter().map(RigidTransform::from);
        let guesses: Vec<RigidTransform> = guesses.iter().copied().chain(single).collect();
        let count = REFINED.max(self.pair_options.hypotheses);
        let candidates = refine_supported(pair, matches, &voters, &guesses, self.options.icp_steps, count, control)?;
        let mut registration = judge(pair, matches, &candidates)?;
        challenge(pair, matches, &mut registration, self.options.icp_steps, control)?;
        tried.single = Some(registration.clone());
        Ok(registration)
    }

    /// Lowers the confidence of a transform from single matches. On voxels much coarser than the clouds,
    /// the best fit may be wrong, so the try on finer voxels has to confirm it.
    fn unconfirmed(&self, registration: Registration) -> Result<Registration> {
        let mut registration = less_confident(registration);
        let [source, target] = self.pair.fine()?;
        if source.is_finer && target.is_finer {
            let verdict = &mut registration.verdict;
            verdict.confidence = verdict.confidence.min(judge::MAX_DOUBTFUL);
            verdict.is_reliable = false;
            verdict.notes.push("not confirmed on finer voxels".into());
        }
        Ok(registration)
    }

    /// The tries by matches on voxels of a third of the side. The best result so far is one of the guesses. If they
    /// find the transform of the single matches, they confirm it.
    fn on_finer_voxels(&self, tried: &mut Tried) -> Result<Registration> {
        let none = || Error::NoTransform { reason: "the clouds are not finer than their voxels".into() };
        let (given, level) = self.given.ok_or_else(none)?;
        let level = level.finer(given, |_| true, self.control)?.ok_or_else(none)?;
        let pair = level.clouds.pair(self.options.gravity);
        let guesses: Vec<RigidTransform> = tried.best.iter().map(|best| best.t_target_source).collect();
        let finer = Search { pair: &pair, guesses: &guesses, effort: Effort::Usual, given: None, ..*self };
        match finer.run() {
            Err(error) if !matches!(error, Error::Cancelled | Error::DeadlineExceeded) => Err(none()),
            Ok(found) if !found.verdict.is_reliable => Ok(self.confirmed(&found, tried).unwrap_or(found)),
            // Within the smaller inlier distance surfaces that lie apart are not near any more.
            Ok(found) if judge::lies_apart(self.pair, found.t_target_source.isometry())? => Err(none()),
            outcome => outcome,
        }
    }

    /// The result of single matches, if it is the best so far and another try found the same transform.
    fn confirmed(&self, found: &Registration, tried: &mut Tried) -> Option<Registration> {
        let single = tried.single.take()?;
        let is_best = tried.best.as_ref().is_some_and(|best| best.t_target_source == single.t_target_source);
        let points = self.pair.surfaces()[0].points;
        let moved = displacement(found.t_target_source.isometry(), single.t_target_source.isometry(), points);
        let is_same = moved < CONFIRMED * single.fit.inlier_distance;
        (is_best && is_same && found.verdict.repeat_fit <= judge::REPEATED).then_some(single)
    }
}

/// Replaces the best result so far as `keep` says; among equally confident results the first stays.
/// Returns the error of a try without a transform.
///
/// # Errors
/// All other errors.
pub(super) fn keep(
    best: &mut Option<Registration>,
    outcome: Result<Registration>,
    keep: Keep,
) -> Result<Option<Error>> {
    let new = match outcome {
        Ok(new) => new,
        Err(error @ Error::NoTransform { .. }) => return Ok(Some(error)),
        Err(error) => return Err(error),
    };
    let is_kept = best.as_ref().is_none_or(|best| match keep {
        Keep::Always => true,
        Keep::MoreConfident => new.verdict.confidence > best.verdict.confidence,
        Keep::Reliable => new.verdict.is_reliable,
    });
    if is_kept {
        *best = Some(new);
    }
    Ok(None)
}

/// A guess whose rotation is off by more than this was rounded, which a note reports.
const ROUNDED: f64 = 1e-6;

/// Adds a note if the guess was not exactly a rotation.
fn note_rounding(registration: &mut Registration, pair_options: &PairOptions) {
    if pair_options.initial.is_some_and(|guess| guess.rotation_error() > ROUNDED) {
        registration.verdict.notes.push("`initial` has a rounded rotation: the nearest exact one was taken".into());
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{IsometryMatrix3, Translation3, Vector3};

    use super::*;
    use crate::rigid::tests::sample;
    use crate::steps::prepare;

    #[test]
    fn a_finer_look_confirms_what_it_finds_too() {
        let cloud = sample();
        let (options, pair_options, control) = Default::default();
        let prepared = prepare(&[&cloud, &cloud], &[None, None], None, &options, &control).unwrap();
        let pair = Pair::new(&prepared.clouds[0], &prepared.clouds[1], None);
        let search = Search::new(&pair, &options, &pair_options, Effort::Usual, &control);
        let single = search.register().unwrap();
        let distance = single.fit.inlier_distance;
        let off = |by: f64| {
            let shift = Translation3::from(Vector3::new(by * distance, 0.0, 0.0));
            let transform: IsometryMatrix3<f64> = shift * single.t_target_source.isometry();
            Registration { t_target_source: transform.into(), ..single.clone() }
        };
        let confirms = |found: &Registration, best: &Registration| {
            let mut tried = Tried { best: Some(best.clone()), single: Some(single.clone()), ..Default::default() };
            search.confirmed(found, &mut tried).is_some()
        };
        assert!(confirms(&off(0.3), &single));
        assert!(!confirms(&off(0.7), &single));
        // Another try gave the best so far.
        assert!(!confirms(&off(0.3), &off(0.1)));
        let mut repeats = off(0.3);
        repeats.verdict.repeat_fit = 1.0;
        assert!(!confirms(&repeats, &single));
        let mut weak = single.clone();
        (weak.verdict.confidence, weak.verdict.is_reliable) = (0.6, true);
        assert!(less_confident(weak).verdict.notes.last().unwrap().starts_with("not reliable"));
    }
}

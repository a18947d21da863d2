//! The steps from pairs of clouds to poses, with the notes that they collect.

use std::collections::BTreeMap;

use snake_core::{Control, Error, Result};
use snake_geometry::try_in_parallel;

use super::priors::{Checked, Priors};
use super::solved::{Registered, Solved, Trial, believed, solve};
use super::{Contradiction, missing_notes, units_notes};
use crate::options::PairOptions;
use crate::register::register_with;
use crate::register::tries::{Effort, Search};
use crate::result::Registration;
use crate::steps::Pair;
use crate::steps::judge::{REPEATED, less_confident};
use crate::steps::prepare::{Given, Pyramid};

/// Number of pairs without a reliable transform that get a second look, for each part that they would join to others.
/// Set for time.
const SECOND_LOOKS: usize = 3;

/// An alignment in progress: what is given, and the notes of its steps.
pub(super) struct Progress<'a> {
    given: &'a Given<'a>,
    pyramid: &'a Pyramid,
    priors: &'a Priors,
    control: &'a Control,
    /// The reliable registrations of pairs with initial poses, and their contradictions.
    checked: Checked,
    /// Notes on pairs that are not reliable by themselves.
    left_out: Vec<([usize; 2], String)>,
}

impl<'a> Progress<'a> {
    pub(super) fn new(given: &'a Given<'a>, pyramid: &'a Pyramid, priors: &'a Priors, control: &'a Control) -> Self {
        Self { given, pyramid, priors, control, checked: Checked::default(), left_out: Vec::new() }
    }

    /// Registers the pairs and solves for the poses.
    pub(super) fn first_look(&mut self, pairs: &[Trial]) -> Result<Solved> {
        let registered = self.register_pairs(pairs)?;
        solve(self.pyramid, self.judged(registered)?, self.given.options, self.control)
    }

    /// Registers again the pairs that would join parts, and solves for the poses.
    pub(super) fn second_look(&mut self, solved: Solved) -> Result<Solved> {
        let closer = self.look_again(&solved)?;
        let closer = self.judged(closer)?;
        solved.with(closer, self.pyramid, self.given.options, self.control)
    }

    /// Registers other pairs that overlap by the poses, and solves again. Returns the number of these pairs too.
    pub(super) fn by_poses(&mut self, solved: Solved) -> Result<(Solved, usize)> {
        let guided = solved.guesses(self.pyramid);
        let more = self.register_pairs(&guided)?;
        let more = self.priors.filter(more, &mut self.checked);
        Ok((solved.with(more, self.pyramid, self.given.options, self.control)?, guided.len()))
    }

    /// Keeps the registrations that do not contradict the initial poses. Those that would take part in
    /// the pose graph are replaced by what [`register`](crate::register()) finds for the pair alone, and
    /// a note names each that is then not reliable. Pairs with initial poses are not registered alone.
    fn judged(&mut self, registered: Vec<Registered>) -> Result<Vec<Registered>> {
        let registered = self.priors.filter(registered, &mut self.checked);
        let mut pairs = believed(self.pyramid, &registered);
        pairs.retain(|pair| !self.priors.has(*pair));
        let given = self.given;
        let alone = register_each("verdicts", &pairs, self.control, |&[source, target], control| {
            let pair_options = PairOptions::default()
                .with_source_viewpoint(given.viewpoint(source))
                .with_target_viewpoint(given.viewpoint(target));
            let [from, to] = [source, target].map(|cloud| given.points[cloud]);
            let registration = register_with(from, to, given.model, given.options, &pair_options, control)?;
            Ok(Some(([source, target], registration)))
        })?;
        self.left_out.extend(alone.iter().filter(|(_, found)| !found.verdict.is_reliable).map(left_out));
        let kept = registered.into_iter().filter(|(pair, _)| !pairs.contains(pair));
        let mut all: Vec<Registered> = kept.chain(alone).collect();
        all.sort_by_key(|(pair, _)| *pair);
        Ok(all)
    }

    /// The contradictions of pairs that the poses do not follow.
    pub(super) fn contradictions(&self, solved: &Solved) -> Vec<Contradiction> {
        let unused = self.checked.contradictions.values().filter(|at| !solved.follows([at.source, at.target]));
        let mut contradictions: Vec<Contradiction> = unused.copied().collect();
        contradictions.sort_by_key(|contradiction| (contradiction.source, contradiction.target));
        contradictions
    }

    /// Notes on the initial poses, on the clouds, and on the pairs that are left out.
    pub(super) fn notes(&self, solved: &Solved) -> Vec<String> {
        let clouds = self.pyramid.usual();
        let named = self.left_out.iter().filter(|(pair, _)| !solved.follows(*pair)).cloned();
        let between_parts = solved.joining(1, |_| true).into_iter().map(left_out);
        let left_out: BTreeMap<_, _> = between_parts.chain(named).collect();
        let on_clouds = missing_notes(clouds).chain(units_notes(clouds));
        self.priors.note(&self.checked).into_iter().chain(on_clouds).chain(left_out.into_values()).collect()
    }

    /// Registers all pairs and leaves out those without a transform.
    fn register_pairs(&self, pairs: &[Trial]) -> Result<Vec<Registered>> {
        let Self { pyramid, priors, given: Given { options, .. }, .. } = *self;
        register_each("pairs", pairs, self.control, |([source, target], guess), control| {
            let scale = pyramid.common(&[*source, *target]);
            let [from, to] = [source, target].map(|&cloud| pyramid.cloud(cloud, scale));
            let pair = Pair::new(from, to, options.gravity);
            let registration = match guess {
                Some(_) => {
                    let guessed = PairOptions::default().with_initial(*guess);
                    Search::new(&pair, options, &guessed, Effort::Usual, control).register()
                }
                None => priors.register([*source, *target], &pair, options, control),
            };
            registration.map(|registration| Some(([*source, *target], registration)))
        })
    }

    /// Registers unreliable pairs that would join parts again, on finer voxels: the most confident few for each part, but
    /// for what repeats, as it repeats on voxels of any size. As for any further try, their confidence is lowered.
    fn look_again(&self, solved: &Solved) -> Result<Vec<Registered>> {
        let (pyramid, options) = (self.pyramid, self.given.options);
        let joining = solved.joining(SECOND_LOOKS, |verdict| verdict.repeat_fit <= REPEATED);
        register_each("finer voxels", &joining, self.control, |(clouds, first), control| {
            let scale = pyramid.common(clouds);
            let [Some(source), Some(target)] = clouds.map(|cloud| pyramid.finer(cloud, scale)) else { return Ok(None) };
            let (pair, free) = (Pair::new(source, target, options.gravity), PairOptions::default());
            let search = Search::new(&pair, options, &free, Effort::Usual, control);
            let finer = Search { guesses: &[first.t_target_source], ..search }.register()?;
            Ok(Some((*clouds, less_confident(finer))))
        })
    }
}

/// A note on a pair that the poses do not follow.
fn left_out(([source, target], Registration { verdict, .. }): &Registered) -> ([usize; 2], String) {
    let word = verdict.word();
    let reason = match verdict.notes.first() {
        Some(note) if note.starts_with(word) => note.clone(),
        Some(note) => format!("{word}, {note}"),
        None => word.into(),
    };
    ([*source, *target], format!("clouds {source} and {target} (from 0) are left out: {reason}"))
}

/// Runs all trials and leaves out those without a transform.
fn register_each<T: Sync>(
    stage: &'static str,
    trials: &[T],
    control: &Control,
    register: impl Fn(&T, &Control) -> Result<Option<Registered>> + Sync,
) -> Result<Vec<Registered>> {
    let counter = control.begin(stage, trials.len());
    let inner = control.without_progress();
    let one = |trial: &T| {
        counter.check()?;
        let registration = register(trial, &inner);
        counter.add(1);
        match registration {
            // No three matches agree: these clouds do not fit.
            Err(Error::NoTransform { .. }) => Ok(None),
            other => other,
        }
    };
    Ok(try_in_parallel(trials.iter(), one)?.into_iter().flatten().collect())
}

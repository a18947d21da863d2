//! Registration of two clouds.

mod instances;
mod prepared_map;
mod scales;
pub(crate) mod second_look;
mod thorough;

use std::time::Instant;

use snake_core::{Control, Error, Model, Result};
use snake_geometry::{Point, RigidTransform};

use crate::options::{PairOptions, RegisterOptions};
use crate::result::Registration;
use crate::steps::prepare::prepare_named;
use crate::steps::{self, Pair, PreparedClouds, approach, challenge, consensus, describe, judge, match_rows, refine};
use instances::register_instances;
pub use prepared_map::PreparedMap;
use scales::register_at_scales;
use second_look::{Given, NAMES, better, is_settled};
use thorough::search_single_matches;

/// Finds the rigid transform from `source` `(N, 3)` to `target` `(M, 3)` without an initial guess.
///
/// Both clouds are in the same units; they may overlap only in part. [`register_with`] takes what
/// is known of the pair, such as a guess, and the model of a detector or descriptor that runs one.
///
/// ```
/// use snake_core::RigidTransform;
/// use snake_registration::{RegisterOptions, register, transform_points};
/// # let source = snake_io::read_points(concat!(env!("CARGO_MANIFEST_DIR"), "/../../samples/plane.ply").as_ref())?;
/// let rows = [[0.0, -1.0, 0.0, 3.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];
/// let t_target_source = RigidTransform::from_matrix(rows)?;
/// let target = transform_points(&t_target_source, &source);
/// let registration = register(&source, &target, &RegisterOptions::default())?;
/// let (angle, distance) = registration.t_target_source.angle_and_distance_to(&t_target_source);
/// assert!(angle < 0.05 && distance < 0.05 && registration.verdict.is_reliable);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`Error::Input`](snake_core::Error::Input) for a cloud without finite points or without extent;
/// [`Error::NoTransform`](snake_core::Error::NoTransform) when no three matches fit a rigid
/// transform; [`Error::Option`](snake_core::Error::Option) when an option is outside its range or
/// needs a model.
pub fn register(source: &[Point], target: &[Point], options: &RegisterOptions) -> Result<Registration> {
    register_with(source, target, None, options, &PairOptions::default(), &Control::default())
}

/// [`register`] with what is known of the pair, with the model of the detector `snake` or the
/// descriptor `field`, and with progress and cancellation.
///
/// # Errors
/// The errors of [`register`]; [`Error::Cancelled`](snake_core::Error::Cancelled) and
/// [`Error::DeadlineExceeded`](snake_core::Error::DeadlineExceeded).
pub fn register_with(
    source: &[Point],
    target: &[Point],
    model: Option<&Model>,
    options: &RegisterOptions,
    pair_options: &PairOptions,
    control: &Control,
) -> Result<Registration> {
    let start = Instant::now();
    options.check_ranges()?;
    pair_options.check()?;
    let given = Given { clouds: [source, target], model, options, pair_options };
    if pair_options.estimate_scale {
        let registration = register_at_scales(&given, control)?;
        return Ok(Registration { seconds: start.elapsed().as_secs_f64(), ..registration });
    }
    let prepared = prepare_named(&given.clouds, &NAMES, &pair_options.viewpoints(), model, options, control)?;
    let first = register_prepared(&prepared, options, pair_options, &[], Effort::Thorough, control);
    let registration = given.look_again(&prepared, first, control)?;
    Ok(Registration { seconds: start.elapsed().as_secs_f64(), ..registration })
}

/// How much is tried.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Effort {
    /// The transforms on which matches agree.
    Usual,
    /// Those of single matches too, if the first result is not reliable.
    Thorough,
}

/// [`register_pair`] of the first two clouds, with `guesses` beside those that are searched for.
fn register_prepared(
    prepared: &PreparedClouds,
    options: &RegisterOptions,
    pair_options: &PairOptions,
    guesses: &[RigidTransform],
    effort: Effort,
    control: &Control,
) -> Result<Registration> {
    let pair = Pair::new(&prepared.clouds[0], &prepared.clouds[1], options.gravity);
    register_guessed(&pair, options, pair_options, guesses, effort, control)
}

/// Registers two prepared clouds. The viewpoints of the options are not used: they are part of the
/// preparation. A map for many scans is a [`PreparedMap`].
///
/// # Errors
/// The errors of [`register_with`].
pub fn register_pair(
    pair: &Pair,
    options: &RegisterOptions,
    pair_options: &PairOptions,
    control: &Control,
) -> Result<Registration> {
    options.check_ranges()?;
    pair_options.check()?;
    register_guessed(pair, options, pair_options, &[], Effort::Thorough, control)
}

/// [`register_pair`] of options within their ranges, with `guesses` beside those that are searched
/// for.
pub(crate) fn register_guessed(
    pair: &Pair,
    options: &RegisterOptions,
    pair_options: &PairOptions,
    guesses: &[RigidTransform],
    effort: Effort,
    control: &Control,
) -> Result<Registration> {
    let start = Instant::now();
    if pair_options.instances > 1 {
        let registration = register_instances(pair, pair_options, control)?;
        return Ok(Registration { seconds: start.elapsed().as_secs_f64(), ..registration });
    }
    let mut registration = match search(pair, options, pair_options, guesses, effort, control) {
        // Without viewpoints, these clouds would have had no signs.
        Ok(first) if !first.verdict.is_reliable && pair.has_doubtful_signs() => {
            match search(&pair.without_signs(), options, pair_options, guesses, effort, control) {
                Ok(unsigned) => better(first, unsigned),
                Err(Error::NoTransform { .. }) => first,
                Err(error) => return Err(error),
            }
        }
        other => other?,
    };
    note_rounding(&mut registration, pair_options);
    Ok(Registration { seconds: start.elapsed().as_secs_f64(), ..registration })
}

/// The six steps for two prepared clouds, without signs of normals where they prove wrong.
fn search(
    pair: &Pair,
    options: &RegisterOptions,
    pair_options: &PairOptions,
    more: &[RigidTransform],
    effort: Effort,
    control: &Control,
) -> Result<Registration> {
    let rows = describe(pair, control)?;
    let indices = match_rows(&rows[0], &rows[1], thorough::num_matches(options.max_matches), control)?;
    let matches = pair.matches(&indices[..indices.len().min(options.max_matches)])?;
    let mut guesses = match &pair_options.initial {
        Some(guess) => vec![approach(pair, &guess.with_exact_rotation(), options.icp_steps, control)?],
        None => consensus(&matches, pair.criteria(), steps::consensus::TUNING.candidates, control)?,
    };
    guesses.extend_from_slice(more);
    let candidates = refine(pair, &matches, &guesses, options.icp_steps, pair_options.hypotheses, control)?;
    if candidates.first().is_some_and(|best| pair.contradicts_viewpoints(&best.t_target_source)) {
        return search(&pair.without_signs(), options, pair_options, more, effort, control);
    }
    let mut registration = judge(pair, &matches, &candidates)?;
    if pair_options.initial.is_none() {
        challenge(pair, &matches, &mut registration)?;
        // The angle of a single match is rough: without ICP it is of no use.
        let is_possible = effort == Effort::Thorough && pair.is_signed() && options.icp_steps > 0;
        if is_possible && !is_settled(&registration.verdict) {
            registration = search_single_matches(pair, &matches, &indices, &guesses, options, pair_options, control)?;
        }
    }
    registration.hypotheses.truncate(pair_options.hypotheses);
    Ok(registration)
}

/// A guess whose rotation is off by more has too few digits, about which a note is due.
const ROUNDED: f64 = 1e-6;

/// Notes that the guess was not quite a rotation.
fn note_rounding(registration: &mut Registration, pair_options: &PairOptions) {
    if pair_options.initial.is_some_and(|guess| guess.rotation_error() > ROUNDED) {
        registration.verdict.notes.push("`initial` has a rounded rotation: the nearest exact one was taken".into());
    }
}

#[cfg(test)]
mod tests;

//! A source of unknown scale: registration at several factors.

use super::second_look::{Given, NAMES, less_confident};
use super::{Effort, register_prepared};
use crate::options::PairOptions;
use crate::result::Registration;
use crate::steps::Pair;
use crate::steps::judge::best_scale;
use crate::steps::prepare::prepare_named;
use crate::tuning::tuning;
use snake_core::{Control, Error, Result};
use snake_geometry::Point;

tuning! {
    /// Ratio of two factors that are tried one after the other.
    ratio: f64 = 1.12, unit "ratio", from "sources 5 percent off are registered";
    /// Number of factors to either side of 1.
    factors: i32 = 14, unit "factors", from "1.12 to the 14th is 4.9";
    /// Number of times that the factor is made exact.
    rounds: usize = 2, unit "rounds", from "set by hand";
}

/// The registration at the scale at which it is most confident. Factors near 1 are tried first,
/// until one is reliable.
///
/// # Errors
/// The errors of [`register_with`](crate::register_with).
pub(super) fn register_at_scales(given: &Given, control: &Control) -> Result<Registration> {
    let mut best: Option<Registration> = None;
    let powers = (0..=TUNING.factors).flat_map(|power| [power, -power]).skip(1);
    for power in powers {
        match at_scale(given, TUNING.ratio.powi(power), control) {
            Ok(one) => best = Some(better(best, less_confident(one))),
            Err(Error::NoTransform { .. }) => continue,
            Err(error) => return Err(error),
        }
        if best.as_ref().is_some_and(|best| best.verdict.is_reliable) {
            break;
        }
    }
    best.ok_or_else(|| Error::NoTransform { reason: "no three correspondences fit at any scale from 0.2 to 5".into() })
}

/// The first unless the second is more confident.
fn better(first: Option<Registration>, second: Registration) -> Registration {
    match first {
        Some(first) if first.verdict.confidence >= second.verdict.confidence => first,
        _ => second,
    }
}

/// The registration at a factor that is made exact on the clouds.
fn at_scale(given: &Given, factor: f64, control: &Control) -> Result<Registration> {
    let [source, target] = given.clouds;
    let mut scale = factor;
    let mut registration: Option<Registration> = None;
    for _ in 0..=TUNING.rounds {
        let source: Vec<Point> = source.iter().map(|point| point.map(|v| (scale * f64::from(v)) as f32)).collect();
        let source_viewpoint = given.pair_options.source_viewpoint.map(|at| at.map(|v| scale * v));
        let pair_options = PairOptions { source_viewpoint, estimate_scale: false, ..*given.pair_options };
        let viewpoints = pair_options.viewpoints();
        let prepared = prepare_named(&[&source, target], &NAMES, &viewpoints, given.model, given.options, control)?;
        let one = match register_prepared(&prepared, given.options, &pair_options, &[], Effort::Usual, control) {
            Ok(one) => Registration { scale, ..one },
            // Without a transform at the exact factor, that at the rough one stays.
            Err(Error::NoTransform { .. }) if registration.is_some() => break,
            Err(error) => return Err(error),
        };
        let pair = Pair::new(&prepared.clouds[0], &prepared.clouds[1], given.options.gravity);
        let change = best_scale(pair.surfaces(), one.t_target_source.isometry()).unwrap_or(1.0);
        // The exact factor counts unless it is doubtful.
        registration = Some(if one.verdict.is_reliable { one } else { better(registration, one) });
        if (change - 1.0).abs() < 1e-3 || !(1.0 / TUNING.ratio..TUNING.ratio).contains(&change) {
            break;
        }
        scale *= change;
    }
    registration.ok_or_else(|| Error::NoTransform { reason: format!("nothing fits at the scale {factor:.3}") })
}

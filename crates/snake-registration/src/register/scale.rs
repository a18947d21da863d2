//! Registration of a source of unknown scale, at several scale factors.

use super::tries::{Effort, Keep, Search, keep};
use crate::options::PairOptions;
use crate::result::Registration;
use crate::steps::judge::{best_scale, less_confident};
use crate::steps::prepare::Given;
use snake_core::{Control, Error, Result};
use snake_geometry::Point;

/// Ratio of consecutive scale factors. Sources that are 5 percent off are registered.
const RATIO: f64 = 1.12;
/// Number of factors on either side of 1: 1.12 to the 14th is 4.9.
const FACTORS: i32 = 14;
/// Maximum number of corrections of a factor. Set by hand.
const ROUNDS: usize = 2;

/// The most confident of the registrations at all scale factors. Factors near 1 are tried first,
/// until one is reliable.
pub(super) fn register_at_scales(given: &Given, pair_options: &PairOptions, control: &Control) -> Result<Registration> {
    let mut best: Option<Registration> = None;
    for power in (0..=FACTORS).flat_map(|power| [power, -power]).skip(1) {
        let outcome = at_scale(given, pair_options, RATIO.powi(power), control).map(less_confident);
        keep(&mut best, outcome, Keep::MoreConfident)?;
        if best.as_ref().is_some_and(|best| best.verdict.is_reliable) {
            break;
        }
    }
    best.ok_or_else(|| Error::NoTransform { reason: "no three correspondences fit at any scale from 0.2 to 5".into() })
}

/// The registration at a scale factor, which is corrected on the clouds.
fn at_scale(given: &Given, pair_options: &PairOptions, factor: f64, control: &Control) -> Result<Registration> {
    let mut scale = factor;
    let mut best: Option<Registration> = None;
    for _ in 0..=ROUNDS {
        let source: Vec<Point> =
            given.points[0].iter().map(|point| point.map(|v| (scale * f64::from(v)) as f32)).collect();
        let viewpoints = vec![given.viewpoint(0).map(|at| at.map(|v| scale * v)), given.viewpoint(1)];
        let level = Given { points: vec![&source, given.points[1]], viewpoints, ..*given }.prepare(control)?;
        let pair = level.clouds.pair(given.options.gravity);
        let one = match Search::new(&pair, given.options, pair_options, Effort::Usual, control).register() {
            Ok(one) => Registration { scale, ..one },
            // Without a transform at the corrected factor, the one at the previous factor stays.
            Err(Error::NoTransform { .. }) if best.is_some() => break,
            Err(error) => return Err(error),
        };
        let change = best_scale(pair.surfaces(), one.t_target_source.isometry()).unwrap_or(1.0);
        // A reliable result replaces the previous one; a doubtful one only if it is more confident.
        let how = if one.verdict.is_reliable { Keep::Always } else { Keep::MoreConfident };
        keep(&mut best, Ok(one), how)?;
        if (change - 1.0).abs() < 1e-3 || !(1.0 / RATIO..RATIO).contains(&change) {
            break;
        }
        scale *= change;
    }
    best.ok_or_else(|| Error::NoTransform { reason: format!("nothing fits at the scale {factor:.3}") })
}

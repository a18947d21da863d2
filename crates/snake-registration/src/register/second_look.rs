//! The second look at a pair whose first result is not reliable: the same steps on finer voxels.

use snake_core::{Control, Error, Model, Result};
use snake_geometry::{Length, Point, RigidTransform};

use super::{Effort, register_prepared};
use crate::options::{PairOptions, RegisterOptions};
use crate::result::{Registration, Verdict};
use crate::steps::judge;
use crate::steps::prepare::prepare_named;
use crate::steps::{PreparedCloud, PreparedClouds};
use crate::tuning::tuning;

tuning! {
    /// Voxels of the first look beside those of the second.
    finer: f64 = 3.0, unit "ratio of sides",
        from "of 24 pairs of made sweeps 13 and 17 m apart 11 are reliable, 5 without a second look (`sweeps` in tests/verdict.rs)";
}

/// Two clouds `(N, 3)` as they were given.
pub(super) struct Given<'a> {
    pub(super) clouds: [&'a [Point]; 2],
    pub(super) model: Option<&'a Model>,
    pub(super) options: &'a RegisterOptions,
    pub(super) pair_options: &'a PairOptions,
}

impl Given<'_> {
    /// The result of the first look, or that of a second one on finer voxels if it is better.
    ///
    /// A second look is taken if the first is not reliable, no length is given, and both clouds
    /// have much more points than voxels. What repeats itself does so at any size of voxels.
    pub(super) fn look_again(
        &self,
        prepared: &PreparedClouds,
        first: Result<Registration>,
        control: &Control,
    ) -> Result<Registration> {
        let is_settled = match &first {
            Ok(first) => is_settled(&first.verdict),
            Err(error) => !matches!(error, Error::NoTransform { .. }),
        };
        if is_settled
            || self.pair_options.instances > 1
            || self.options.has_lengths()
            || !is_finer([&prepared.clouds[0], &prepared.clouds[1]])?
        {
            return first;
        }
        let size = Length::Units(prepared.lengths.voxel_size / TUNING.finer);
        let options = self.options.with_voxel_size(Some(size));
        let guesses: Vec<RigidTransform> = first.iter().map(|first| first.t_target_source).collect();
        let viewpoints = self.pair_options.viewpoints();
        let prepared = prepare_named(&self.clouds, &NAMES, &viewpoints, self.model, &options, control);
        let second = prepared.and_then(|prepared| {
            register_prepared(&prepared, &options, self.pair_options, &guesses, Effort::Usual, control)
        });
        match second {
            Ok(second) => {
                let second = less_confident(second);
                Ok(match first {
                    Ok(first) if !second.verdict.is_reliable => first,
                    _ => second,
                })
            }
            Err(error @ (Error::Cancelled | Error::DeadlineExceeded)) => Err(error),
            Err(_) => first,
        }
    }
}

/// Whether another try would not change a verdict: it is reliable, or the target repeats itself.
pub(super) fn is_settled(verdict: &Verdict) -> bool {
    verdict.is_reliable || verdict.repeat_fit > judge::TUNING.repeated
}

/// The names of the clouds in errors.
pub(super) const NAMES: [&str; 2] = ["source", "target"];

/// Whether both clouds have much more points than voxels.
pub(super) fn is_finer(clouds: [&PreparedCloud; 2]) -> Result<bool> {
    Ok(clouds[0].fine()?.is_finer && clouds[1].fine()?.is_finer)
}

/// The result of a second try, with a lower confidence: of two wrong results, one looks right by
/// chance twice as often.
pub(crate) fn less_confident(mut registration: Registration) -> Registration {
    let verdict = &mut registration.verdict;
    verdict.confidence /= 2.0 - verdict.confidence;
    verdict.is_reliable = verdict.confidence >= judge::TUNING.reliable;
    registration
}

/// The result with the greater confidence; of equals the first.
pub(super) fn better(first: Registration, second: Registration) -> Registration {
    if second.verdict.confidence > first.verdict.confidence { second } else { first }
}

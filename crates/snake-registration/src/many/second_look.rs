//! The second look at pairs that would join parts: on finer voxels, as that of a single pair.

use rayon::prelude::*;

use snake_core::{Control, Error, Result};

use super::scales::Scales;
use super::solved::Solved;
use super::{Registered, TUNING};
use crate::options::{PairOptions, RegisterOptions};
use crate::register::second_look::less_confident;
use crate::register::{Effort, register_guessed};
use crate::steps::Pair;

/// Registers the most confident of the pairs that are not reliable and would join parts again: a few
/// for each part, of clouds that have finer voxels.
pub(super) fn look_again(
    scales: &Scales,
    solved: &Solved,
    options: &RegisterOptions,
    control: &Control,
) -> Result<Vec<Registered>> {
    let joining = solved.joining(TUNING.second_looks);
    let counter = control.begin("second looks", joining.len());
    let inner = control.without_progress();
    let register = |(clouds, first): &&Registered| {
        counter.check()?;
        counter.add(1);
        let scale = scales.common(clouds);
        let [Some(source), Some(target)] = clouds.map(|cloud| scales.finer(cloud, scale)) else { return Ok(None) };
        let pair = Pair::new(source, target, options.gravity);
        match register_guessed(&pair, options, &PairOptions::default(), &[first.t_target_source], Effort::Usual, &inner)
        {
            Ok(second) => Ok(Some((*clouds, less_confident(second)))),
            Err(Error::NoTransform { .. }) => Ok(None),
            Err(error) => Err(error),
        }
    };
    let second: Vec<Option<Registered>> = joining.par_iter().map(register).collect::<Result<_>>()?;
    Ok(second.into_iter().flatten().collect())
}

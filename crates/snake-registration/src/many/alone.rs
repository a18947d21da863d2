//! The verdict of `register` about pairs of the clouds: an edge is believed by no other.

use std::collections::HashSet;

use rayon::prelude::*;

use snake_core::{Control, Error, Result};

use super::Registered;
use super::scales::Given;
use crate::options::PairOptions;
use crate::register::register_with;

/// `registered` with what [`register`](crate::register()) finds for some of the pairs in the place of what
/// the voxels of all clouds showed. A note names each pair that is no longer reliable.
pub(super) fn registered_alone(
    given: &Given,
    registered: Vec<Registered>,
    pairs: &[[usize; 2]],
    notes: &mut Vec<([usize; 2], String)>,
    control: &Control,
) -> Result<Vec<Registered>> {
    let counter = control.begin("verdicts", pairs.len());
    let inner = control.without_progress();
    let alone = pairs.par_iter().map(|&[source, target]| {
        counter.check()?;
        counter.add(1);
        let viewpoint = |cloud: usize| given.viewpoints.get(cloud).copied().flatten();
        let pair_options =
            PairOptions::default().with_source_viewpoint(viewpoint(source)).with_target_viewpoint(viewpoint(target));
        let clouds = [source, target].map(|cloud| given.points[cloud]);
        match register_with(clouds[0], clouds[1], given.model, given.options, &pair_options, &inner) {
            Ok(registration) => Ok(Some(([source, target], registration))),
            Err(Error::NoTransform { .. }) => Ok(None),
            Err(error) => Err(error),
        }
    });
    let alone: Vec<Option<Registered>> = alone.collect::<Result<_>>()?;
    for ([source, target], found) in pairs.iter().zip(&alone) {
        let Some((_, registration)) = found.as_ref().filter(|(_, found)| !found.verdict.is_reliable) else { continue };
        let words = format!("clouds {source} and {target} (from 0) are left out: {}", registration.verdict.word());
        let reason = registration.verdict.notes.first().map(|note| format!(", {note}")).unwrap_or_default();
        notes.push(([*source, *target], words + &reason));
    }
    let replaced: HashSet<[usize; 2]> = pairs.iter().copied().collect();
    let kept = registered.into_iter().filter(|(pair, _)| !replaced.contains(pair));
    let mut all: Vec<Registered> = kept.chain(alone.into_iter().flatten()).collect();
    all.sort_by_key(|(pair, _)| *pair);
    Ok(all)
}

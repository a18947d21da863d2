//! The verdict of `register` about pairs of the clouds: an edge is believed by no other.

use std::collections::HashSet;

use snake_core::{Control, Result};

use super::{Registered, register_each};
use crate::options::PairOptions;
use crate::register::register_with;
use crate::steps::prepare::Given;

/// `registered` with what [`register`](crate::register()) finds for some of the pairs in the place of what
/// the voxels of all clouds showed. A note names each pair that is no longer reliable.
pub(super) fn registered_alone(
    given: &Given,
    registered: Vec<Registered>,
    pairs: &[[usize; 2]],
    notes: &mut Vec<([usize; 2], String)>,
    control: &Control,
) -> Result<Vec<Registered>> {
    let alone = register_each("verdicts", pairs, control, |&[source, target], control| {
        let pair_options = PairOptions::default()
            .with_source_viewpoint(given.viewpoint(source))
            .with_target_viewpoint(given.viewpoint(target));
        let [from, to] = [source, target].map(|cloud| given.points[cloud]);
        let registration = register_with(from, to, given.model, given.options, &pair_options, control)?;
        Ok(Some(([source, target], registration)))
    })?;
    for ([source, target], registration) in alone.iter().filter(|(_, registration)| !registration.verdict.is_reliable) {
        let words = format!("clouds {source} and {target} (from 0) are left out: {}", registration.verdict.word());
        let reason = registration.verdict.notes.first().map(|note| format!(", {note}")).unwrap_or_default();
        notes.push(([*source, *target], words + &reason));
    }
    let replaced: HashSet<[usize; 2]> = pairs.iter().copied().collect();
    let kept = registered.into_iter().filter(|(pair, _)| !replaced.contains(pair));
    let mut all: Vec<Registered> = kept.chain(alone).collect();
    all.sort_by_key(|(pair, _)| *pair);
    Ok(all)
}

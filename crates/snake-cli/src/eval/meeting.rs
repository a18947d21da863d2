//! A look at the pairs of a data set before hours of work: clouds that do not meet have figures near zero.

use anyhow::Result;
use snake_eval::{Meeting, meeting_note};

use crate::terminal;

/// The most pairs that are looked at, evenly spaced: a wrong direction or unit is that of all.
const MAX_PAIRS: usize = 50;

/// Warns where clouds of the chosen pairs do not meet. `meeting` gives the name of a pair and how far it meets, or `None` for a
/// pair whose transform is known.
pub fn warn_if_apart(chosen: &[usize], meeting: impl Fn(usize) -> Result<Option<(String, Meeting)>>) -> Result<()> {
    let mut pairs = Vec::new();
    for &pair in chosen.iter().step_by(chosen.len().div_ceil(MAX_PAIRS).max(1)) {
        match meeting(pair)? {
            Some(met) => pairs.push(met),
            None => return Ok(()),
        }
    }
    if let Some(note) = meeting_note(&pairs) {
        terminal::warn(&note);
    }
    Ok(())
}

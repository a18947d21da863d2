//! A check of the pairs of a data set before hours of work: clouds that do not meet have figures near zero.

use anyhow::Result;
use snake_eval::{Meeting, meeting_note};

use crate::terminal;

/// The most pairs that are checked, evenly spaced; a wrong direction or unit affects all pairs.
const MAX_PAIRS: usize = 50;

/// Warns of chosen pairs whose clouds do not meet. `meeting` gives the name of a pair and its [`Meeting`], or `None` for a pair
/// whose transform is known. The evaluation reports pairs that cannot be read.
pub fn warn_if_apart(chosen: &[usize], meeting: impl Fn(usize) -> Result<Option<(String, Meeting)>>) {
    let some = chosen.iter().step_by(chosen.len().div_ceil(MAX_PAIRS).max(1));
    let pairs: Vec<(String, Meeting)> =
        some.map_while(|&pair| meeting(pair).transpose()).filter_map(Result::ok).collect();
    if let Some(note) = meeting_note(&pairs) {
        terminal::warn(&note);
    }
}

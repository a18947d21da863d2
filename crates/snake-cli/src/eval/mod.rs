//! `snake-cli eval`: metrics of keypoints over data sets.

pub mod args;
mod methods;
mod pairs;
mod paper;
mod plot;
mod record;
mod registration;
mod repeatability;
mod semantic;
mod table;

use std::path::Path;

use anyhow::{Context, Result, bail};
use serde::de::DeserializeOwned;

use args::{Eval, RunArguments};

/// Evaluates what is not yet recorded, then reports.
pub fn run(command: &Eval) -> Result<()> {
    let RunArguments { compute, .. } = match command {
        Eval::Repeatability(arguments) => &arguments.common.run,
        Eval::Semantic(arguments) => &arguments.common.run,
        Eval::Registration(arguments) => &arguments.run,
    };
    compute.start_threads()?;
    match command {
        Eval::Repeatability(arguments) => repeatability::run(arguments),
        Eval::Semantic(arguments) => semantic::run(arguments),
        Eval::Registration(arguments) => registration::run(arguments),
    }
}

fn read_json<T: DeserializeOwned>(path: &Path) -> Result<T> {
    let text = std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    serde_json::from_str(&text).with_context(|| path.display().to_string())
}

/// Indices of `limit` of `length` pairs, evenly spaced from the first to the last.
fn evenly_spaced(length: usize, limit: Option<usize>) -> Result<Vec<usize>> {
    Ok(match limit {
        Some(0) => bail!("--limit must be 1 or more"),
        Some(1) => vec![0],
        Some(limit) if limit < length => {
            (0..limit).map(|i| (i * (length - 1) + (limit - 1) / 2) / (limit - 1)).collect()
        }
        _ => (0..length).collect(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_pairs_are_evenly_spaced() {
        let spaced = |length, limit| evenly_spaced(length, limit).unwrap();
        assert_eq!(spaced(5, None), [0, 1, 2, 3, 4]);
        assert_eq!(spaced(5, Some(9)), [0, 1, 2, 3, 4]);
        assert_eq!(spaced(9, Some(3)), [0, 4, 8]);
        assert_eq!(spaced(9, Some(2)), [0, 8]);
        assert_eq!(spaced(9, Some(1)), [0]);
        assert!(evenly_spaced(9, Some(0)).is_err());
    }
}

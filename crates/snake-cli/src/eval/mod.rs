//! `snake-cli eval`: metrics of keypoints on data sets.

pub mod args;
mod methods;
mod pairs;
mod paper;
mod plot;
mod record;
mod registration;
mod repeatability;
mod schedule;
mod semantic;
mod statistic;
mod table;

use std::path::Path;

use anyhow::{Context, Result};
use serde::de::DeserializeOwned;

use crate::output::InputFiles;
use args::{Eval, RunArguments};

/// Evaluates everything that is not yet recorded, then reports.
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

/// Returns an error if the results would replace an input file.
fn check_outputs<'a>(run: &'a RunArguments, metric: &str, inputs: impl Iterator<Item = &'a Path>) -> Result<()> {
    let Some(folder) = &run.output else { return Ok(()) };
    let inputs = InputFiles::new(inputs.chain(run.compute.model.as_deref()));
    table::EXTENSIONS
        .iter()
        .try_for_each(|extension| inputs.refuse_as_output(&folder.join(format!("{metric}.{extension}"))))
}

fn read_json<T: DeserializeOwned>(path: &Path) -> Result<T> {
    let text = std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    serde_json::from_str(&text).with_context(|| path.display().to_string())
}

//! `snake-cli eval`: metrics of keypoints on data sets.

pub mod args;
mod described;
mod meeting;
mod methods;
mod record;
mod registration;
mod repeatability;
mod schedule;
mod semantic;

use anyhow::Result;

use crate::SUCCESS;
use args::{Eval, RunArguments};

/// Evaluates everything that is not yet recorded, then reports.
pub fn run(command: &Eval) -> Result<u8> {
    let RunArguments { compute, .. } = match command {
        Eval::Repeatability(arguments) => &arguments.common.run,
        Eval::Semantic(arguments) => &arguments.common.run,
        Eval::Registration(arguments) => &arguments.run,
    };
    compute.start_threads()?;
    match command {
        Eval::Repeatability(arguments) => return repeatability::run(arguments),
        Eval::Semantic(arguments) => semantic::run(arguments)?,
        Eval::Registration(arguments) => registration::run(arguments)?,
    }
    Ok(SUCCESS)
}

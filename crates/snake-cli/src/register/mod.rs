//! `snake-cli register`: read, register, write.

pub mod args;

use std::fmt::Write;
use std::path::Path;

use anyhow::{Context, Result, bail};
use snake_core::io;
use snake_core::registration::{Registration, register, transform_points};

use crate::terminal;
use args::RegisterArguments;

/// Finds the transform, writes what was asked for and prints the result.
pub fn run(arguments: &RegisterArguments) -> Result<()> {
    arguments.compute.start_threads()?;
    let RegisterArguments { source, target, output, aligned, .. } = arguments;
    output.as_deref().map_or(Ok(()), io::check_registration_path)?;
    aligned.as_deref().map_or(Ok(()), io::check_cloud_path)?;
    if let Some(input) = output.iter().chain(aligned).find(|path| *path == source || *path == target) {
        bail!("{}: is an input; give another name to write to", input.display());
    }
    let model = arguments.compute.load_model()?;
    let options = arguments.options.resolve();
    terminal::detail("options", || serde_json::to_string(&options).unwrap_or_default());
    let bar = terminal::progress(1)?.with_message(format!("{} to {}", source.display(), target.display()));
    let (source_points, target_points) = (io::read_points(source)?, io::read_points(target)?);
    terminal::detail("points", || format!("{} and {}", source_points.len(), target_points.len()));
    let found = register(&source_points, &target_points, &model, &options)
        .with_context(|| format!("cannot register {} to {}", source.display(), target.display()))?;
    bar.finish_and_clear();
    if let Some(path) = output {
        io::write_registration(path, &found)?;
    }
    if let Some(path) = aligned {
        io::write_points(path, &transform_points(&found.t_target_source, &source_points))?;
    }
    let written: Vec<&Path> = output.iter().chain(aligned).map(AsRef::as_ref).collect();
    if arguments.json {
        return terminal::print(&(serde_json::to_string(&found)? + "\n"));
    }
    terminal::print_report(&text(&found, &written)?)
}

fn text(found: &Registration, written: &[&Path]) -> Result<String> {
    let Registration { t_target_source, num_inliers, num_correspondences, rmse, seconds } = found;
    let mut text = String::from("t_target_source:\n");
    for [a, b, c, d] in t_target_source {
        writeln!(text, "{a:>12.6} {b:>12.6} {c:>12.6} {d:>14.6}")?;
    }
    writeln!(text, "{num_inliers} of {num_correspondences} correspondences agree, RMSE {rmse:.5}, {seconds:.3} s")?;
    for path in written {
        writeln!(text, "written to {}", path.display())?;
    }
    Ok(text)
}

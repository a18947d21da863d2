//! `snake-cli detect`: read, detect, write.

pub mod args;

use std::collections::{BTreeMap, HashSet};
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;

use anyhow::{Context, Result, anyhow, bail};
use clap::ValueEnum;
use console::style;
use serde_json::json;
use snake_core::{Detection, Field, Model, Preset, detect, io};

use crate::inputs::expand;
use crate::terminal;
use crate::timing::{self, STAGES, Seconds};
use args::DetectArguments;

/// Rows of keypoints that the table for people shows.
const TABLE_ROWS: usize = 10;
/// Inputs that the last line of a run names of those that failed.
const NAMED_FAILURES: usize = 10;

/// Processes every input; a bad one is reported and does not stop the rest.
pub fn run(arguments: &DetectArguments) -> Result<ExitCode> {
    arguments.compute.start_threads()?;
    let loading = Instant::now();
    let model = arguments.compute.load_model()?;
    let load_model = loading.elapsed().as_secs_f64();
    let options = arguments.options.resolve(&model)?;
    terminal::detail("options", || serde_json::to_string(&options).unwrap_or_default());
    let inputs = expand(&arguments.inputs)?;
    let outputs = outputs(arguments, &inputs)?;
    let bar = terminal::progress(inputs.len())?;
    let mut failed = Vec::new();
    let mut timings = Vec::new();
    for (index, input) in inputs.iter().enumerate() {
        bar.set_message(input.display().to_string());
        let output = outputs.get(index).map(PathBuf::as_path);
        match process(&model, &options, input, output, arguments.json) {
            Ok((report, seconds)) => {
                timings.push(seconds);
                let print = if arguments.json { terminal::print } else { terminal::print_report };
                bar.suspend(|| {
                    terminal::detail("seconds", || timing::line(&seconds));
                    print(&report)
                })?;
            }
            Err(error) => {
                failed.push(input.display().to_string());
                bar.suspend(|| terminal::error(&error));
            }
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    if !failed.is_empty() && inputs.len() > 1 {
        let more = if failed.len() > NAMED_FAILURES { ", …" } else { "" };
        let names = failed[..failed.len().min(NAMED_FAILURES)].join(", ");
        terminal::error(&anyhow!("{} of {} inputs failed: {names}{more}", failed.len(), inputs.len()));
    }
    if arguments.timing && !timings.is_empty() {
        eprint!("{}", timing::summary(load_model, &timings));
    }
    Ok(ExitCode::from(match failed.len() {
        0 => 0,
        n if n < inputs.len() => 1,
        _ => 2,
    }))
}

/// The file that each input's keypoints go to; empty if they are only printed.
fn outputs(arguments: &DetectArguments, inputs: &[PathBuf]) -> Result<Vec<PathBuf>> {
    let Some(output) = &arguments.output else { return Ok(Vec::new()) };
    let into_directory = output.is_dir() || inputs.len() > 1 || arguments.inputs.iter().any(|input| input.is_dir());
    if !into_directory {
        io::check_keypoint_path(output)?;
        if inputs.contains(output) {
            bail!("{}: is the input; give another --output", output.display());
        }
        return Ok(vec![output.clone()]);
    }
    let extension = arguments.format.to_possible_value().map(|value| value.get_name().to_owned()).unwrap_or_default();
    let name = |input: &PathBuf| {
        let stem = input.file_stem().unwrap_or_default().to_string_lossy();
        output.join(format!("{stem}.keypoints.{extension}"))
    };
    let outputs: Vec<PathBuf> = inputs.iter().map(name).collect();
    let mut seen = HashSet::new();
    if let Some(twice) = outputs.iter().find(|output| !seen.insert(*output)) {
        bail!("{}: two inputs would be written there; run them into different directories", twice.display());
    }
    std::fs::create_dir_all(output).with_context(|| format!("cannot make the directory {}", output.display()))?;
    Ok(outputs)
}

/// One input from file to file; returns what is printed about it, and how long it took.
fn process(
    model: &Model,
    options: &Preset,
    input: &Path,
    output: Option<&Path>,
    json: bool,
) -> Result<(String, Seconds)> {
    let start = Instant::now();
    let points = io::read_points(input)?;
    let read = start.elapsed().as_secs_f64();
    let encoding = Instant::now();
    let field = model.encode(&points, &options.encode).with_context(|| input.display().to_string())?;
    let encode = encoding.elapsed().as_secs_f64();
    let detection = detect(&field, &options.detect)?;
    if let Some(output) = output {
        io::write_keypoints(output, &detection.keypoints)?;
    }
    let (timing, total) = (detection.timing, start.elapsed().as_secs_f64());
    let seconds = [read, encode, timing.occupancy, timing.refine, timing.nms, total];
    let report = if json {
        json_line(input, &field, &detection, &seconds)
    } else {
        table(input, output, &field, &detection, total)?
    };
    Ok((report, seconds))
}

fn json_line(input: &Path, field: &Field, detection: &Detection, seconds: &Seconds) -> String {
    let object = json!({
        "input": input.display().to_string(),
        "num_points": field.points().len(),
        "normalization": field.normalization(),
        "counts": detection.counts,
        "timing_seconds": STAGES.into_iter().zip(seconds).collect::<BTreeMap<_, _>>(),
        "keypoints": detection.keypoints.iter().map(io::keypoint_json).collect::<Vec<_>>(),
    });
    format!("{object}\n")
}

fn table(input: &Path, output: Option<&Path>, field: &Field, detection: &Detection, total: f64) -> Result<String> {
    let (counts, keypoints) = (detection.counts, &detection.keypoints);
    let mut text = format!("{}: {} keypoints from {} points", input.display(), keypoints.len(), field.points().len());
    if field.num_encoded() < field.points().len() {
        write!(text, " ({} encoded)", field.num_encoded())?;
    }
    writeln!(text, " in {total:.3} s")?;
    let (queries, occupied, above) = (counts.queries, counts.occupied, counts.above_threshold);
    writeln!(text, "{queries} queries, {occupied} occupied, {above} above the saliency threshold")?;
    if keypoints.is_empty() {
        let advice = if occupied == 0 { "--occupancy-threshold or --normalization" } else { "--saliency-threshold" };
        writeln!(text, "no keypoints: try {advice}")?;
    } else {
        let [x, y, z] = ["x", "y", "z"];
        let head = format!("{:>4} {x:>12} {y:>12} {z:>12} {:>9} {:>9} {:>8}", "#", "saliency", "occupancy", "nearest");
        writeln!(text, "{}", style(head).bold())?;
    }
    for (rank, k) in keypoints.iter().take(TABLE_ROWS).enumerate() {
        let [x, y, z] = k.position;
        let (saliency, occupancy, nearest) = (k.saliency, k.occupancy, k.nearest_index);
        writeln!(text, "{:>4} {x:>12.5} {y:>12.5} {z:>12.5} {saliency:>9.4} {occupancy:>9.4} {nearest:>8}", rank + 1)?;
    }
    match output {
        Some(output) => writeln!(text, "written to {}", output.display())?,
        None if keypoints.len() > TABLE_ROWS => {
            writeln!(text, "… {} more; -o FILE writes all", keypoints.len() - TABLE_ROWS)?
        }
        None => (),
    }
    Ok(text)
}

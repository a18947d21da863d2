//! `snake-cli view`: read, detect, register two clouds, write a page.

pub mod args;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use serde::Deserialize;
use snake_core::{Chosen, Cloud, Control, Error, Point, Progress};
use snake_io as io;
use snake_view::{Page, ShownCloud, ShownPair};

use crate::output::{check_page_path, write_page};
use crate::setup::detail_of;
use crate::terminal::{self, Report};
use args::ViewArguments;

/// Writes the page and prints a summary.
pub fn run(arguments: &ViewArguments) -> Result<()> {
    let ViewArguments { input, second, output, epsilon, transform, .. } = arguments;
    check_page_path(output)?;
    if second.is_none() && (epsilon.is_some() || transform.is_some()) {
        bail!("--epsilon and --transform need two clouds");
    }
    let inputs = [input].into_iter().chain(second).chain(transform).chain(&arguments.annotations);
    arguments.compute.begin(inputs, [output])?;
    let t_first_second = transform.as_deref().map(io::read_transform).transpose()?;
    let progress = Progress::default();
    let chooser = arguments.compute.chooser(&arguments.options.values())?;
    let control = Control::new().progress(&progress);
    let bar = terminal::stages(&progress)?;
    let read = |input: &PathBuf| arguments.reading.read(input, chooser.seed());
    let name = |input: &PathBuf| input.display().to_string();
    let first_cloud = read(input)?;
    let annotations = arguments.annotations.as_deref().map(|file| annotated(file, input, &first_cloud)).transpose()?;
    let first = chooser.for_cloud(&first_cloud).with_context(|| name(input))?;
    bar.suspend(|| {
        detail_of(&first);
        terminal::hints(&name(input), &first.note);
    });
    let second_cloud = second.as_ref().map(read).transpose()?;
    let mut clouds: Vec<ShownCloud> = Vec::new();
    let mut add = |input: &PathBuf, chosen: &Chosen| -> Result<()> {
        bar.set_message(name(input));
        let shown = ShownCloud::detect(chosen, name(input), &control).with_context(|| name(input))?;
        bar.suspend(|| terminal::hint_findings(&shown.name, &shown.field));
        clouds.push(shown);
        Ok(())
    };
    add(input, &first)?;
    if let (Some(input), Some(cloud)) = (second, &second_cloud) {
        // Both clouds of a pair have the model that suits the first.
        add(input, &first.with_cloud(cloud).with_context(|| name(input))?)?;
    }
    clouds[0].annotations = annotations.unwrap_or_default();
    bar.set_message("registration");
    let pair = match &clouds[..] {
        [first, second] => {
            let pair = ShownPair::aligned([first, second], t_first_second, *epsilon, &control);
            Some(pair.map_err(|error| not_aligned(error, first, second))?)
        }
        _ => None,
    };
    bar.finish();
    let mut report: Report =
        clouds.iter().map(ShownCloud::summary).chain(pair.as_ref().map(ShownPair::summary)).collect();
    let colors = std::array::from_fn(|i| arguments.colormap.color(i as f32 / 255.0));
    let page = Page { clouds, pair, options: first.options, model_name: first.name.clone(), colors };
    let html = page.html()?;
    write_page(output, &html)?;
    report.line(format!("written to {}", output.display()));
    terminal::print_report(&report)
}

/// An entry of an annotation file of KeypointNet; other keys are ignored.
#[derive(Deserialize)]
struct Annotation {
    model_id: String,
    keypoints: Vec<Marked>,
}

#[derive(Deserialize)]
struct Marked {
    pcd_info: MarkedPoint,
}

#[derive(Deserialize)]
struct MarkedPoint {
    point_index: usize,
}

/// The annotated points of a cloud as it was read: those of the entry with its `model_id`, or of the only entry.
fn annotated(file: &Path, input: &Path, cloud: &Cloud) -> Result<Vec<Point>> {
    let model_id = input.file_stem().unwrap_or_default().to_string_lossy();
    let text = std::fs::read_to_string(file).with_context(|| format!("cannot read {}", file.display()))?;
    let mut entries: Vec<Annotation> = serde_json::from_str(&text).with_context(|| file.display().to_string())?;
    if entries.len() != 1 {
        entries.retain(|entry| entry.model_id == model_id);
    }
    let lacking = || format!("{}: no entry with the model_id {model_id}", file.display());
    let entry = entries.pop().with_context(lacking)?;
    let point = |index: usize| {
        let number = cloud.points.len();
        let outside =
            || format!("{}: point_index {index}, but {} has {number} points", file.display(), input.display());
        cloud.points.get(index).copied().with_context(outside)
    };
    entry.keypoints.into_iter().map(|marked| point(marked.pcd_info.point_index)).collect()
}

/// The advice where a registration fails.
fn not_aligned(error: Error, first: &ShownCloud, second: &ShownCloud) -> anyhow::Error {
    let is_no_transform = matches!(error, Error::NoTransform { .. });
    let error = anyhow::Error::from(error);
    if is_no_transform {
        error.context(format!("cannot register {} to {}; --transform FILE gives their poses", second.name, first.name))
    } else {
        error
    }
}

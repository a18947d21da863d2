//! `snake-cli view`: read, detect, register two clouds, write a page.

pub mod args;

use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use snake_core::{Cloud, Control, Error, Progress};
use snake_io as io;
use snake_view::{Page, Pair, ShownCloud};

use crate::inputs::check_inputs;
use crate::output::{InputFiles, check_page_path, write_page};
use crate::setup::Loaded;
use crate::terminal::{self, Report};
use args::ViewArguments;

/// Writes the page and prints a summary.
pub fn run(arguments: &ViewArguments) -> Result<()> {
    arguments.compute.start_threads()?;
    let ViewArguments { input, second, output, epsilon, transform, .. } = arguments;
    check_page_path(output)?;
    if second.is_none() && (epsilon.is_some() || transform.is_some()) {
        bail!("--epsilon and --transform need two clouds");
    }
    check_inputs([input].into_iter().chain(second))?;
    let inputs = [input].into_iter().chain(second).chain(transform).chain(&arguments.compute.model);
    InputFiles::new(inputs).refuse_as_output(output)?;
    let t_first_second = transform.as_deref().map(io::read_transform).transpose()?;
    let progress = Progress::default();
    let models =
        arguments.compute.load_models(arguments.options.suits(), |loaded| arguments.options.resolve(loaded))?;
    let control = Control::new().progress(&progress);
    let bar = terminal::stages(&progress)?;
    let read = |input: &PathBuf| -> Result<Cloud> {
        let encode = &models.first().options.encode;
        Ok(arguments.reading.read(input, encode.seed)?.for_normalization(encode.normalization))
    };
    // Both clouds of a pair have the model that suits the first.
    let first_cloud = read(input)?;
    let Loaded { model, name: model_name, options } = models.for_cloud(&first_cloud.points);
    let second_cloud = second.as_ref().map(read).transpose()?;
    let mut clouds: Vec<ShownCloud> = Vec::new();
    for (input, cloud) in [(input, first_cloud)].into_iter().chain(second.iter().zip(second_cloud)) {
        let name = input.display().to_string();
        bar.set_message(name.clone());
        let shown = ShownCloud::detect(model, options, name.clone(), &cloud, &control);
        let shown = shown.with_context(|| name.clone())?;
        bar.suspend(|| terminal::hint_outliers(&name, &shown.field));
        clouds.push(shown);
    }
    bar.set_message("registration");
    let pair = match &clouds[..] {
        [first, second] => {
            let pair = Pair::aligned([first, second], t_first_second, *epsilon, &control);
            Some(pair.map_err(|error| not_aligned(error, first, second))?)
        }
        _ => None,
    };
    bar.finish();
    let mut report: Report = clouds.iter().map(ShownCloud::summary).chain(pair.as_ref().map(Pair::summary)).collect();
    let colors = std::array::from_fn(|i| arguments.colormap.color(i as f32 / 255.0));
    let page = Page { clouds, pair, options: *options, model_name: model_name.clone(), colors };
    let html = page.html()?;
    write_page(output, &html)?;
    report.line(format!("written to {}", output.display()));
    terminal::print_report(&report)
}

/// The advice where a registration fails.
fn not_aligned(error: Error, first: &ShownCloud, second: &ShownCloud) -> anyhow::Error {
    let is_no_transform = matches!(error, Error::NoTransform { .. });
    let error = anyhow::Error::from(error);
    match is_no_transform {
        true => error
            .context(format!("cannot register {} to {}; --transform FILE gives their poses", second.name, first.name)),
        false => error,
    }
}

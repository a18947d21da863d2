//! `snake-cli view`: read, detect, register two clouds, write a page.

pub mod args;

use std::path::Path;

use anyhow::{Context, Result, bail};
use snake_core::{
    Cloud, Control, Field, Length, Mesh, MeshOptions, Model, Normalization, NormalizationMethod, Options, Point,
    Progress, RigidTransform,
};
use snake_eval::repeated_keypoints;
use snake_io as io;
use snake_registration::{RegisterOptions, register_with};

use crate::inputs::check_inputs;
use crate::model;
use crate::output::InputFiles;
use crate::render::page::{Page, Pair, ShownCloud};
use crate::terminal::{self, Report};
use args::ViewArguments;

/// The most points of a cloud on the page. Larger clouds are subsampled to keep the file small.
const MAX_SHOWN: usize = 400_000;
/// Numbers of samples of the surface along each axis, tried in this order until the mesh has few enough triangles.
const SURFACE_RESOLUTIONS: [usize; 4] = [96, 64, 48, 32];
/// The most triangles of a surface on the page.
const MAX_TRIANGLES: usize = 100_000;

/// Writes the page and prints a summary.
pub fn run(arguments: &ViewArguments) -> Result<()> {
    arguments.compute.start_threads()?;
    let ViewArguments { input, second, output, epsilon, transform, .. } = arguments;
    let extension = output.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    if !["html", "htm"].contains(&extension.as_str()) {
        bail!("{}: unknown extension; files that can be written: .html", output.display());
    }
    if second.is_none() && (epsilon.is_some() || transform.is_some()) {
        bail!("--epsilon and --transform need two clouds");
    }
    check_inputs([input].into_iter().chain(second))?;
    let inputs = [input].into_iter().chain(second).chain(transform).chain(&arguments.compute.model);
    InputFiles::new(inputs).refuse_as_output(output)?;
    let t_first_second = transform.as_deref().map(io::read_transform).transpose()?;
    let progress = Progress::default();
    let model = arguments.compute.load_model()?;
    let control = Control::new().progress(&progress);
    let options = arguments.options.resolve(&model)?;
    terminal::detail("options", || serde_json::to_string(&options).unwrap_or_default());
    let bar = terminal::stages(&progress)?;
    let mut clouds: Vec<ShownCloud> = Vec::new();
    for input in [input].into_iter().chain(second) {
        bar.set_message(input.display().to_string());
        let cloud = arguments.reading.read(input, options.encode.seed)?;
        let cloud = cloud.for_normalization(options.encode.normalization);
        clouds.push(shown(&model, &options, input, &cloud, &control)?);
    }
    bar.set_message("registration");
    let pair = match &clouds[..] {
        [first, second] => Some(pair(&model, first, second, t_first_second, *epsilon, &control)?),
        _ => None,
    };
    bar.finish();
    let mut report: Report = clouds.iter().map(ShownCloud::summary).chain(pair.as_ref().map(Pair::summary)).collect();
    let model_name = model::name(arguments.compute.model.as_deref());
    let page = Page { clouds, pair, options, model_name, colormap: arguments.colormap };
    let html = page.html()?;
    io::write_atomically(output, |file| file.write_all(html.as_bytes()))
        .with_context(|| format!("cannot write {}", output.display()))?;
    report.line(format!("written to {}", output.display()));
    terminal::print_report(&report)
}

/// Encodes one cloud and computes everything that the page shows of it.
fn shown(model: &Model, options: &Options, input: &Path, cloud: &Cloud, control: &Control) -> Result<ShownCloud> {
    let points = &cloud.points;
    let field = model.encode_with(points, &options.encode, control).with_context(|| input.display().to_string())?;
    let detection = match options.window_radius {
        Some(_) => model.detect_with(points, options, control)?,
        None => field.detect_with(&options.detect, control)?,
    };
    let points = field.points();
    let shown: Vec<Point> = points.iter().step_by(points.len().div_ceil(MAX_SHOWN)).copied().collect();
    let surface = surface(&field, control)?;
    let saliency = [field.saliency(&shown)?, field.saliency(&surface.vertices)?];
    let (name, origin) = (input.display().to_string(), cloud.origin);
    Ok(ShownCloud { name, origin, field, shown, surface, saliency, detection })
}

/// The outer surface, at the finest resolution with at most [`MAX_TRIANGLES`] triangles.
fn surface(field: &Field, control: &Control) -> Result<Mesh> {
    let mut mesh = Mesh::default();
    for resolution in SURFACE_RESOLUTIONS {
        mesh = field.mesh_with(&MeshOptions::default().with_resolution(resolution).with_outer(true), control)?;
        if mesh.triangles.len() <= MAX_TRIANGLES {
            break;
        }
    }
    Ok(mesh)
}

/// Aligns the second cloud to the first and finds the keypoints that repeat.
fn pair(
    model: &Model,
    first: &ShownCloud,
    second: &ShownCloud,
    given: Option<RigidTransform>,
    epsilon: Option<Length>,
    control: &Control,
) -> Result<Pair> {
    let radius = Normalization::of(first.field.points(), NormalizationMethod::UnitSphere)?.scale / 2.0;
    let epsilon = epsilon.unwrap_or(Length::Units(0.04 * f64::from(radius)));
    let epsilon = epsilon.in_units("epsilon", first.field.points())?;
    let (near, registration) = match given {
        Some(transform) => (transform.subtract_origins(second.origin, first.origin), None),
        None => {
            let (source, target) = (second.field.points(), first.field.points());
            let found = register_with(source, target, model, &RegisterOptions::default(), control);
            let found = found.with_context(|| {
                format!("cannot register {} to {}; --transform FILE gives their poses", second.name, first.name)
            })?;
            (found.t_target_source, Some(found))
        }
    };
    let [of_first, of_second] = [first, second].map(ShownCloud::keypoint_positions);
    let partners = repeated_keypoints(&of_first, &of_second, &near, epsilon)?;
    let t_first_second = near.add_origins(second.origin, first.origin);
    Ok(Pair { t_first_second, registration, epsilon, partners })
}

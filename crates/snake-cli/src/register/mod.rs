//! `snake-cli register`: read, register, write.

pub mod args;

use std::path::Path;

use anyhow::{Context, Result, bail};
use serde_json::json;
use snake_core::{Control, Error, Progress, RigidTransform};
use snake_io::{self as io, Attributes, Cloud, CloudFormat};
use snake_registration::{Registration, register_with, transform_points};
use snake_view::RegistrationPage;

use crate::inputs::output_origin;
use crate::output::{check_page_path, write_page};
use crate::setup::detail_of;
use crate::terminal::{self, Report};
use crate::{FAILURE, SUCCESS};
use args::RegisterArguments;

/// Finds the transform, writes the output files and prints the result.
pub fn run(arguments: &RegisterArguments) -> Result<u8> {
    let RegisterArguments { source, target, output, aligned, view, .. } = arguments;
    output.as_deref().map_or(Ok(()), io::check_registration_path)?;
    aligned.as_deref().map(CloudFormat::from_path).transpose()?;
    view.as_deref().map_or(Ok(()), check_page_path)?;
    let inputs = [source, target].into_iter().chain(&arguments.initial);
    arguments.compute.begin(inputs, output.iter().chain(aligned).chain(view))?;
    let progress = Progress::default();
    let control = Control::new().progress(&progress);
    let (options, mut pair) = arguments.options()?;
    if pair.estimate_scale && output.as_ref().is_some_and(|path| path.extension().is_some_and(|e| e == "txt")) {
        bail!("four rows of a .txt file do not hold the scale: name a .json file");
    }
    let chooser = arguments.compute.chooser_of_registration(&options)?;
    terminal::detail("options", || serde_json::to_string(&(&options, &pair)).unwrap_or_default());
    let bar = terminal::stages(&progress)?;
    bar.set_message(format!("{} to {}", source.display(), target.display()));
    let read = |path| arguments.input.read_contents(path, options.seed);
    let (source_contents, target_contents) = (read(source)?, read(target)?);
    pair.source_viewpoint = pair.source_viewpoint.or(source_contents.viewpoint);
    pair.target_viewpoint = pair.target_viewpoint.or(target_contents.viewpoint);
    let notes = [source_contents.notes, target_contents.notes];
    let (source_cloud, target_cloud) = (source_contents.cloud, target_contents.cloud);
    terminal::detail("points", || format!("{} and {}", source_cloud.points.len(), target_cloud.points.len()));
    pair.initial = arguments.initial.as_deref().map(io::read_transform).transpose()?;
    pair.place(source_cloud.origin, target_cloud.origin);
    let chosen = chooser.as_ref().map(|chooser| chooser.for_cloud(&target_cloud));
    let chosen = chosen.transpose().with_context(|| target.display().to_string())?;
    chosen.iter().for_each(detail_of);
    let model = chosen.as_ref().map(|chosen| &chosen.model);
    let tried = register_with(&source_cloud.points, &target_cloud.points, model, &options, &pair, &control);
    let fits_none = matches!(tried, Err(Error::NoTransform { .. }));
    let tried = tried.with_context(|| format!("cannot register {} to {}", source.display(), target.display()));
    bar.finish();
    let near = match tried {
        Err(error) if fits_none && arguments.require_reliable => {
            terminal::error(&error);
            return Ok(FAILURE);
        }
        tried => tried?,
    };
    let pose = near.t_target_source;
    let near = near.with_notes_on_clouds([&notes[0], &notes[1]]);
    let registration = near.between_origins(source_cloud.origin, target_cloud.origin);
    let mut attributes = match aligned {
        Some(_) => arguments.input.read_attributes(source, &source_cloud)?,
        None => Attributes::default(),
    };
    // From here on the source has the target's scale.
    attributes.viewpoint.iter_mut().flatten().for_each(|v| *v *= registration.scale);
    let source_cloud = scaled(source_cloud, registration.scale);
    if let Some(path) = output {
        io::write_registration(path, &registration.t_target_source, &registration)?;
    }
    let mut aligned_origin = [0.0; 3];
    if let Some(path) = aligned {
        let moved = transform_points(&pose, &source_cloud.points);
        io::write_cloud(path, &moved, &attributes.transformed(&pose), target_cloud.origin)?;
        aligned_origin = output_origin(path, io::adds_origin(path), target_cloud.origin);
    }
    if let Some(path) = view {
        let names = [target, source].map(|path| path.display().to_string());
        let clouds = [&target_cloud, &source_cloud];
        let page = RegistrationPage { names, clouds, registration: &registration, options, pair_options: pair };
        write_page(path, &page.html()?)?;
    }
    let written: Vec<&Path> = output.iter().chain(aligned).chain(view).map(AsRef::as_ref).collect();
    if arguments.json {
        let mut object = serde_json::to_value(&registration)?;
        if aligned_origin != [0.0; 3] {
            object["aligned_origin"] = json!(aligned_origin);
        }
        terminal::print_json(&object)?;
    } else {
        terminal::print_report(&report(&registration, &written))?;
    }
    let Some(warning) = registration.verdict.warning() else { return Ok(SUCCESS) };
    terminal::warn(&warning);
    Ok(if arguments.require_reliable { FAILURE } else { SUCCESS })
}

/// A cloud whose coordinates, with its origin, are multiplied by a factor.
fn scaled(mut cloud: Cloud, scale: f64) -> Cloud {
    for v in cloud.points.as_flattened_mut() {
        *v = (scale * f64::from(*v)) as f32;
    }
    Cloud { origin: cloud.origin.map(|v| scale * v), ..cloud }
}

fn report(registration: &Registration, written: &[&Path]) -> Report {
    let Registration { t_target_source, verdict, fit, matches, clouds, hypotheses, seconds, .. } = registration;
    let near = fit.inlier_distance;
    let [source, target] = clouds;
    let mut report = Report::default();
    report.line(format!("{}: confidence {:.2}", verdict.word(), verdict.confidence));
    for note in &verdict.notes {
        report.line(note);
    }
    if registration.scale != 1.0 {
        report.line(format!(
            "scale: {:.5}, by which the source is multiplied before t_target_source",
            registration.scale
        ));
    }
    report.line("t_target_source:");
    matrix(&mut report, t_target_source);
    report.line(format!("matches: {} of {} within {near:.5} before ICP", matches.num_inliers, matches.num_matches));
    report.line(format!(
        "result: {:.1} % of the source's voxels within {near:.5} of the target's, {:.5} off by root mean square: {:.2} \
         voxels of {:.5}",
        100.0 * fit.fitness,
        fit.rmse,
        fit.rmse / fit.voxel_size,
        fit.voxel_size
    ));
    let used = clouds.map(|cloud| match (cloud.position, cloud.visible) {
        (Some([x, y, z]), Some(visible)) => {
            let name = cloud.viewpoint.name();
            format!("{name} at ({x:.2}, {y:.2}, {z:.2}), which sees {:.0} % of the points", 100.0 * visible)
        }
        _ => "unknown".into(),
    });
    let violation = 100.0 * verdict.free_space_violation;
    report.line(format!("viewpoints: {}; {}; {violation:.1} % of the voxels in free space", used[0], used[1]));
    for (rank, other) in hypotheses.iter().enumerate().skip(1) {
        report.line(format!("{}. {} matches, score {:.3}:", rank + 1, other.num_inliers, other.score));
        matrix(&mut report, &other.t_target_source);
    }
    report.line(format!("{seconds:.3} s"));
    if source.num_skipped + target.num_skipped > 0 {
        report.line(format!(
            "skipped {} points of the source and {} of the target, which are not finite, outliers or missing returns",
            source.num_skipped, target.num_skipped
        ));
    }
    for path in written {
        report.line(format!("written to {}", path.display()));
    }
    report
}

fn matrix(report: &mut Report, transform: &RigidTransform) {
    for [a, b, c, d] in transform.to_matrix() {
        report.line(format!("{a:>12.6} {b:>12.6} {c:>12.6} {d:>14.6}"));
    }
}

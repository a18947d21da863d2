//! `snake-cli align`: read, align, write.

pub mod args;

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use serde_json::{Value, json};
use snake_core::{Control, Normalization, NormalizationMethod, Point, Progress, RigidTransform};
use snake_io::{self as io, Attributes, Cloud, CloudFormat};
use snake_registration::{AlignPriors, Alignment, Contradiction, align_with, transform_points};

use crate::inputs::{expand, output_origin};
use crate::setup::detail_of;
use crate::terminal::{self, Report};
use crate::{FAILURE, SUCCESS};
use args::AlignArguments;

/// Finds the poses, writes the output files and prints the result.
pub fn run(arguments: &AlignArguments) -> Result<u8> {
    let AlignArguments { output, merged, .. } = arguments;
    if let Some(path) = output.as_ref().filter(|path| path.extension().is_none_or(|extension| extension != "json")) {
        bail!("{}: poses are written as .json", path.display());
    }
    merged.as_deref().map(CloudFormat::from_path).transpose()?;
    let inputs = expand(&arguments.list.extend(&arguments.inputs)?, arguments.input.input_format)?;
    arguments.compute.begin(inputs.iter().chain(&arguments.initial_poses), output.iter().chain(merged))?;
    let (options, align_options) = arguments.options()?;
    let initial_poses = read_initial_poses(arguments.initial_poses.as_deref(), &inputs)?;
    let chooser = arguments.compute.chooser_of_registration(&options)?;
    terminal::detail("options", || serde_json::to_string(&(&options, &align_options)).unwrap_or_default());
    let progress = Progress::default();
    let bar = terminal::stages(&progress)?;
    bar.set_message(format!("{} clouds", inputs.len()));
    let read = |path: &PathBuf| arguments.input.read_contents(path, options.seed);
    let contents = inputs.iter().map(read).collect::<Result<Vec<_>>>()?;
    let viewpoints = contents.iter().map(|contents| contents.viewpoint).collect();
    let mut known = AlignPriors::default().with_viewpoints(viewpoints).with_initial_poses(initial_poses);
    let read = contents.into_iter().map(|contents| (contents.cloud, contents.notes));
    let (clouds, notes): (Vec<Cloud>, Vec<Vec<String>>) = read.unzip();
    let origins: Vec<[f64; 3]> = clouds.iter().map(|cloud| cloud.origin).collect();
    known.place(&origins);
    let points: Vec<&[Point]> = clouds.iter().map(|cloud| &cloud.points[..]).collect();
    let control = Control::new().progress(&progress);
    // `align_with` makes the same check, but its error has only the number of the cloud.
    for (input, points) in inputs.iter().zip(&points) {
        Normalization::of(points, NormalizationMethod::UnitSphere).with_context(|| input.display().to_string())?;
    }
    let first = chooser.as_ref().zip(clouds.first());
    let chosen = first.map(|(chooser, first)| chooser.for_cloud(first)).transpose()?;
    chosen.iter().for_each(detail_of);
    let model = chosen.as_ref().map(|chosen| &chosen.model);
    let near =
        align_with(&points, &known, model, &options, &align_options, &control).context("cannot align the clouds")?;
    bar.finish();

    let mut merged_origin = [0.0; 3];
    if let Some(path) = merged {
        let first = near.parts[0][0];
        let attributes = |&cloud: &usize| {
            let attributes = arguments.input.read_attributes(&inputs[cloud], &clouds[cloud])?;
            Ok(attributes.transformed(&near.poses[cloud].t_part_cloud))
        };
        let attributes: Vec<Attributes> = near.parts[0].iter().map(attributes).collect::<Result<_>>()?;
        io::write_cloud(path, &merge(&near, &points), &Attributes::joined(&attributes), origins[first])?;
        merged_origin = output_origin(path, io::adds_origin(path), origins[first]);
    }
    let alignment = near.between_origins(&origins).with_notes_on_clouds(&notes);
    let object = object(&alignment, &inputs, merged_origin)?;
    if let Some(path) = output {
        let write = |file: &mut dyn Write| writeln!(file, "{object}");
        io::write_atomically(path, write).with_context(|| format!("cannot write {}", path.display()))?;
    }
    if arguments.json {
        terminal::print_json(&object)?;
    } else {
        let written: Vec<&Path> = output.iter().chain(merged).map(AsRef::as_ref).collect();
        terminal::print_report(&report(&alignment, &inputs, &written))?;
    }
    let Some(warning) = alignment.warning() else { return Ok(SUCCESS) };
    terminal::warn(&warning);
    Ok(if arguments.require_connected { FAILURE } else { SUCCESS })
}

/// The poses of the clouds in a file; without one, none.
fn read_initial_poses(file: Option<&Path>, clouds: &[PathBuf]) -> Result<Vec<Option<RigidTransform>>> {
    let Some(file) = file else { return Ok(Vec::new()) };
    let poses = io::read_poses(file)?.for_clouds(file, clouds)?;
    let missing = poses.iter().filter(|pose| pose.is_none()).count();
    if missing > 0 {
        terminal::hint(&format!("{}: no pose of {missing} of {} clouds", file.display(), clouds.len()));
    }
    Ok(poses)
}

/// The points of the largest part in its frame.
fn merge(alignment: &Alignment, clouds: &[&[Point]]) -> Vec<Point> {
    let moved = |&cloud: &usize| transform_points(&alignment.poses[cloud].t_part_cloud, clouds[cloud]);
    alignment.parts[0].iter().flat_map(moved).collect()
}

/// The alignment with the names of the clouds.
fn object(alignment: &Alignment, inputs: &[PathBuf], merged_origin: [f64; 3]) -> Result<Value> {
    let mut object = serde_json::to_value(alignment)?;
    object["clouds"] = inputs.iter().map(|input| input.display().to_string()).collect();
    if merged_origin != [0.0; 3] {
        object["merged_origin"] = json!(merged_origin);
    }
    Ok(object)
}

fn report(alignment: &Alignment, inputs: &[PathBuf], written: &[&Path]) -> Report {
    let Alignment { parts, edges, contradictions, notes, poses, num_pairs, num_skipped, seconds, .. } = alignment;
    let mut report = Report::default();
    let connected = if parts.len() == 1 { "one part".into() } else { format!("{} parts", parts.len()) };
    report.line(format!("{} clouds in {connected}, by {} of {num_pairs} pairs", inputs.len(), edges.len()));
    for (number, part) in parts.iter().enumerate() {
        report.heading(format!("part {number}: {} clouds, in the frame of {}", part.len(), inputs[part[0]].display()));
        for &cloud in part {
            let links = edges.iter().filter(|edge| edge.source == cloud || edge.target == cloud).count();
            let pose = &poses[cloud];
            let variance: f64 = (3..6).map(|axis| pose.covariance[axis][axis]).sum();
            let [[.., x], [.., y], [.., z], _] = pose.t_part_cloud.to_matrix();
            let name = inputs[cloud].display();
            report.line(format!("{x:>12.4} {y:>12.4} {z:>12.4}  ± {:<8.4} {links:>3} edges  {name}", variance.sqrt()));
        }
    }
    for Contradiction { source, target, distance, tolerance, .. } in contradictions {
        let [source, target] = [source, target].map(|&cloud| inputs[cloud].display());
        report.line(format!(
            "left out: {source} to {target} is {distance:.3} from the initial poses, more than {tolerance:.3} (pose_tolerance)"
        ));
    }
    notes.iter().for_each(|note| report.line(note));
    report.line(format!("{seconds:.3} s"));
    let skipped: usize = num_skipped.iter().sum();
    if skipped > 0 {
        report.line(format!("skipped {skipped} points, which are not finite, withheld or outliers"));
    }
    for path in written {
        report.line(format!("written to {}", path.display()));
    }
    report
}

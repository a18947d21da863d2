//! `snake-cli reconstruct`: read, encode, mesh, write.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Context, Result};
use clap::Args;
use serde_json::json;
use snake_core::{Control, MeshOptions, Progress, with_named_values};
use snake_io::{self as io, Contents};

use crate::flags::OptionFlags;
use crate::inputs::{InputArguments, output_origin};
use crate::setup::{ComputeArguments, EncodeFlags, detail_of};
use crate::terminal::{self, Report};

#[derive(Args)]
pub struct ReconstructArguments {
    /// The point cloud, or a mesh, in any format that `detect` reads; `-` is the standard input.
    pub input: PathBuf,
    /// Write the mesh: .ply or .obj with vertex normals, or .stl.
    #[arg(short, long)]
    pub output: PathBuf,
    #[command(flatten)]
    reading: InputArguments,
    /// Print one JSON object on one line instead of text.
    #[arg(long)]
    pub json: bool,
    #[command(flatten)]
    compute: ComputeArguments,
    #[command(flatten)]
    mesh: OptionFlags<MeshOptions>,
    #[command(flatten)]
    encode: EncodeFlags,
}

/// Writes the mesh and prints its size.
pub fn run(arguments: &ReconstructArguments) -> Result<()> {
    let ReconstructArguments { input, output, .. } = arguments;
    io::check_mesh_path(output)?;
    arguments.compute.begin([input], [output])?;
    let options = with_named_values(&MeshOptions::default(), &arguments.mesh.given())?;
    options.check()?;
    let progress = Progress::default();
    let chooser = arguments.compute.chooser(&arguments.encode.values())?;
    let control = Control::new().progress(&progress);
    let bar = terminal::stages(&progress)?;
    bar.set_message(format!("{} ({} samples along each axis)", input.display(), options.resolution));
    let start = Instant::now();
    let Contents { cloud, mut notes, .. } = arguments.reading.read_contents(input, chooser.seed())?;
    let name = input.display().to_string();
    let read = start.elapsed().as_secs_f64();
    let chosen = chooser.for_cloud(&cloud).with_context(|| name.clone())?;
    let origin = chosen.origin;
    let field = chosen.encode(&control).with_context(|| name.clone())?;
    bar.suspend(|| {
        detail_of(&chosen);
        let more: Vec<String> = chosen.note.iter().cloned().chain(field.findings()).collect();
        terminal::hints(&name, &more);
        notes.extend(more);
    });
    let encoded = start.elapsed().as_secs_f64();
    let mesh = field.mesh_with(&options, &control)?;
    let meshed = start.elapsed().as_secs_f64();
    io::write_mesh(output, &mesh, origin)?;
    let total = start.elapsed().as_secs_f64();
    bar.finish();
    let output_origin = output_origin(output, io::adds_origin(output), origin);

    let more = mesh.notes();
    terminal::hints(&name, &more);
    notes.extend(more);
    let (vertices, triangles, area) = (mesh.vertices.len(), mesh.triangles.len(), mesh.area());
    if arguments.json {
        return terminal::print_json(&json!({
            "input": input.display().to_string(),
            "output": output.display().to_string(),
            "num_points": cloud.points.len(),
            "origin": origin,
            "output_origin": output_origin,
            "normalization": field.normalization(),
            "vertices": vertices,
            "triangles": triangles,
            "area": area,
            "notes": notes,
            "timing_seconds": { "read": read, "encode": encoded - read, "mesh": meshed - encoded, "total": total },
        }));
    }
    let mut report = Report::default();
    let num_points = cloud.points.len();
    report.line(format!(
        "{name}: {vertices} vertices, {triangles} triangles, area {area:.5} from {num_points} points in {total:.3} s"
    ));
    report.line(format!("written to {}", output.display()));
    terminal::print_report(&report)
}

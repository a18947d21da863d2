//! `snake-cli field`: pictures and volumes of occupancy and saliency.

pub mod args;

use std::path::Path;

use anyhow::{Context, Result, bail};
use serde_json::json;
use snake_core::{Control, Field, Grid, Progress, add_origin};
use snake_io as io;

use crate::render::figure::{Panel, PanelAxis, figure};
use crate::setup::detail_of;
use crate::terminal;
use args::{FieldArguments, Quantity, Slice};

/// Encodes the cloud, writes the picture or the volume and prints its bounds.
pub fn run(arguments: &FieldArguments) -> Result<()> {
    let FieldArguments { input, output, quantity, resolution, .. } = arguments;
    arguments.compute.begin([input], [output])?;
    let extension = output.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    let one_quantity = match (extension.as_str(), &quantity[..]) {
        ("png", _) => None,
        ("npy", &[quantity]) => Some(quantity),
        ("npy", _) => bail!("{}: a volume holds exactly one --quantity", output.display()),
        _ => bail!("{}: unknown extension; files that can be written: .png, .npy", output.display()),
    };
    let progress = Progress::default();
    let encode = &arguments.encode;
    let chooser = arguments.compute.chooser(&encode.values())?;
    let control = Control::new().progress(&progress);
    let bar = terminal::stages(&progress)?;
    bar.set_message(input.display().to_string());
    let cloud = arguments.reading.read(input, chooser.seed())?;
    let name = input.display().to_string();
    let chosen = chooser.for_cloud(&cloud).with_context(|| name.clone())?;
    detail_of(&chosen);
    let origin = chosen.origin;
    let field = chosen.encode(&control).with_context(|| name.clone())?;
    bar.finish();
    terminal::hints(&name, &chosen.note);
    terminal::hint_findings(&name, &field);
    let grid = field.grid(*resolution)?;
    match one_quantity {
        Some(quantity) => write_volume(output, &field, &grid, quantity)?,
        None => write_picture(output, &field, &grid, origin, arguments)?,
    }
    let (resolution, low, high) = (grid.resolution, add_origin(grid.low, origin), add_origin(grid.high, origin));
    if arguments.json {
        let (input, output) = (input.display().to_string(), output.display().to_string());
        let object = json!({
            "input": input, "output": output, "resolution": resolution, "low": low, "high": high, "origin": origin,
        });
        return terminal::print_json(&object);
    }
    let bounds = |axis: usize| format!("{} from {} to {}", NAMES[axis], short(low[axis]), short(high[axis]));
    let bounds = [0, 1, 2].map(bounds).join(", ");
    let lines = [format!("{resolution} values along {bounds}"), format!("written to {}", output.display())];
    terminal::print_report(&lines.into_iter().collect())
}

const NAMES: [&str; 3] = ["x", "y", "z"];

/// A coordinate with the fewest digits that represent it.
fn short(coordinate: f64) -> String {
    let near = coordinate as f32;
    if f64::from(near) == coordinate { near.to_string() } else { coordinate.to_string() }
}

fn write_volume(output: &Path, field: &Field, grid: &Grid, quantity: Quantity) -> Result<()> {
    let bar = terminal::progress(grid.resolution)?;
    let mut values = Vec::new();
    for z in 0..grid.resolution {
        values.append(&mut quantity.of(field, &grid.plane(2, grid.coordinate(2, z)))?);
        bar.step();
    }
    bar.finish();
    Ok(io::write_volume(output, [grid.resolution; 3], &values)?)
}

/// Writes the picture. The grid is relative to the origin; the axes of the picture have the origin added.
fn write_picture(
    output: &Path,
    field: &Field,
    grid: &Grid,
    origin: [f64; 3],
    arguments: &FieldArguments,
) -> Result<()> {
    let (low, high) = (add_origin(grid.low, origin), add_origin(grid.high, origin));
    let mut rows = Vec::new();
    for &quantity in &arguments.quantity {
        let largest = match arguments.slice {
            None => largest(field, grid, quantity)?,
            Some(_) => Default::default(),
        };
        let panel = |&axis| {
            let axis = axis as usize;
            let name = NAMES[axis];
            let (title, values, position) = match arguments.slice {
                // The clone is needed because an axis may be given twice.
                None => (format!("largest {} along {name}", quantity.name()), largest[axis].clone(), None),
                Some(slice) => {
                    let at = position(slice, axis, [low[axis], high[axis]])?;
                    let near = (at - origin[axis]) as f32;
                    let values = quantity.of(field, &grid.plane(axis, near))?;
                    (format!("{} at {name} = {at:.4}", quantity.name()), values, Some(near))
                }
            };
            let within = Grid::plane_axes(axis);
            let axes = within.map(|axis| PanelAxis { label: NAMES[axis], low: low[axis], high: high[axis] });
            let points = if arguments.no_points { Vec::new() } else { dots(field, origin, axis, position) };
            Ok(Panel { title, values, columns: grid.resolution, axes, points })
        };
        rows.push(arguments.axis.iter().map(panel).collect::<Result<Vec<_>>>()?);
    }
    let canvas = figure(&rows, arguments.colormap);
    io::write_atomically(output, |file| canvas.write_png(file))
        .with_context(|| format!("cannot write {}", output.display()))
}

/// Maximum projections along x, y and z, from one pass over the grid. Each projection has the rows of the higher of its
/// two remaining axes one after the other.
fn largest(field: &Field, grid: &Grid, quantity: Quantity) -> Result<[Vec<f32>; 3]> {
    let resolution = grid.resolution;
    let mut largest: [Vec<f32>; 3] = std::array::from_fn(|_| vec![0.0; resolution * resolution]);
    let bar = terminal::progress(resolution)?;
    for z in 0..resolution {
        let plane = quantity.of(field, &grid.plane(2, grid.coordinate(2, z)))?;
        for (index, value) in plane.into_iter().enumerate() {
            let (x, y) = (index % resolution, index / resolution);
            for (axis, pixel) in [z * resolution + y, z * resolution + x, index].into_iter().enumerate() {
                largest[axis][pixel] = largest[axis][pixel].max(value);
            }
        }
        bar.step();
    }
    bar.finish();
    Ok(largest)
}

/// The coordinate of a slice along an axis, within the bounds of the field.
fn position(slice: Slice, axis: usize, [low, high]: [f64; 2]) -> Result<f64> {
    match slice {
        Slice::Middle => Ok(f64::midpoint(low, high)),
        Slice::At(position) if (low..=high).contains(&position) => Ok(position),
        Slice::At(position) => {
            bail!(
                "--slice is {position}: the field extends from {} to {} along {}",
                short(low),
                short(high),
                NAMES[axis]
            )
        }
    }
}

/// The cloud's points projected along an axis. For a slice, only the points at most one voxel of the network's volume
/// away.
fn dots(field: &Field, origin: [f64; 3], axis: usize, position: Option<f32>) -> Vec<[f64; 2]> {
    let voxel = field.voxel_size_along(axis);
    let is_near = |point: &&[f32; 3]| position.is_none_or(|position| (point[axis] - position).abs() <= voxel);
    let within = Grid::plane_axes(axis);
    let dot = |&point: &[f32; 3]| within.map(|axis| add_origin(point, origin)[axis]);
    field.points().iter().filter(is_near).map(dot).collect()
}

impl Quantity {
    fn of(self, field: &Field, queries: &[[f32; 3]]) -> snake_core::Result<Vec<f32>> {
        match self {
            Self::Occupancy => field.occupancy(queries),
            Self::Saliency => field.saliency(queries),
        }
    }

    fn name(self) -> &'static str {
        match self {
            Self::Occupancy => "occupancy",
            Self::Saliency => "saliency",
        }
    }
}

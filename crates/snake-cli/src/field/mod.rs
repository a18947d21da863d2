//! `snake-cli field`: pictures and volumes of occupancy and saliency.

pub mod args;

use std::path::Path;

use anyhow::{Context, Result, bail};
use indicatif::{ProgressBar, ProgressStyle};
use serde_json::json;
use snake_core::{Field, Grid, io};

use crate::model;
use crate::render::figure::{Panel, PanelAxis, figure};
use args::{FieldArguments, Quantity, Slice};

/// Encodes the cloud, draws or writes what was asked for and says where it lies.
pub fn run(arguments: &FieldArguments) -> Result<()> {
    if let Some(threads) = arguments.threads {
        rayon::ThreadPoolBuilder::new().num_threads(threads.into()).build_global()?;
    }
    let FieldArguments { input, output, quantity, resolution, .. } = arguments;
    if input == output {
        bail!("{}: is the input; give another --output", output.display());
    }
    let extension = output.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    let one_quantity = match (extension.as_str(), &quantity[..]) {
        ("png", _) => None,
        ("npy", &[quantity]) => Some(quantity),
        ("npy", _) => bail!("{}: a volume has one --quantity", output.display()),
        _ => bail!("{}: unknown extension; files that can be written: .png, .npy", output.display()),
    };
    let model = model::load(arguments.model.as_deref())?;
    let options = arguments.encode.resolve(&model)?;
    let points = io::read_points(input)?;
    let field = model.encode(&points, &options.encode).with_context(|| input.display().to_string())?;
    let grid = field.grid(*resolution)?;
    match one_quantity {
        Some(quantity) => write_volume(output, &field, &grid, quantity)?,
        None => write_picture(output, &field, &grid, arguments)?,
    }
    let Grid { resolution, low, high } = grid;
    crate::print(&if arguments.json {
        let (input, output) = (input.display().to_string(), output.display().to_string());
        let object = json!({"input": input, "output": output, "resolution": resolution, "low": low, "high": high});
        format!("{object}\n")
    } else {
        let bounds = |axis: usize| format!("{} from {} to {}", NAMES[axis], low[axis], high[axis]);
        format!(
            "{resolution} values along {}, {}, {}\nwritten to {}\n",
            bounds(0),
            bounds(1),
            bounds(2),
            output.display()
        )
    })
}

const NAMES: [&str; 3] = ["x", "y", "z"];

fn write_volume(output: &Path, field: &Field, grid: &Grid, quantity: Quantity) -> Result<()> {
    let bar = progress(grid.resolution)?;
    io::write_volume(output, [grid.resolution; 3], |z| {
        bar.inc(1);
        quantity.of(field, &grid.plane(2, grid.coordinate(2, z)))
    })?;
    Ok(bar.finish_and_clear())
}

fn write_picture(output: &Path, field: &Field, grid: &Grid, arguments: &FieldArguments) -> Result<()> {
    let FieldArguments { quantity, axis, slice, .. } = arguments;
    let planes = if slice.is_some() { 1 } else { grid.resolution };
    let bar = progress(quantity.len() * axis.len() * planes)?;
    let panel = |quantity, axis| panel(field, grid, quantity, axis as usize, arguments, &bar);
    let row = |&quantity| axis.iter().map(|&axis| panel(quantity, axis)).collect::<Result<Vec<_>>>();
    let rows: Vec<Vec<Panel>> = quantity.iter().map(row).collect::<Result<_>>()?;
    bar.finish_and_clear();
    let canvas = figure(&rows, arguments.colormap);
    io::write_atomically(output, |file| canvas.write_png(file))
        .with_context(|| format!("cannot write {}", output.display()))
}

/// The picture of a quantity along an axis.
fn panel(
    field: &Field,
    grid: &Grid,
    quantity: Quantity,
    axis: usize,
    arguments: &FieldArguments,
    bar: &ProgressBar,
) -> Result<Panel> {
    let name = NAMES[axis];
    let position = arguments.slice.map(|slice| match slice {
        Slice::Middle => f32::midpoint(grid.low[axis], grid.high[axis]),
        Slice::At(position) => position,
    });
    let (title, values) = match position {
        Some(position) if !(grid.low[axis]..=grid.high[axis]).contains(&position) => {
            bail!("--slice {position}: the field reaches from {} to {} along {name}", grid.low[axis], grid.high[axis])
        }
        Some(position) => {
            (format!("{} at {name} = {position:.4}", quantity.name()), quantity.of(field, &grid.plane(axis, position))?)
        }
        None => {
            let mut largest = vec![0.0_f32; grid.resolution * grid.resolution];
            for index in 0..grid.resolution {
                let plane = quantity.of(field, &grid.plane(axis, grid.coordinate(axis, index)))?;
                largest.iter_mut().zip(plane).for_each(|(largest, value)| *largest = largest.max(value));
                bar.inc(1);
            }
            (format!("largest {} along {name}", quantity.name()), largest)
        }
    };
    // A slice shows the points that are at most a voxel of the network's volume away from it.
    let frame = field.volume().frame();
    let near = (grid.high[axis] - grid.low[axis]) / frame.resolution[axis] as f32;
    let is_near = |point: &&[f32; 3]| position.is_none_or(|position| (point[axis] - position).abs() <= near);
    let within = Grid::plane_axes(axis);
    let points = if arguments.no_points { &[] } else { field.points() };
    Ok(Panel {
        title,
        values,
        columns: grid.resolution,
        axes: within.map(|axis| PanelAxis { label: NAMES[axis], low: grid.low[axis], high: grid.high[axis] }),
        points: points.iter().filter(is_near).map(|point| within.map(|axis| point[axis])).collect(),
    })
}

/// Shows itself only on a terminal.
fn progress(planes: usize) -> Result<ProgressBar> {
    let style = ProgressStyle::with_template("{bar:30} {pos}/{len} planes (ETA {eta})")?;
    Ok(ProgressBar::new(planes as u64).with_style(style))
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

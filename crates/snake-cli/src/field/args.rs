//! The command line of `snake-cli field`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};

use crate::inputs::InputArguments;
use crate::render::colormap::Colormap;
use crate::setup::{ComputeArguments, EncodeFlags};

/// A scalar field to show.
#[derive(Clone, Copy, ValueEnum)]
pub enum Quantity {
    Occupancy,
    Saliency,
}

/// An axis of the cloud's frame.
#[derive(Clone, Copy, ValueEnum)]
pub enum Axis {
    X,
    Y,
    Z,
}

/// The position of a slice along its axis.
#[derive(Clone, Copy)]
pub enum Slice {
    Middle,
    At(f64),
}

#[derive(Args)]
pub struct FieldArguments {
    /// The point cloud, or a mesh, in any format that `detect` reads; `-` is the standard input.
    pub input: PathBuf,
    /// Write a picture (.png), or all values of the grid (.npy).
    #[arg(short, long)]
    pub output: PathBuf,
    /// The fields to show; each one is a row of pictures.
    #[arg(long, value_enum, value_delimiter = ',', default_value = "saliency")]
    pub quantity: Vec<Quantity>,
    /// The viewing axes; each one is a column of pictures.
    #[arg(long, value_enum, value_delimiter = ',', default_value = "z")]
    pub axis: Vec<Axis>,
    /// Show the slice at this position along the axis, in cloud units, or in the `middle` of the box [default: the
    /// maximum projection along the axis].
    #[arg(long, value_name = "POSITION", value_parser = slice, allow_hyphen_values = true)]
    pub slice: Option<Slice>,
    /// Number of values along each axis of the grid, 2 to 512.
    #[arg(long, default_value_t = 128)]
    pub resolution: usize,
    /// Colour map of the values, from 0 to 1.
    #[arg(long, value_enum, default_value = "magma")]
    pub colormap: Colormap,
    /// Do not draw the cloud's points. Without this option a picture shows all points, and a slice those near it.
    #[arg(long)]
    pub no_points: bool,
    /// Print one JSON object on one line instead of text.
    #[arg(long)]
    pub json: bool,
    #[command(flatten)]
    pub reading: InputArguments,
    #[command(flatten)]
    pub compute: ComputeArguments,
    #[command(flatten)]
    pub encode: EncodeFlags,
}

fn slice(text: &str) -> Result<Slice, String> {
    match text.parse() {
        _ if text == "middle" => Ok(Slice::Middle),
        Ok(position) if f64::is_finite(position) => Ok(Slice::At(position)),
        _ => Err("expected a number or `middle`".into()),
    }
}

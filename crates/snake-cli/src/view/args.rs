//! The command line of `snake-cli view`.

use std::path::PathBuf;

use clap::Args;
use snake_core::Length;

use crate::detect::args::DetectFlags;
use crate::inputs::InputArguments;
use crate::render::colormap::Colormap;
use crate::setup::ComputeArguments;

#[derive(Args)]
pub struct ViewArguments {
    /// The point cloud, or a mesh, in any format that `detect` reads; `-` is the standard input.
    pub input: PathBuf,
    /// Another, of the same thing, to see which keypoints repeat.
    pub second: Option<PathBuf>,
    /// Write the page (.html).
    #[arg(short, long)]
    pub output: PathBuf,
    /// Of two clouds: keypoints repeat if they are nearer than this to one of the other cloud, in the clouds' units or, as
    /// `3r`, multiples of the first one's resolution [default: 0.04 of the first cloud's radius].
    #[arg(long, value_name = "LENGTH")]
    pub epsilon: Option<Length>,
    /// Of two clouds: the transform that takes a point of the second to the first, as `snake-cli register SECOND FIRST
    /// -o FILE` writes it (.json, .txt); default: it is found by registration.
    #[arg(long, value_name = "FILE")]
    pub transform: Option<PathBuf>,
    /// Colours of saliency, from low to high.
    #[arg(long, value_enum, default_value = "viridis")]
    pub colormap: Colormap,
    #[command(flatten)]
    pub reading: InputArguments,
    #[command(flatten)]
    pub compute: ComputeArguments,
    #[command(flatten)]
    pub options: DetectFlags,
}

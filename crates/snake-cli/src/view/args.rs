//! The command line of `snake-cli view`.

use std::path::PathBuf;

use clap::Args;

use crate::detect::args::DetectFlags;
use crate::render::colormap::Colormap;

#[derive(Args)]
pub struct ViewArguments {
    /// Point cloud (.ply, .pcd, .xyz, .txt, .csv, .pts, .npy).
    pub input: PathBuf,
    /// Another, of the same thing, to see which keypoints repeat.
    pub second: Option<PathBuf>,
    /// Write the page (.html).
    #[arg(short, long)]
    pub output: PathBuf,
    /// Of two clouds: keypoints repeat if they are nearer than this to one of the other cloud, in the clouds' units
    /// [default: 0.04 of the first cloud's radius].
    #[arg(long)]
    pub epsilon: Option<f64>,
    /// Of two clouds: the transform that takes a point of the second to the first, as `snake-cli register SECOND FIRST
    /// -o FILE` writes it (.json, .txt); default: it is found by registration.
    #[arg(long, value_name = "FILE")]
    pub transform: Option<PathBuf>,
    /// Colours of saliency, from low to high.
    #[arg(long, value_enum, default_value = "viridis")]
    pub colormap: Colormap,
    /// Weight file (.safetensors), or the name of a model as in `detect` [default: compact].
    #[arg(long)]
    pub model: Option<PathBuf>,
    /// Threads; default: all processors. The page does not depend on it.
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..))]
    pub threads: Option<u16>,
    #[command(flatten)]
    pub options: DetectFlags,
}

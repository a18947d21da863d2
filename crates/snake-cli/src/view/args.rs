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
    /// A second cloud of the same object or scene, to see which keypoints repeat.
    pub second: Option<PathBuf>,
    /// Write the page to this file (.html).
    #[arg(short, long)]
    pub output: PathBuf,
    /// For two clouds: a keypoint repeats if a keypoint of the other cloud is nearer than this. The distance is in the
    /// clouds' units, or in multiples of the first cloud's resolution (`3r`) [default: 0.04 of the first cloud's
    /// radius].
    #[arg(long, value_name = "LENGTH")]
    pub epsilon: Option<Length>,
    /// For two clouds: the transform that maps a point of the second cloud to the first, in a file as
    /// `snake-cli register SECOND FIRST -o FILE` writes it (.json, .txt) [default: found by registration].
    #[arg(long, value_name = "FILE")]
    pub transform: Option<PathBuf>,
    /// For one cloud: also show these annotated keypoints, in a file as those of KeypointNet. Of several shapes, it is the one whose
    /// `model_id` is the file name of the cloud without extension [default: none].
    #[arg(long, value_name = "FILE", conflicts_with = "second")]
    pub annotations: Option<PathBuf>,
    /// Colour map of the saliency, from 0 to 1.
    #[arg(long, value_enum, default_value = "viridis")]
    pub colormap: Colormap,
    #[command(flatten)]
    pub reading: InputArguments,
    #[command(flatten)]
    pub compute: ComputeArguments,
    #[command(flatten)]
    pub options: DetectFlags,
}

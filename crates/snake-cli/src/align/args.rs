//! The command line of `snake-cli align`.

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use snake_registration::{AlignOptions, RegisterOptions};

use crate::flags::OptionFlags;
use crate::inputs::{InputArguments, ListArgument};
use crate::register::args::RegisterFlags;
use crate::setup::ComputeArguments;

#[derive(Args)]
pub struct AlignArguments {
    /// The clouds, in the same units: files, folders or quoted patterns ('scans/*.pcd'). Those of a folder or a pattern are
    /// sorted by name.
    #[arg(required_unless_present = "input_list")]
    pub inputs: Vec<PathBuf>,
    #[command(flatten)]
    pub list: ListArgument,
    /// Write the poses to this file (.json, with the same content as --json).
    #[arg(short, long)]
    pub output: Option<PathBuf>,
    /// Write the points of all clouds of the largest part, in its frame, to this file (.ply, .pcd, .npy, .xyz or .csv). The
    /// first two and .csv keep colours, intensity and normals that all clouds have.
    #[arg(long, value_name = "FILE")]
    pub merged: Option<PathBuf>,
    /// Exit with code 1 if the clouds are in more than one part. Files are written all the same.
    #[arg(long)]
    pub require_connected: bool,
    /// Start from the poses in this file beside the search, and leave out what contradicts them: .json as `align -o` writes it,
    /// or a trajectory of TUM or KITTI (.txt, .tum). It need not have all clouds.
    #[arg(long, value_name = "FILE")]
    pub initial_poses: Option<PathBuf>,
    #[command(flatten)]
    flags: OptionFlags<AlignOptions>,
    #[command(flatten)]
    pub input: InputArguments,
    /// Print one JSON object on one line instead of text.
    #[arg(long)]
    pub json: bool,
    #[command(flatten)]
    pub compute: ComputeArguments,
    #[command(flatten)]
    register: RegisterFlags,
}

impl AlignArguments {
    /// The defaults, overridden by the command line.
    pub fn options(&self) -> Result<(RegisterOptions, AlignOptions)> {
        self.register.resolve(self.flags.given())
    }
}

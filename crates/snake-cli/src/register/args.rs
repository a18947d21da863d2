//! The command line of `snake-cli register`.

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use snake_core::Length;
use snake_registration::{Axis, KeypointDetector, RegisterOptions};

use crate::inputs::InputArguments;
use crate::set::SetArguments;
use crate::setup::{ComputeArguments, named, override_with};

#[derive(Args)]
pub struct RegisterArguments {
    /// The cloud to align, in any format that `detect` reads; `-` is the standard input.
    pub source: PathBuf,
    /// The cloud to align it to, in the same units.
    pub target: PathBuf,
    /// Write the result to this file: .json has the same content as --json, .txt has the four rows of the matrix.
    #[arg(short, long)]
    pub output: Option<PathBuf>,
    /// Write the source's points in the target's frame to this file (.ply, .pcd, .npy, .xyz or .csv).
    #[arg(long)]
    pub aligned: Option<PathBuf>,
    /// Write a page to this file (.html) that shows the source moved onto the target, with the matches that agree as lines.
    #[arg(long, value_name = "FILE")]
    pub view: Option<PathBuf>,
    /// Start from the transform in this file, as written by `register -o`, and search for no other.
    #[arg(long, value_name = "FILE")]
    pub initial: Option<PathBuf>,
    /// Exit with code 1 if the transform is not reliable or none fits. Files are written if there is a transform.
    #[arg(long)]
    pub require_reliable: bool,
    #[command(flatten)]
    pub input: InputArguments,
    /// Print one JSON object on one line instead of text.
    #[arg(long)]
    pub json: bool,
    #[command(flatten)]
    pub compute: ComputeArguments,
    #[command(flatten)]
    pub options: RegisterFlags,
}

/// Options of registration; an option that is not given keeps its default.
#[derive(Args)]
#[command(
    next_help_heading = "Registration options (LENGTH: in the clouds' units, or multiples of their resolution: 3r)"
)]
pub struct RegisterFlags {
    /// Keypoint detector: voxels (all points of the downsampled clouds), snake (the model), or iss, harris3d, sift3d, fps
    /// or random on the downsampled clouds [default: voxels].
    #[arg(long, value_parser = named::<KeypointDetector>)]
    detector: Option<KeypointDetector>,
    /// Size of the voxels to which both clouds are downsampled for normals, FPFH, ICP and the classical detectors. It
    /// is also the least distance between the keypoints of snake [default: 1/80 of the diameter of the smaller cloud].
    #[arg(long, value_name = "LENGTH")]
    voxel_size: Option<Length>,
    /// The axis that points up in both clouds, x, y or z: the transform is a rotation about it and a translation
    /// [default: any rotation].
    #[arg(long, value_name = "AXIS", value_parser = named::<Axis>)]
    gravity: Option<Axis>,
    #[command(flatten)]
    set: SetArguments,
}

impl RegisterFlags {
    /// The defaults, with the options of the command line in their place.
    pub fn resolve(&self) -> Result<RegisterOptions> {
        let mut options = RegisterOptions::default();
        override_with(&mut options.detector, self.detector);
        override_with(&mut options.voxel_size, self.voxel_size.map(Some));
        override_with(&mut options.gravity, self.gravity.map(Some));
        self.set.apply(&options)
    }
}

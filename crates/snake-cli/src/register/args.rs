//! The command line of `snake-cli register`.

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use serde_json::{Map, Value};
use snake_core::{OptionGroup, with_named_values};
use snake_registration::{PairOptions, RegisterOptions};

use crate::flags::{OF_REGISTRATION, OptionFlags};
use crate::inputs::InputArguments;
use crate::set::SetArguments;
use crate::setup::ComputeArguments;

#[derive(Args)]
pub struct RegisterArguments {
    /// The cloud to align, in any format that `detect` reads; `-` is the standard input.
    pub source: PathBuf,
    /// The cloud to align it to, in the same units.
    pub target: PathBuf,
    /// Write the result to this file: .json has the same content as --json, .txt has the four rows of the matrix.
    #[arg(short, long)]
    pub output: Option<PathBuf>,
    /// Write the source's points in the target's frame to this file (.ply, .pcd, .npy, .xyz or .csv). The first two and .csv keep
    /// colours, intensity and normals.
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
    options: RegisterFlags,
    #[command(flatten)]
    pair: OptionFlags<PairOptions>,
}

impl RegisterArguments {
    /// The defaults, with the options of the command line in their place.
    pub fn options(&self) -> Result<(RegisterOptions, PairOptions)> {
        self.options.resolve(self.pair.given())
    }
}

/// Options of registration, of one pair or of many clouds; an option that is not given keeps its default.
#[derive(Args)]
#[command(next_help_heading = OF_REGISTRATION)]
pub struct RegisterFlags {
    #[command(flatten)]
    flags: OptionFlags<RegisterOptions>,
    #[command(flatten)]
    set: SetArguments,
}

impl RegisterFlags {
    /// The defaults, and those of a second group with its flags, with the options of the command line in their place.
    pub fn resolve<T: OptionGroup + Clone>(&self, flags: Map<String, Value>) -> Result<(RegisterOptions, T)> {
        let given = self.flags.given().into_iter().chain(flags).chain(self.set.given()).collect();
        Ok(with_named_values(&(RegisterOptions::default(), T::default()), &given)?)
    }
}

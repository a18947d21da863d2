//! The command line.

use std::path::PathBuf;

use anyhow::Result;
use clap::{Args, Parser, Subcommand};
use serde::de::DeserializeOwned;
use snake_core::{Model, NormalizationMethod, Preset};

use crate::detect::args::DetectArguments;
use crate::eval::args::Eval;
use crate::reconstruct::ReconstructArguments;
use crate::register::args::RegisterArguments;

/// Repeatable 3-D keypoints from point clouds (SNAKE), on the CPU.
#[derive(Parser)]
#[command(version, arg_required_else_help = true)]
pub struct Arguments {
    #[command(subcommand)]
    pub command: Command,
}

#[derive(Subcommand)]
pub enum Command {
    /// Find the keypoints of point clouds.
    ///
    /// Exit code: 0 if every input was processed, 1 if some failed, 2 if nothing could be done.
    #[command(after_help = "Examples:
  snake-cli detect scan.ply
  snake-cli detect scan.ply -o keypoints.csv --max-keypoints 256 --nms-radius 0.05
  snake-cli detect clouds/ -o results/ --format json
  snake-cli detect scan.ply --json | jq '.keypoints[0]'")]
    Detect(Box<DetectArguments>),
    /// Measure how good keypoints are, beside those of the classical detectors.
    #[command(subcommand)]
    Eval(Eval),
    /// Write the surface of a point cloud as a triangle mesh.
    ///
    /// The surface is where the network's occupancy has the value of --level. It is closed, and in the cloud's frame and
    /// units. Thin shells have two surfaces; --outer removes the inner one.
    #[command(after_help = "Examples:
  snake-cli reconstruct scan.ply -o mesh.ply
  snake-cli reconstruct scan.ply -o mesh.obj --outer --resolution 256
  snake-cli reconstruct scan.ply -o mesh.stl --json | jq .area")]
    Reconstruct(Box<ReconstructArguments>),
    /// Find the rigid transform that brings one cloud onto another.
    ///
    /// Keypoints of both clouds are matched by descriptors, and the transform is what most matches agree on (RANSAC),
    /// refined on the clouds themselves (ICP). Nothing need be known about the poses; the units must be the same.
    /// `t_target_source` takes a point of the source to the target: p_target = R p_source + t.
    ///
    /// Exit code: 0 if a transform was found, 2 if not. Compare the inliers with the correspondences before you trust
    /// it.
    #[command(after_help = "Examples:
  snake-cli register scan2.ply scan1.ply
  snake-cli register scan2.ply scan1.ply -o t_1_2.txt --aligned scan2_in_1.ply
  snake-cli register part.ply whole.ply --voxel-size 0.01 --json | jq .t_target_source")]
    Register(Box<RegisterArguments>),
    /// Show what a weight file is; without FILE, the built-in model.
    Model {
        /// Weight file (.safetensors), or the name of a model as in `detect`.
        file: Option<PathBuf>,
    },
}

/// How a cloud is encoded. What is not given comes from the preset, or from the model's recommended options.
#[derive(Args)]
#[command(next_help_heading = "Encoding options (default: what the model recommends)")]
pub struct EncodeFlags {
    /// Start from the paper's settings for a data set: modelnet40, keypointnet, smpl, redwood or 3dmatch.
    #[arg(long)]
    preset: Option<String>,
    /// unit-sphere: mean to the origin, farthest point to the sphere of radius 0.5; unit-cube: largest coordinate to
    /// the cube ±0.5; none: the cloud is in that cube already.
    #[arg(long, value_parser = named::<NormalizationMethod>)]
    normalization: Option<NormalizationMethod>,
    /// Encode at most this many points, drawn at random.
    #[arg(long)]
    max_points: Option<usize>,
    /// Seed of that draw.
    #[arg(long)]
    seed: Option<u64>,
    /// Average over this many turned copies of the cloud: keypoints repeat far better, at as many times the cost.
    #[arg(long)]
    rotations: Option<usize>,
}

impl EncodeFlags {
    /// Preset or model's recommendation, its encoding overridden by what was given.
    pub fn resolve(&self, model: &Model) -> Result<Preset> {
        let mut preset = match &self.preset {
            Some(name) => Preset::named(name)?,
            None => *model.recommended(),
        };
        override_with(&mut preset.encode.normalization, self.normalization);
        override_with(&mut preset.encode.max_points, self.max_points.map(Some));
        override_with(&mut preset.encode.seed, self.seed);
        override_with(&mut preset.encode.rotations, self.rotations);
        Ok(preset)
    }
}

/// Replaces an option by what was given.
pub fn override_with<T>(option: &mut T, given: Option<T>) {
    if let Some(given) = given {
        *option = given;
    }
}

/// Parses an option's value by the name that it has in weight files and reports.
pub fn named<T: DeserializeOwned>(name: &str) -> Result<T, serde_json::Error> {
    serde_json::from_value(name.into())
}

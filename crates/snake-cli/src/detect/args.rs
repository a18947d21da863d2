//! The command line of `snake-cli detect`.

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use snake_core::{Length, Model, Options, RefineMethod, Selection};
use snake_io::KeypointFormat;

use crate::inputs::InputArguments;
use crate::setup::{ComputeArguments, EncodeFlags, named, none_if_zero, override_with};

#[derive(Args)]
pub struct DetectArguments {
    /// Point clouds (.ply, .pcd, .xyz, .txt, .csv, .pts, .npy, .npz, .las, .laz) and meshes (.ply, .obj, .off, .stl),
    /// directories of them, or quoted patterns: 'scans/**/*.ply'; `-` is the standard input.
    #[arg(required = true)]
    pub inputs: Vec<PathBuf>,
    /// Write the keypoints: to this file (.ply, .pcd, .npy, .csv, .json or .keypointnet.json), or, for several inputs, into
    /// this directory as NAME.keypoints.EXT; `-` is the standard output, and what is printed then goes to the standard
    /// error.
    #[arg(short, long)]
    pub output: Option<PathBuf>,
    /// Number results that would have the same name in the directory, as those of a.las and a.laz: NAME.keypoints.EXT,
    /// NAME.2.keypoints.EXT; otherwise these inputs fail.
    #[arg(long, requires = "output")]
    pub number_results: bool,
    /// Format of the keypoints: ply, pcd, npy, csv, json or keypointnet (its annotations) [default: by the extension of
    /// the output, else ply].
    #[arg(long, value_parser = named::<KeypointFormat>)]
    pub format: Option<KeypointFormat>,
    #[command(flatten)]
    pub input: InputArguments,
    /// Print one JSON object per input, on one line, instead of a table.
    #[arg(long)]
    pub json: bool,
    /// After the last input, print the seconds of each stage to the standard error: of the one cloud, or median,
    /// maximum and sum over several.
    #[arg(long)]
    pub timing: bool,
    #[command(flatten)]
    pub compute: ComputeArguments,
    #[command(flatten)]
    pub options: DetectFlags,
}

/// What is not given comes from the preset, or from the model's recommended options.
#[derive(Args)]
#[command(next_help_heading = "Detection options (default: what the model recommends)")]
pub struct DetectFlags {
    #[command(flatten)]
    encode: EncodeFlags,
    /// Look through balls of this radius that cover the cloud, each encoded by itself, in cloud units or as in `40r`:
    /// for rooms and larger, of which the whole cloud at once shows no details. --normalization is not used then.
    #[arg(long, value_name = "LENGTH")]
    window_radius: Option<Length>,
    /// Queries along each axis of the starting grid.
    #[arg(long)]
    query_resolution: Option<usize>,
    /// Ask only queries at most this many voxels from a voxel with points, along each axis; 0: all. Faster, and hardly
    /// ever different.
    #[arg(long)]
    query_band: Option<usize>,
    /// Refinement steps (J).
    #[arg(long)]
    refine_steps: Option<usize>,
    /// Step size in network units (the cube ±0.5).
    #[arg(long)]
    refine_step_size: Option<f32>,
    /// adam or gradient-descent.
    #[arg(long, value_parser = named::<RefineMethod>)]
    refine_method: Option<RefineMethod>,
    /// best-position, or reference-final-position as the paper's released code.
    #[arg(long, value_parser = named::<Selection>)]
    selection: Option<Selection>,
    /// Queries must be occupied with more than this probability before refinement.
    #[arg(long)]
    occupancy_threshold: Option<f32>,
    /// Refined positions must be occupied with more than this probability.
    #[arg(long)]
    surface_threshold: Option<f32>,
    /// Keypoints must be more salient than this.
    #[arg(long)]
    saliency_threshold: Option<f32>,
    /// Keypoints are farther apart than this, in cloud units, or as in `3r` in multiples of the cloud's resolution (mean
    /// distance between nearest points); 0: no suppression.
    #[arg(long, value_name = "LENGTH")]
    nms_radius: Option<Length>,
    /// At most this many keypoints, the best.
    #[arg(long)]
    max_keypoints: Option<usize>,
    /// Move each keypoint to its nearest input point.
    #[arg(long)]
    snap: bool,
}

impl DetectFlags {
    /// The options of a run: preset or model's recommendation, overridden by what was given.
    pub fn resolve(&self, model: &Model) -> Result<Options> {
        let mut preset = self.encode.resolve(model)?;
        override_with(&mut preset.window_radius, self.window_radius.map(Some));
        let detect = &mut preset.detect;
        override_with(&mut detect.query_resolution, self.query_resolution);
        override_with(&mut detect.query_band, self.query_band);
        override_with(&mut detect.refine_steps, self.refine_steps);
        override_with(&mut detect.refine_step_size, self.refine_step_size);
        override_with(&mut detect.refine_method, self.refine_method);
        override_with(&mut detect.selection, self.selection);
        override_with(&mut detect.occupancy_threshold, self.occupancy_threshold);
        override_with(&mut detect.surface_threshold, self.surface_threshold);
        override_with(&mut detect.saliency_threshold, self.saliency_threshold);
        override_with(&mut detect.nms_radius, self.nms_radius.map(none_if_zero));
        override_with(&mut detect.max_keypoints, self.max_keypoints);
        override_with(&mut detect.snap, self.snap.then_some(true));
        Ok(preset)
    }
}

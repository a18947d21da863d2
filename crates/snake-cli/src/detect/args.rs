//! The command line of `snake-cli detect`.

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use snake_core::{Length, Options, RefineMethod, Selection};
use snake_io::KeypointFormat;

use crate::inputs::InputArguments;
use crate::setup::{ComputeArguments, EncodeFlags, Loaded, named, none_if_zero, override_with};

#[derive(Args)]
pub struct DetectArguments {
    /// Point clouds (.ply, .pcd, .xyz, .txt, .csv, .pts, .asc, .xyzn, .xyzrgb, .xyzi, .npy, .npz, .las, .laz, .e57, .bin of
    /// KITTI and nuScenes), meshes (.ply, .obj, .off, .stl, .gltf, .glb), directories of such files, or quoted patterns:
    /// 'scans/**/*.ply'; `-` is the standard input. Or one recording of ROS (.mcap, .db3, or the folder of a bag), all
    /// clouds of which are processed.
    #[arg(required = true)]
    pub inputs: Vec<PathBuf>,
    /// Write the keypoints to this file (.ply, .pcd, .npy, .csv, .json, .laz, .parquet or .keypointnet.json). For several
    /// inputs, write them to this directory as NAME.keypoints.EXT, for a recording as NAME.000000.keypoints.EXT. `-` is the
    /// standard output; the report then goes to the standard error.
    #[arg(short, long)]
    pub output: Option<PathBuf>,
    /// Number the results of inputs with the same name, such as a.las and a.laz: NAME.keypoints.EXT,
    /// NAME.2.keypoints.EXT. Without this option these inputs fail.
    #[arg(long, requires = "output")]
    pub number_results: bool,
    /// Format of the keypoints: ply, pcd, npy, csv, json, laz, parquet (GeoParquet) or keypointnet (annotations as in
    /// KeypointNet) [default: by the extension of the output, else ply].
    #[arg(long, value_parser = named::<KeypointFormat>)]
    pub format: Option<KeypointFormat>,
    /// The topic of a recording with the point clouds [default: the only topic with point clouds].
    #[arg(long)]
    pub topic: Option<String>,
    #[command(flatten)]
    pub input: InputArguments,
    /// Print one JSON object per input, on one line, instead of a table.
    #[arg(long)]
    pub json: bool,
    /// After the last input, print the seconds of each stage to the standard error. For several clouds, print their
    /// median, maximum and sum.
    #[arg(long)]
    pub timing: bool,
    #[command(flatten)]
    pub tiles: TileArguments,
    #[command(flatten)]
    pub compute: ComputeArguments,
    #[command(flatten)]
    pub options: DetectFlags,
}

/// Detection in tiles.
#[derive(Args)]
#[command(next_help_heading = "Clouds that do not fit into memory")]
pub struct TileArguments {
    /// Detect in tiles of about this side in cloud units, such as 50 for a city in metres. All inputs make up one cloud,
    /// and the keypoints are those of the whole cloud. It needs windows, and lengths in cloud units. All keypoints are kept
    /// unless --max-keypoints is given.
    #[arg(long, value_name = "SIDE", requires = "output", conflicts_with_all = ["json", "timing", "number_results"])]
    pub tile: Option<f64>,
    /// Folder for the points and candidates of the tiles, 20 bytes a point: a new or an empty one, or that of an earlier run,
    /// which continues where it was. The folder stays if it is named here, and is removed after a complete run otherwise
    /// [default: OUTPUT.tiles].
    #[arg(long, value_name = "FOLDER", requires = "tile")]
    pub tile_folder: Option<PathBuf>,
}

/// Options of detection. Each one defaults to the value of the preset, or else to the model's recommended value.
#[derive(Args)]
#[command(next_help_heading = "Detection options (the model recommends the values; those of compact are shown)")]
pub struct DetectFlags {
    #[command(flatten)]
    encode: EncodeFlags,
    /// Split the cloud into overlapping balls of this radius and encode each one separately. Use windows for rooms and
    /// larger scenes, whose details are lost when the whole cloud is encoded at once. The radius is in cloud units, or
    /// in multiples of the cloud's resolution (`40r`). --normalization is ignored with windows [default: no windows].
    #[arg(long, value_name = "LENGTH")]
    window_radius: Option<Length>,
    /// Number of queries along each axis of the initial grid [default: 64].
    #[arg(long)]
    query_resolution: Option<usize>,
    /// Evaluate only queries that are at most this many voxels, along each axis, from a voxel with points; 0 evaluates
    /// all queries. A small band is faster and rarely changes the result [default: 1].
    #[arg(long)]
    query_band: Option<usize>,
    /// Number of refinement steps (J in the paper) [default: 0].
    #[arg(long)]
    refine_steps: Option<usize>,
    /// Step size of the refinement, in network units (the cube ±0.5) [default: 0.001].
    #[arg(long)]
    refine_step_size: Option<f32>,
    /// Optimiser of the refinement: adam or gradient-descent [default: adam].
    #[arg(long, value_parser = named::<RefineMethod>)]
    refine_method: Option<RefineMethod>,
    /// Position that a refined query keeps: best-position, or reference-final-position as in the paper's released code
    /// [default: best-position].
    #[arg(long, value_parser = named::<Selection>)]
    selection: Option<Selection>,
    /// Refine only queries whose occupancy, a probability, is above this threshold [default: 0.5].
    #[arg(long)]
    occupancy_threshold: Option<f32>,
    /// Keep only refined positions whose occupancy, a probability, is above this threshold [default: 0.8].
    #[arg(long)]
    surface_threshold: Option<f32>,
    /// Keep only keypoints whose saliency, 0 to 1, is above this threshold [default: 0.07].
    #[arg(long)]
    saliency_threshold: Option<f32>,
    /// Before suppression, move keypoints to the weighted mean of the candidates within this radius. A length as of
    /// --nms-radius; 0 turns it off [default: 6%].
    #[arg(long, value_name = "LENGTH")]
    mode_radius: Option<Length>,
    /// Radius of non-maximum suppression: keypoints are farther apart than this. The radius is in cloud units, in
    /// multiples of the cloud's resolution, the mean distance between nearest points (`3r`), in per cent of the cloud's
    /// radius (`10%`), or in voxels (`4v`); 0 turns suppression off [default: 10%].
    #[arg(long, value_name = "LENGTH")]
    nms_radius: Option<Length>,
    /// Keep at most this many keypoints, those with the highest saliency [default: 64].
    #[arg(long)]
    max_keypoints: Option<usize>,
    /// Move each keypoint to its nearest input point [default: no].
    #[arg(long)]
    snap: bool,
}

impl DetectFlags {
    /// Whether an option is given that suits only models with a cube.
    pub fn names_a_model(&self) -> bool {
        self.encode.names_a_model() || self.window_radius.is_some()
    }

    /// The number of --max-keypoints, if it is given.
    pub fn max_keypoints(&self) -> Option<usize> {
        self.max_keypoints
    }

    /// The options of a run: the options of the preset or the model, overridden by the command line.
    pub fn resolve(&self, loaded: &Loaded) -> Result<Options> {
        let mut preset = self.encode.resolve(loaded)?;
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
        override_with(&mut detect.mode_radius, self.mode_radius.map(none_if_zero));
        override_with(&mut detect.nms_radius, self.nms_radius.map(none_if_zero));
        override_with(&mut detect.max_keypoints, self.max_keypoints);
        override_with(&mut detect.snap, self.snap.then_some(true));
        Ok(preset)
    }
}

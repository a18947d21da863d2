//! The command line of `snake-cli detect`.

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use snake_core::{Length, Options};
use snake_io::KeypointFormat;

use crate::inputs::InputArguments;
use crate::setup::{ComputeArguments, EncodeFlags, Loaded, Suits, named, none_if_zero, override_with};

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
    /// and the keypoints are those of the whole cloud. It needs a scene model, and --voxel-size for more than 2 million
    /// points. Without --max-keypoints all keypoints are kept.
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
    /// Keep only keypoints whose saliency, 0 to 1, is above this threshold [default: 0.07].
    #[arg(long)]
    saliency_threshold: Option<f32>,
    /// Keep only keypoints of at least this confidence, 0 to 1: the probability that another view finds them again, for models
    /// whose file has a map from saliency to it; 0 keeps all [default: 0].
    #[arg(long, value_name = "PROBABILITY")]
    min_confidence: Option<f32>,
    /// Radius of non-maximum suppression: keypoints are farther apart than this. The radius is in cloud units, in
    /// multiples of the cloud's resolution, the mean distance between nearest points (`3r`), in per cent of the cloud's
    /// radius (`10%`), or in voxels (`4v`); 0 turns suppression off [default: 10%].
    #[arg(long, value_name = "LENGTH")]
    nms_radius: Option<Length>,
    /// Keep at most this many keypoints, those with the highest saliency [default: 64].
    #[arg(long)]
    max_keypoints: Option<usize>,
}

impl DetectFlags {
    /// What the options say of the model where none is named.
    pub fn suits(&self) -> Suits {
        self.encode.suits()
    }

    /// The number of --max-keypoints, if it is given.
    pub fn max_keypoints(&self) -> Option<usize> {
        self.max_keypoints
    }

    /// The options of a run: the options of the preset or the model, with those of the command line in their place.
    pub fn resolve(&self, loaded: &Loaded) -> Result<Options> {
        let mut options = self.encode.resolve(loaded)?;
        let detect = &mut options.detect;
        override_with(&mut detect.saliency_threshold, self.saliency_threshold);
        override_with(&mut detect.min_confidence, self.min_confidence.map(|least| (least != 0.0).then_some(least)));
        override_with(&mut detect.nms_radius, self.nms_radius.map(none_if_zero));
        override_with(&mut detect.max_keypoints, self.max_keypoints);
        Ok(options)
    }
}

//! The command line of `snake-cli detect`.

use std::path::PathBuf;

use clap::Args;
use serde_json::{Map, Value};
use snake_core::DetectOptions;
use snake_io::KeypointFormat;

use crate::flags::OptionFlags;
use crate::inputs::{InputArguments, ListArgument};
use crate::setup::{ComputeArguments, EncodeFlags, named};

#[derive(Args)]
pub struct DetectArguments {
    /// Point clouds (.ply, .pcd, .xyz, .txt, .csv, .pts, .asc, .xyzn, .xyzrgb, .xyzi, .npy, .npz, .las, .laz, .e57, .bin of
    /// KITTI and nuScenes), meshes (.ply, .obj, .off, .stl, .gltf, .glb), directories of such files, or quoted patterns:
    /// 'scans/**/*.ply'; `-` is the standard input. Or one recording of ROS (.mcap), all
    /// clouds of which are processed.
    #[arg(required_unless_present = "input_list")]
    pub inputs: Vec<PathBuf>,
    #[command(flatten)]
    pub list: ListArgument,
    /// Write the keypoints to this file (.ply, .pcd, .npy, .csv, .json, .laz or .keypointnet.json). For several
    /// inputs, write them to this directory as NAME.keypoints.EXT, for a recording as NAME.000000.keypoints.EXT. `-` is the
    /// standard output; the report then goes to the standard error.
    #[arg(short, long)]
    pub output: Option<PathBuf>,
    /// Number the results of inputs with the same name, such as a.las and a.laz: NAME.keypoints.EXT,
    /// NAME.2.keypoints.EXT. Without this option these inputs fail.
    #[arg(long, requires = "output")]
    pub number_results: bool,
    /// Format of the keypoints: ply, pcd, npy, csv, json, laz or keypointnet (annotations as in
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
    pub compute: ComputeArguments,
    #[command(flatten)]
    pub options: DetectFlags,
    #[command(flatten)]
    pub tiles: TileArguments,
}

/// Detection in tiles.
#[derive(Args)]
#[command(next_help_heading = "Clouds that do not fit into memory")]
pub struct TileArguments {
    /// Detect in tiles of about this side in cloud units, such as 50 for a city in metres. All inputs make up one cloud,
    /// and the keypoints are those of the whole cloud. It needs a scene model, and --voxel-size for more than 2 million
    /// points. Their number is not limited by default.
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
pub struct DetectFlags {
    #[command(flatten)]
    encode: EncodeFlags,
    #[command(flatten)]
    detect: OptionFlags<DetectOptions>,
}

impl DetectFlags {
    /// Whether an option is given.
    pub fn has(&self, option: &str) -> bool {
        self.detect.given().contains_key(option) || self.encode.given().contains_key(option)
    }

    /// The options of the command line by name, with the preset.
    pub fn values(&self) -> Map<String, Value> {
        self.encode.values().into_iter().chain(self.detect.given()).collect()
    }
}

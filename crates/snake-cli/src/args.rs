//! The command line.

use std::path::PathBuf;

use clap::{Parser, Subcommand};
use clap_complete::Shell;

use crate::align::args::AlignArguments;
use crate::detect::args::DetectArguments;
use crate::field::args::FieldArguments;
use crate::reconstruct::ReconstructArguments;
use crate::register::args::RegisterArguments;
use crate::terminal::Verbosity;
use crate::view::args::ViewArguments;

/// Repeatable 3-D keypoints from point clouds (SNAKE), on the CPU.
///
/// A neural network encodes the cloud as a field. The field gives the occupancy and the saliency of every point in
/// space, and keypoints are the maxima of saliency on the surface. The model is built in.
#[derive(Parser)]
#[command(
    version,
    name = "snake-cli",
    bin_name = "snake-cli",
    arg_required_else_help = true,
    after_help = "Start here:
  snake-cli detect scan.ply                     print the keypoints of a cloud
  snake-cli detect 'scans/*.pcd' -o keypoints/  write the keypoints of many clouds to files
  snake-cli register scan2.ply scan1.ply        find the transform from one cloud to another
  snake-cli align scans/ --merged map.ply       find the poses of many clouds and merge them
  snake-cli view scan.ply -o report.html        write a web page that shows the cloud and its keypoints
  snake-cli detect --help                       show every option, with examples

Environment:
  SNAKE_MODEL    default of --model: a weight file or the name of a model
  SNAKE_MODELS   folder in which named models are looked up
  SNAKE_THREADS  default of --threads: the number of threads
  SNAKE_SIMD     portable, avx2, avx512 or neon; default: the best level of the processor
  NO_COLOR       turns colours off; colours are only used on a terminal

The command line comes first, then the environment, then what the model recommends."
)]
pub struct Arguments {
    #[command(subcommand)]
    pub command: Command,
    /// Print errors only: no tables, warnings or progress. Files are still written, and --json is still printed.
    #[arg(short, long, global = true, conflicts_with = "verbose", help_heading = "Global options")]
    quiet: bool,
    /// Also print to the standard error: the loaded model, the options in effect and the seconds of each stage.
    #[arg(short, long, global = true, help_heading = "Global options")]
    verbose: bool,
}

impl Arguments {
    /// How much to print.
    pub fn verbosity(&self) -> Verbosity {
        match (self.quiet, self.verbose) {
            (true, _) => Verbosity::Quiet,
            (_, true) => Verbosity::Verbose,
            _ => Verbosity::Normal,
        }
    }
}

#[derive(Subcommand)]
pub enum Command {
    /// Find the poses of many clouds that overlap in part, and merge them.
    ///
    /// Pairs of clouds with similar descriptors are registered as by `register`. Transforms that are reliable, or that loops
    /// of three prove, become the edges of a pose graph. Clouds that no edges connect are reported as different parts, each
    /// with a frame of its own. `t_part_cloud` maps a point of a cloud into the frame of the first cloud of its part.
    ///
    /// Exit code: 0, or 1 if there are several parts and --require-connected is given, or 2 after an error.
    #[command(after_help = "Examples:
  snake-cli align scans/
  snake-cli align scans/ -o poses.json --merged map.ply
  snake-cli align 'scans/*.pcd' --gravity z --json | jq '.poses[1].t_part_cloud'")]
    Align(Box<AlignArguments>),
    /// Find the keypoints of point clouds.
    ///
    /// Exit code: 0 if every input was processed, 1 if some failed, 2 if all failed or the command could not start.
    #[command(after_help = "Examples:
  snake-cli detect scan.ply
  snake-cli detect scan.ply -o keypoints.csv --max-keypoints 256 --nms-radius 0.05
  snake-cli detect clouds/ -o results/ --format json
  snake-cli detect part.stl --sample 20000 -o keypoints.ply
  snake-cli detect room.pcd -o keypoints.ply --voxel-size 0.04 --set snap=true
  snake-cli detect - --input-format xyz -o - --format csv < scan.txt > keypoints.csv
  snake-cli detect city.laz --tile 50 -o keypoints.laz
  snake-cli detect scan.ply --json | jq '.keypoints[0]'")]
    Detect(Box<DetectArguments>),
    /// Draw the occupancy or saliency field of a cloud, or write its values on a grid.
    ///
    /// A picture (.png) is a maximum projection along an axis, as in the paper's figures, or a slice (--slice). The
    /// cloud's points are drawn over it. Axes are in the cloud's frame and units.
    ///
    /// A volume (.npy) is a float32 array `[z][y][x]` with N values along each axis (--resolution). It covers the box
    /// that the network encodes. The command prints the corners `low` and `high` of that box: index i along x is at
    /// low.x + i (high.x - low.x) / (N - 1), and likewise for y and z.
    #[command(after_help = "Examples:
  snake-cli field scan.ply -o saliency.png
  snake-cli field scan.ply -o all.png --quantity occupancy,saliency --axis x,y,z
  snake-cli field scan.ply -o slice.png --quantity occupancy --axis y --slice 0.25 --colormap viridis
  snake-cli field scan.ply -o saliency.npy --resolution 64 --json | jq '.low, .high'")]
    Field(Box<FieldArguments>),
    /// Write the surface of a point cloud as a triangle mesh.
    ///
    /// The surface is the level set of the occupancy at --level. The mesh is closed and in the cloud's frame and units.
    /// A thin shell has two surfaces; --outer removes the inner one.
    #[command(after_help = "Examples:
  snake-cli reconstruct scan.ply -o mesh.ply
  snake-cli reconstruct scan.ply -o mesh.obj --outer --resolution 256
  snake-cli reconstruct scan.ply -o mesh.stl --json | jq .area")]
    Reconstruct(Box<ReconstructArguments>),
    /// Find the rigid transform that brings one cloud onto another.
    ///
    /// The command matches descriptors of both clouds. Transforms on which many matches agree are compared on the clouds,
    /// and ICP refines the best. The poses may be arbitrary, but both clouds must have the same units. `t_target_source`
    /// maps a point of the source into the target's frame: p_target = R p_source + t.
    ///
    /// The first line says whether the transform is reliable (of rooms: within 15 degrees and 0.3 m of the truth), and with what
    /// confidence, 0 to 1. The inliers are the matches that agree with the transform before ICP. The result after ICP has a
    /// figure of its own: the share of the source's voxels near a voxel of the target.
    ///
    /// Exit code: 0 if a transform was found, 1 if it is not reliable and --require-reliable is given, 2 otherwise. A
    /// transform that is not reliable is a result too: a person may look at it, and another program may check it in its own
    /// way. So the exit code is 0 unless you ask, with a warning. A robot should ask.
    #[command(after_help = "Examples:
  snake-cli register scan2.ply scan1.ply
  snake-cli register scan2.ply scan1.ply -o t_1_2.txt --aligned scan2_in_1.ply
  snake-cli register part.ply whole.ply --voxel-size 0.01 --json | jq .t_target_source")]
    Register(Box<RegisterArguments>),
    /// Write a web page that shows the cloud, its saliency, keypoints and surface.
    ///
    /// The page is one file and works offline. Given two clouds, it shows both, aligned or side by side, and links the
    /// keypoints that repeat. The second cloud is aligned to the first by registration (as
    /// `snake-cli register SECOND FIRST`) or by --transform.
    #[command(after_help = "Examples:
  snake-cli view scan.ply -o report.html
  snake-cli view scan.ply -o report.html --max-keypoints 256 --nms-radius 0.05
  snake-cli view scan1.ply scan2.ply -o pair.html --epsilon 0.05
  snake-cli register scan2.ply scan1.ply -o t.json && snake-cli view scan1.ply scan2.ply --transform t.json -o pair.html")]
    View(Box<ViewArguments>),
    /// Show the network, the recommended options and the metadata of a model.
    #[command(after_help = "Examples:
  snake-cli model
  snake-cli model standard
  snake-cli model weights.safetensors")]
    Model {
        /// Weight file (.safetensors), or the name of a model as in `detect` [default: compact].
        #[arg(env = "SNAKE_MODEL", hide_env_values = true)]
        file: Option<PathBuf>,
    },
    /// List the options that --set and Python take, with their values.
    #[command(after_help = "Examples:
  snake-cli options
  snake-cli detect scan.ply --set mode_radius=4% --set snap=true")]
    Options,
    /// Print the JSON schema of a line of `detect --json`.
    #[command(after_help = "Examples:
  snake-cli schema > detect.schema.json")]
    Schema,
    /// Print the script with which a shell completes the options of snake-cli.
    #[command(after_help = "Examples:
  snake-cli completions bash > ~/.local/share/bash-completion/completions/snake-cli
  snake-cli completions zsh > ~/.zfunc/_snake-cli                  (a folder of $fpath)
  snake-cli completions fish > ~/.config/fish/completions/snake-cli.fish
  snake-cli completions powershell >> $PROFILE")]
    Completions {
        /// The shell.
        shell: Shell,
    },
}

//! The command line.

use std::path::PathBuf;

use clap::{Parser, Subcommand};
use clap_complete::Shell;

use crate::detect::args::DetectArguments;
use crate::eval::args::Eval;
use crate::field::args::FieldArguments;
use crate::reconstruct::ReconstructArguments;
use crate::register::args::RegisterArguments;
use crate::terminal::Verbosity;
use crate::view::args::ViewArguments;

/// Repeatable 3-D keypoints from point clouds (SNAKE), on the CPU.
///
/// A network turns a cloud into a field that says where there is surface and where keypoints are. Files in, keypoints
/// or transforms out; the model is built in.
#[derive(Parser)]
#[command(
    version,
    bin_name = "snake-cli",
    arg_required_else_help = true,
    after_help = "Start here:
  snake-cli detect scan.ply                     the keypoints of a cloud
  snake-cli detect 'scans/*.pcd' -o keypoints/  those of many, into files
  snake-cli register scan2.ply scan1.ply        the transform from one cloud to another
  snake-cli view scan.ply -o report.html        a page to look at them in a browser
  snake-cli detect --help                       every option, with examples

Environment:
  SNAKE_MODEL    weight file or name of a model, for --model
  SNAKE_MODELS   folder of models that have a name
  SNAKE_THREADS  number of threads, for --threads
  SNAKE_SIMD     portable, avx2 or avx512; default: the best that the processor has
  NO_COLOR       no colours; there are none where the output is not a terminal"
)]
pub struct Arguments {
    #[command(subcommand)]
    pub command: Command,
    /// Only errors: no tables, no warnings, no progress. Files are written and --json printed as ever.
    #[arg(short, long, global = true, conflicts_with = "verbose", help_heading = "Global options")]
    quiet: bool,
    /// Also say, on the standard error, what is loaded, the options in effect and the seconds of each stage.
    #[arg(short, long, global = true, help_heading = "Global options")]
    verbose: bool,
}

impl Arguments {
    /// How much is to be said.
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
    /// Find the keypoints of point clouds.
    ///
    /// Exit code: 0 if every input was processed, 1 if some failed, 2 if nothing could be done.
    #[command(after_help = "Examples:
  snake-cli detect scan.ply
  snake-cli detect scan.ply -o keypoints.csv --max-keypoints 256 --nms-radius 0.05
  snake-cli detect clouds/ -o results/ --format json
  snake-cli detect part.stl --sample 20000 -o keypoints.ply
  snake-cli detect room.pcd -o keypoints.ply --window-radius 1 --nms-radius 0.2
  snake-cli detect - --input-format xyz -o - --format csv < scan.txt > keypoints.csv
  snake-cli detect scan.ply --json | jq '.keypoints[0]'")]
    Detect(Box<DetectArguments>),
    /// Measure how good keypoints are, beside those of the classical detectors.
    #[command(subcommand)]
    Eval(Eval),
    /// Draw the occupancy or saliency field of a cloud, or write its values on a grid.
    ///
    /// A picture (.png) shows for each pixel the largest value along an axis, as in the paper's figures, or a slice, with
    /// the cloud's points over it. Axes are in the cloud's frame and units.
    ///
    /// A volume (.npy) is a float32 array [z][y][x] of N values along each axis (--resolution), over the box that the
    /// network sees. What is printed says where the box lies: index i along x is at low.x + i (high.x - low.x) / (N - 1),
    /// and likewise for y and z.
    #[command(after_help = "Examples:
  snake-cli field scan.ply -o saliency.png
  snake-cli field scan.ply -o all.png --quantity occupancy,saliency --axis x,y,z
  snake-cli field scan.ply -o slice.png --quantity occupancy --axis y --slice 0.25 --colormap viridis
  snake-cli field scan.ply -o saliency.npy --resolution 64 --json | jq '.low, .high'")]
    Field(Box<FieldArguments>),
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
    /// Before you trust it: RANSAC's inliers are the correspondences that its transform brings together; their RMSE says
    /// how far apart keypoints of one place are found. The result, after ICP, is judged by the share of the source's
    /// voxels that are near the target's, and by their RMSE.
    ///
    /// Exit code: 0 if a transform was found, 2 if not.
    #[command(after_help = "Examples:
  snake-cli register scan2.ply scan1.ply
  snake-cli register scan2.ply scan1.ply -o t_1_2.txt --aligned scan2_in_1.ply
  snake-cli register part.ply whole.ply --voxel-size 0.01 --json | jq .t_target_source")]
    Register(Box<RegisterArguments>),
    /// Write a page with the cloud, its saliency, keypoints and surface, to look at in a browser.
    ///
    /// The page is one file that needs no network. Of two clouds it shows both, side by side as they lie on one another,
    /// and links the keypoints that repeat. The second is brought onto the first by registration (as
    /// `snake-cli register SECOND FIRST`), or by a transform that is given.
    #[command(after_help = "Examples:
  snake-cli view scan.ply -o report.html
  snake-cli view scan.ply -o report.html --max-keypoints 256 --nms-radius 0.05
  snake-cli view scan1.ply scan2.ply -o pair.html --epsilon 0.05
  snake-cli register scan2.ply scan1.ply -o t.json && snake-cli view scan1.ply scan2.ply --transform t.json -o pair.html")]
    View(Box<ViewArguments>),
    /// Show what a weight file is; without FILE, the built-in model.
    #[command(after_help = "Examples:
  snake-cli model
  snake-cli model standard
  snake-cli model weights.safetensors")]
    Model {
        /// Weight file (.safetensors), or the name of a model as in `detect`.
        #[arg(env = "SNAKE_MODEL", hide_env_values = true)]
        file: Option<PathBuf>,
    },
    /// Print what makes a shell complete the options of snake-cli.
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

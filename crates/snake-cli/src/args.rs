//! The command line.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Result, bail};
use clap::{Args, Parser, Subcommand};
use clap_complete::Shell;
use serde::de::DeserializeOwned;
use snake_core::{Model, NormalizationMethod, Preset, SimdLevel};

use crate::detect::args::DetectArguments;
use crate::eval::args::Eval;
use crate::field::args::FieldArguments;
use crate::model;
use crate::reconstruct::ReconstructArguments;
use crate::register::args::RegisterArguments;
use crate::terminal::{self, Verbosity};
use crate::view::args::ViewArguments;

/// Repeatable 3-D keypoints from point clouds (SNAKE), on the CPU.
///
/// A network turns a cloud into a field that says where there is surface and where keypoints are. Files in, keypoints
/// or transforms out; the model is built in.
#[derive(Parser)]
#[command(
    version,
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
    /// Exit code: 0 if a transform was found, 2 if not. Compare the inliers with the correspondences before you trust
    /// it.
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
        #[arg(env = "SNAKE_MODEL")]
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

/// Threads at most, where there are not more processors: a thousand on few processors only wait for each other.
const MAX_THREADS: usize = 256;

/// What every sub-command that computes takes.
#[derive(Args)]
pub struct ComputeArguments {
    /// Weight file (.safetensors), or the name of a model: compact (for objects), standard (for objects, better and
    /// slower) and rooms (for rooms in metres) are built in, another is that of a file in SNAKE_MODELS, beside the program
    /// or in the user's data folder [default: compact].
    #[arg(long, value_name = "MODEL", env = "SNAKE_MODEL")]
    pub model: Option<PathBuf>,
    /// Threads, at most 256 or the number of processors; default: all processors. The result does not depend on it.
    #[arg(long, value_name = "NUMBER", env = "SNAKE_THREADS", value_parser = clap::value_parser!(u16).range(1..))]
    pub threads: Option<u16>,
}

impl ComputeArguments {
    /// Starts the threads; before anything is computed.
    pub fn start_threads(&self) -> Result<()> {
        if let Some(threads) = self.threads {
            let most = std::thread::available_parallelism().map_or(1, usize::from).max(MAX_THREADS);
            if usize::from(threads) > most {
                bail!("--threads is {threads}: allowed is 1 to {most}");
            }
            rayon::ThreadPoolBuilder::new().num_threads(threads.into()).build_global()?;
        }
        let simd = SimdLevel::current().name();
        let wanted = std::env::var("SNAKE_SIMD").unwrap_or_default();
        if !wanted.is_empty() && wanted != simd {
            let names: Vec<&str> = SimdLevel::available().into_iter().map(SimdLevel::name).collect();
            terminal::warn(&format!("SNAKE_SIMD is {wanted}, not {}; {simd} is used", names.join(" or ")));
        }
        terminal::detail("threads", || format!("{}, SIMD {simd}", rayon::current_num_threads()));
        Ok(())
    }

    /// Loads the model of `--model`, by default the built-in one.
    pub fn load_model(&self) -> Result<Model> {
        let start = Instant::now();
        let model = model::load(self.model.as_deref())?;
        terminal::detail("model", || {
            let (name, parameters) = (model::name(self.model.as_deref()), model.num_parameters());
            format!("{name}, {parameters} parameters, {:.3} s", start.elapsed().as_secs_f64())
        });
        Ok(model)
    }
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
    /// Encode at most this many points, drawn at random; the report says how many.
    #[arg(long)]
    max_points: Option<usize>,
    /// Seed of that draw, and of --sample.
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

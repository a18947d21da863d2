//! The command line.

use std::path::PathBuf;

use anyhow::Result;
use clap::{Args, Parser, Subcommand, ValueEnum};
use serde::de::DeserializeOwned;
use snake_core::registration::{Descriptor, KeypointDetector, RegisterOptions};
use snake_core::{Model, NormalizationMethod, Preset, RefineMethod, Selection};

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
        /// Weight file (.safetensors).
        file: Option<PathBuf>,
    },
}

#[derive(Subcommand)]
pub enum Eval {
    /// Relative repeatability: the share of keypoints that a second view finds again.
    ///
    /// DATA is objects or pairs of clouds. Objects are cloud files, a folder of them, or a folder with points.npy of shape
    /// (S, N, 3) and index.json. An object's radius is brought to 1, and its second view is turned at random and sampled
    /// anew. Pairs are a folder of one of these layouts:
    ///
    /// pairs.json: [{"source": "a.ply", "target": "b.ply", "T": [[..4], ..4]}, ..], in metres. T takes the source to the
    /// target, and the target is the first view.
    ///
    /// ModelNet40 as USIP has it: original/0.npy, 1.npy, .. of shape (N, 3) or more columns, rotated/ the same, and
    /// transform.npy of shape (S, 3, 4) or (S, 4, 4), whose row i takes the rotated object i to the original.
    ///
    /// Redwood as USIP has it: SCENE/0.npy, 1.npy, .., redwood_pair.txt of the released code with lines "SCENE i j", and
    /// transform.npy with a row for each line, which takes cloud j to cloud i, the first view.
    ///
    /// Every method sees the same views: undisturbed, then at each down-sampling, then at each noise. The defaults are
    /// those of the paper's tables: for ModelNet40 with objects, for Redwood with rooms.
    #[command(after_help = "Examples:
  snake-cli eval repeatability corpus/objects/val -o results/
  snake-cli eval repeatability my_scans/ --methods snake,iss,random --downsample 1 --noise 0
  snake-cli eval repeatability scenes/val -o results/ --preset redwood --nms-radius 0.04")]
    Repeatability(Box<RepeatabilityArguments>),
    /// Registration of scene fragments by the rules of the 3DMatch benchmark, of every detector and descriptor.
    ///
    /// DATA is a folder with a pairs.json, as of `eval repeatability`; a scene of the benchmark, fragments
    /// cloud_bin_0.ply, .. with gt.log and gt.info beside them or in the folder SCENE-evaluation; or a folder of such
    /// scenes. Fragments of a pairs.json that are called SCENE and a number belong to that scene. Lengths are metres.
    ///
    /// Figures are means over the scenes. Feature matching recall: pairs of which more than 0.05 of the
    /// correspondences are within 0.1 m. Registration recall: pairs, consecutive fragments left out, that RANSAC
    /// places with an RMSE of at most 0.2 m by the information matrix of gt.info; for pairs.json, of the points that
    /// have a partner within 0.05 m.
    #[command(after_help = "Examples:
  snake-cli eval registration scenes/val -o results/
  snake-cli eval registration 3dmatch/fragments --detectors snake,fps,random --descriptors fpfh --keypoints 1000,250")]
    Registration(Box<RegistrationArguments>),
    /// Semantic consistency: mIoU of keypoints with those that people marked, or of two poses of a body.
    ///
    /// DATA is a folder of one of these layouts:
    ///
    /// KeypointNet: annotations/CLASS.json, lists of {"class_id", "model_id", "keypoints": [{"pcd_info":
    /// {"point_index"}}, ..]}, and pcds/CLASS_ID/MODEL_ID.pcd, or without pcds/. An all.json is not read. Distances are
    /// geodesic; the figure is the mean of the classes' IoU. For the paper's 630 shapes give --split the first 630 lines
    /// of the released code's list.
    ///
    /// SMPL: body_1.npy and body_2.npy of shape (S, N, 3), the same N places of a body's surface in two poses, of S
    /// pairs. The body model itself (model.pkl) is not read: pose and sample it with its own tools. Distances are
    /// straight; the best 20 keypoints count.
    ///
    /// Each figure is given by two rules. strict: points that no path joins never match; bodies have as many keypoints as
    /// were found; pairs are averaged. paper, as in the released code: such points always match; bodies are filled up to
    /// 20 with random points; the running IoU is averaged.
    #[command(after_help = "Examples:
  snake-cli eval semantic keypointnet/ --split test_630.txt --paper -o results/
  snake-cli eval semantic bodies/ --methods snake,iss,random")]
    Semantic(Box<SemanticArguments>),
}

#[derive(Args)]
pub struct RegistrationArguments {
    /// What to evaluate on.
    pub data: PathBuf,
    /// Among snake, iss, harris3d, sift3d, fps and random.
    #[arg(long, value_delimiter = ',', value_parser = named::<KeypointDetector>,
        default_value = "snake,iss,harris3d,sift3d,fps,random")]
    pub detectors: Vec<KeypointDetector>,
    /// Among field and fpfh.
    #[arg(long, value_delimiter = ',', value_parser = named::<Descriptor>, default_value = "field,fpfh")]
    pub descriptors: Vec<Descriptor>,
    /// Numbers of keypoints of each cloud, the best.
    #[arg(long, value_delimiter = ',', default_value = "2500,1000,500,250,100")]
    pub keypoints: Vec<usize>,
    #[command(flatten)]
    pub run: RunArguments,
}

#[derive(Args)]
pub struct RepeatabilityArguments {
    /// What to evaluate on.
    #[arg(required = true)]
    pub data: Vec<PathBuf>,
    /// Distances at which a keypoint is found again [default: 0.03 to 0.1, rooms: 0.1 to 0.24].
    #[arg(long, value_delimiter = ',')]
    pub epsilon: Option<Vec<f64>>,
    /// The epsilon of the tables over down-sampling and noise [default: 0.04, rooms: 0.2].
    #[arg(long)]
    pub table_epsilon: Option<f64>,
    /// Rates of down-sampling.
    #[arg(long, value_delimiter = ',', default_value = "1,2,4,8,16")]
    pub downsample: Vec<usize>,
    /// Standard deviations of Gaussian noise [default: 0 to 0.12, rooms: 0 to 0.1].
    #[arg(long, value_delimiter = ',')]
    pub noise: Option<Vec<f64>>,
    /// Points of each view, drawn at random [default: 5000, rooms: 10240].
    #[arg(long)]
    pub num_points: Option<usize>,
    #[command(flatten)]
    pub common: EvalArguments,
}

#[derive(Args)]
pub struct SemanticArguments {
    /// What to evaluate on.
    pub data: PathBuf,
    /// Only the shapes of KeypointNet that this file lists, a CLASS_ID-MODEL_ID on each line.
    #[arg(long)]
    pub split: Option<PathBuf>,
    /// Distances at which keypoints are the same.
    #[arg(long, value_delimiter = ',', default_value = "0,0.01,0.02,0.03,0.04,0.05,0.06,0.07,0.08,0.09,0.1")]
    pub threshold: Vec<f64>,
    #[command(flatten)]
    pub common: EvalArguments,
}

/// What all evaluations have.
#[derive(Args)]
pub struct EvalArguments {
    /// Among snake, iss, harris3d, sift3d, fps and random.
    #[arg(long, value_delimiter = ',', default_value = "snake,iss,harris3d,sift3d,fps,random")]
    pub methods: Vec<String>,
    /// How the classical detectors pick keypoints: ranked, the strongest responses; or paper, as in the paper's
    /// tables: a random subset, of Harris 3D without suppression and SIFT 3D on the y coordinate.
    #[arg(long, value_enum, default_value = "ranked")]
    pub protocol: ProtocolName,
    /// Keypoints of each cloud, the best.
    #[arg(long, default_value_t = 64)]
    pub count: usize,
    /// Show the paper's figures for its own data sets where there are any, marked as the paper's.
    #[arg(long)]
    pub paper: bool,
    /// The paper's settings of the method snake for a data set; default: what the model recommends.
    #[arg(long)]
    pub preset: Option<String>,
    /// Suppression radius in units of the clouds: of the method snake [default: its settings'], and in `semantic` of all
    /// ranked methods [default: 0.1].
    #[arg(long)]
    pub nms_radius: Option<f32>,
    /// Turned copies of a cloud that the method snake averages over [default: its settings'].
    #[arg(long)]
    pub rotations: Option<usize>,
    #[command(flatten)]
    pub run: RunArguments,
}

/// What to run, and where the results go.
#[derive(Args)]
pub struct RunArguments {
    /// Write the tables as .csv, .json and .md, and curves as .svg, into this directory, named after the metric. What is
    /// finished is kept there in a .jsonl: an interrupted run goes on where it was.
    #[arg(short, long)]
    pub output: Option<PathBuf>,
    /// Evaluate this many pairs or shapes, evenly spaced.
    #[arg(long)]
    pub limit: Option<usize>,
    /// Seed of all random choices.
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
    /// Threads; default: all processors. The result does not depend on it.
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..))]
    pub threads: Option<u16>,
    /// Weight file (.safetensors) of the model; default: the built-in compact model.
    #[arg(long)]
    pub model: Option<PathBuf>,
}

/// The protocols of the classical detectors.
#[derive(Clone, Copy, ValueEnum)]
pub enum ProtocolName {
    Ranked,
    Paper,
}

/// The formats that keypoints are written in.
#[derive(Clone, Copy, ValueEnum)]
pub enum Format {
    Ply,
    Npy,
    Csv,
    Json,
}

#[derive(Args)]
pub struct DetectArguments {
    /// Point clouds (.ply, .pcd, .xyz, .txt, .csv, .pts, .npy), or directories of them.
    #[arg(required = true)]
    pub inputs: Vec<PathBuf>,
    /// Write the keypoints: to this file (.ply, .npy, .csv or .json), or, for several inputs, into this directory
    /// as NAME.keypoints.EXT.
    #[arg(short, long)]
    pub output: Option<PathBuf>,
    /// Format of the files in an output directory.
    #[arg(long, value_enum, default_value = "ply")]
    pub format: Format,
    /// Print one JSON object per input, on one line, instead of a table.
    #[arg(long)]
    pub json: bool,
    /// After the last input, print the seconds of each stage to the standard error: of the one cloud, or median,
    /// maximum and sum over several.
    #[arg(long)]
    pub timing: bool,
    /// Weight file (.safetensors); default: the built-in compact model.
    #[arg(long)]
    pub model: Option<PathBuf>,
    /// Threads; default: all processors. The result does not depend on it.
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..))]
    pub threads: Option<u16>,
    #[command(flatten)]
    pub options: DetectFlags,
}

#[derive(Args)]
pub struct RegisterArguments {
    /// The cloud that is moved (.ply, .pcd, .xyz, .txt, .csv, .pts, .npy).
    pub source: PathBuf,
    /// The cloud that it is brought onto, in the same units.
    pub target: PathBuf,
    /// Write the result: .json as --json prints it, .txt the four rows of the matrix.
    #[arg(short, long)]
    pub output: Option<PathBuf>,
    /// Write the source's points in the target's frame (.ply).
    #[arg(long)]
    pub aligned: Option<PathBuf>,
    /// Print one JSON object on one line instead of text.
    #[arg(long)]
    pub json: bool,
    /// Weight file (.safetensors); default: the built-in compact model.
    #[arg(long)]
    pub model: Option<PathBuf>,
    /// Threads; default: all processors. The result does not depend on it.
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..))]
    pub threads: Option<u16>,
    #[command(flatten)]
    pub options: RegisterFlags,
}

/// What is not given keeps its default.
#[derive(Args)]
#[command(next_help_heading = "Registration options (lengths in the clouds' units)")]
pub struct RegisterFlags {
    /// snake: the model; or iss, harris3d, sift3d, fps, random: points of the reduced clouds [default: snake].
    #[arg(long, value_parser = named::<KeypointDetector>)]
    detector: Option<KeypointDetector>,
    /// fpfh: turns with the cloud; field: the network's features, for clouds of about the same orientation [default:
    /// fpfh].
    #[arg(long, value_parser = named::<Descriptor>)]
    descriptor: Option<Descriptor>,
    /// At most this many keypoints of each cloud, the best [default: 2500].
    #[arg(long)]
    max_keypoints: Option<usize>,
    /// Clouds are reduced to voxels of this size for normals, FPFH, ICP and classical detectors; keypoints of snake are
    /// farther apart [default: 1/80 of the diameter of the smaller cloud].
    #[arg(long)]
    voxel_size: Option<f64>,
    /// Radius of normals [default: 2 voxels, or mean distances between the reduced points if they are greater].
    #[arg(long)]
    normal_radius: Option<f64>,
    /// Radius of FPFH [default: 7 of these].
    #[arg(long)]
    feature_radius: Option<f64>,
    /// Matches nearer than this under a transform agree with it [default: 1.5 of these].
    #[arg(long)]
    inlier_distance: Option<f64>,
    /// Least ratio of the shorter to the longer of two matched edges of a sample [default: 0.9].
    #[arg(long)]
    edge_length_ratio: Option<f64>,
    /// At most this many samples [default: 100000].
    #[arg(long)]
    max_iterations: Option<usize>,
    /// Stop sampling once a sample was right with this probability [default: 0.999].
    #[arg(long)]
    confidence: Option<f64>,
    /// Seed of the samples and of random keypoints [default: 0].
    #[arg(long)]
    seed: Option<u64>,
    /// Steps of point-to-plane ICP; 0: none [default: 30].
    #[arg(long)]
    refine_steps: Option<usize>,
}

impl RegisterFlags {
    /// The defaults, overridden by what was given.
    pub fn resolve(&self) -> RegisterOptions {
        let mut options = RegisterOptions::default();
        override_with(&mut options.detector, self.detector);
        override_with(&mut options.descriptor, self.descriptor);
        override_with(&mut options.max_keypoints, self.max_keypoints);
        override_with(&mut options.voxel_size, self.voxel_size.map(Some));
        override_with(&mut options.normal_radius, self.normal_radius.map(Some));
        override_with(&mut options.feature_radius, self.feature_radius.map(Some));
        override_with(&mut options.inlier_distance, self.inlier_distance.map(Some));
        override_with(&mut options.edge_length_ratio, self.edge_length_ratio);
        override_with(&mut options.max_iterations, self.max_iterations);
        override_with(&mut options.confidence, self.confidence);
        override_with(&mut options.seed, self.seed);
        override_with(&mut options.refine_steps, self.refine_steps);
        options
    }
}

/// What is not given comes from the preset, or from the model's recommended options.
#[derive(Args)]
#[command(next_help_heading = "Detection options (default: what the model recommends)")]
pub struct DetectFlags {
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
    /// Keypoints are farther apart than this, in cloud units; 0: no suppression.
    #[arg(long)]
    nms_radius: Option<f32>,
    /// At most this many keypoints, the best.
    #[arg(long)]
    max_keypoints: Option<usize>,
    /// Move each keypoint to its nearest input point.
    #[arg(long)]
    snap: bool,
}

impl DetectFlags {
    /// The options of a run: preset or model's recommendation, overridden by what was given.
    pub fn resolve(&self, model: &Model) -> Result<Preset> {
        let mut preset = match &self.preset {
            Some(name) => Preset::named(name)?,
            None => *model.recommended(),
        };
        let (encode, detect) = (&mut preset.encode, &mut preset.detect);
        override_with(&mut encode.normalization, self.normalization);
        override_with(&mut encode.max_points, self.max_points.map(Some));
        override_with(&mut encode.seed, self.seed);
        override_with(&mut encode.rotations, self.rotations);
        override_with(&mut detect.query_resolution, self.query_resolution);
        override_with(&mut detect.query_band, self.query_band);
        override_with(&mut detect.refine_steps, self.refine_steps);
        override_with(&mut detect.refine_step_size, self.refine_step_size);
        override_with(&mut detect.refine_method, self.refine_method);
        override_with(&mut detect.selection, self.selection);
        override_with(&mut detect.occupancy_threshold, self.occupancy_threshold);
        override_with(&mut detect.surface_threshold, self.surface_threshold);
        override_with(&mut detect.saliency_threshold, self.saliency_threshold);
        override_with(&mut detect.nms_radius, self.nms_radius);
        override_with(&mut detect.max_keypoints, self.max_keypoints);
        override_with(&mut detect.snap, self.snap.then_some(true));
        Ok(preset)
    }
}

fn override_with<T>(option: &mut T, given: Option<T>) {
    if let Some(given) = given {
        *option = given;
    }
}

/// Parses an option's value by the name that it has in weight files and reports.
fn named<T: DeserializeOwned>(name: &str) -> Result<T, serde_json::Error> {
    serde_json::from_value(name.into())
}

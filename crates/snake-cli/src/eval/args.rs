//! The command line of `snake-cli eval`.

use std::path::PathBuf;

use clap::{Args, Subcommand, ValueEnum};
use snake_core::Length;
use snake_registration::{Descriptor, KeypointDetector};

use crate::inputs::ColumnArguments;
use crate::setup::{ComputeArguments, named};

#[derive(Subcommand)]
pub enum Eval {
    /// Relative repeatability: the share of keypoints that a second view finds again.
    ///
    /// DATA is objects or pairs of clouds. Objects are cloud files, a folder of them, or a folder with points.npy of shape
    /// (S, N, 3) and index.json. An object's radius is brought to 1, and its second view is turned at random and sampled
    /// anew.
    ///
    /// Pairs are two cloud files, SOURCE and TARGET, with --transform: the target is the first view, and its radius is
    /// brought to 1. Or they are a folder of one of these layouts, in its own units:
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
  snake-cli eval repeatability my_scans/ --methods snake,snakex4,iss,random --downsample 1 --noise 0
  snake-cli eval repeatability scan2.ply scan1.ply --transform t.json --seeds 5 --downsample 1 --noise 0
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
    /// SMPL: a body model of SMPL, SMPL+H or SMPL-X as it is downloaded: the file itself, .npz or .pkl (of which nothing
    /// is executed), or a folder with model.npz or model.pkl. It is posed at random to 100 pairs of bodies, of 2048 points
    /// each; or to those of pose_test_100.npy and beta_test_100.npy beside it, which the released code uses. Or bodies
    /// that are posed already: body_1.npy and body_2.npy of shape (S, N, 3), the same N places of a body's surface in two
    /// poses, of S pairs. Distances are straight; the best 20 keypoints count.
    ///
    /// Each figure is given by two rules. strict: points that no path joins never match; bodies have as many keypoints as
    /// were found; pairs are averaged. paper, as in the released code: such points always match; bodies are filled up to
    /// 20 with random points; the running IoU is averaged.
    #[command(after_help = "Examples:
  snake-cli eval semantic keypointnet/ --split test_630.txt --paper -o results/
  snake-cli eval semantic SMPL_NEUTRAL.pkl --paper
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
    /// The transform of two clouds, from the first to the second, as `register -o` writes it: .json with t_target_source,
    /// or the 16 numbers of its rows as text.
    #[arg(long)]
    pub transform: Option<PathBuf>,
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
    /// Among snake, iss, harris3d, sift3d, fps and random; snakex4 is snake averaged over 4 turned copies of each cloud
    /// (--rotations of `detect`), likewise any other number.
    #[arg(long, value_delimiter = ',', default_value = "snake,iss,harris3d,sift3d,fps,random")]
    pub methods: Vec<String>,
    /// How the classical detectors pick keypoints: ranked, the strongest responses; or paper, as in the paper's
    /// tables: a random subset, of Harris 3D without suppression and SIFT 3D on the y coordinate.
    #[arg(long, value_enum, default_value = "ranked")]
    pub protocol: ProtocolName,
    /// Keypoints of each cloud, the best.
    #[arg(long, default_value_t = 64)]
    pub count: usize,
    /// The paper's settings of the method snake for a data set; default: what the model recommends.
    #[arg(long)]
    pub preset: Option<String>,
    /// Suppression radius, in units of the clouds or as in `3r` in multiples of their resolution: of the method snake
    /// [default: its settings'], and in `semantic` of all ranked methods [default: 0.1].
    #[arg(long, value_name = "LENGTH")]
    pub nms_radius: Option<Length>,
    /// Windows of the method snake, as of `detect`.
    #[arg(long, value_name = "LENGTH")]
    pub window_radius: Option<Length>,
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
    /// Evaluate with this many seeds from --seed on: figures are means over them, ± their standard deviation. With one,
    /// deviations are over pairs, shapes or scenes.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..))]
    pub seeds: u16,
    /// Show the paper's figures for its own data sets where there are any, marked as the paper's.
    #[arg(long)]
    pub paper: bool,
    #[command(flatten)]
    pub columns: ColumnArguments,
    #[command(flatten)]
    pub compute: ComputeArguments,
}

/// The protocols of the classical detectors.
#[derive(Clone, Copy, ValueEnum)]
pub enum ProtocolName {
    Ranked,
    Paper,
}

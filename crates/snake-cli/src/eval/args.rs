//! The command line of `snake-cli eval`.

use std::path::PathBuf;

use anyhow::Result;
use clap::{Args, Subcommand, ValueEnum};
use serde_json::{Map, Value};
use snake_core::{Builtin, Chooser, Length, Model, NamedModel, Options};
use snake_registration::{Descriptor, Detector};

use crate::inputs::ColumnArguments;
use crate::setup::{ComputeArguments, EncodeFlags, load, named, recommended};

#[derive(Subcommand)]
pub enum Eval {
    /// Measure relative repeatability: the share of keypoints that are found again in a second view.
    ///
    /// DATA is a set of objects or of pairs of clouds. Objects are cloud files, a folder of cloud files, or a folder
    /// with points.npy of shape (S, N, 3) and index.json. Each object is scaled to radius 1. Its second view is a
    /// random rotation of a new random sample.
    ///
    /// A pair is two cloud files, SOURCE and TARGET, with --transform. The target is the first view, and the pair is
    /// scaled so that the target has radius 1. Pairs can also be a folder in one of these layouts, in its own units:
    ///
    /// pairs.json: [{"source": "a.ply", "target": "b.ply", "T": [[..4], ..4]}, ..], in metres. T maps the source to the
    /// target, and the target is the first view.
    ///
    /// ModelNet40 in the layout of USIP: original/0.npy, 1.npy, .. of shape (N, 3) or with more columns, the same in
    /// rotated/, and transform.npy of shape (S, 3, 4) or (S, 4, 4). Row i maps the rotated object i to the original.
    ///
    /// Redwood in the layout of USIP: SCENE/0.npy, 1.npy, .., redwood_pair.txt of the released code with lines
    /// "SCENE i j", and transform.npy with a row for each line. A row maps cloud j to cloud i, the first view.
    ///
    /// Every method is evaluated on the same views: clean views, then each down-sampling rate, then each noise level.
    /// The defaults are the settings of the paper's tables: ModelNet40 for objects, Redwood for rooms.
    #[command(after_help = "Examples:
  snake-cli eval repeatability corpus/objects/val -o results/
  snake-cli eval repeatability my_scans/ --methods snake,snakex4,iss,random --downsample 1 --noise 0
  snake-cli eval repeatability scan2.ply scan1.ply --transform t.json --seeds 5 --downsample 1 --noise 0
  snake-cli eval repeatability scenes/val -o results/ --preset redwood --nms-radius 0.04
  snake-cli eval repeatability corpus/objects/val --models seed1.safetensors,seed2.safetensors,seed3.safetensors")]
    Repeatability(Box<RepeatabilityArguments>),
    /// Measure registration of scene fragments by the rules of the 3DMatch benchmark.
    ///
    /// DATA is a folder with a pairs.json as in `eval repeatability`, a scene of the benchmark, or a folder of scenes.
    /// A scene has the fragments cloud_bin_0.ply, .. and the files gt.log and gt.info, beside the fragments or in the
    /// folder SCENE-evaluation. In pairs.json a fragment named SCENE_NUMBER belongs to that scene. Lengths are in
    /// metres.
    ///
    /// Every combination of detector and descriptor is evaluated, and all figures are means over the scenes. Feature
    /// matching recall is the share of pairs with an inlier ratio above 0.05 at 0.1 m. Registration recall is the share
    /// of pairs, without consecutive fragments, that RANSAC registers with an RMSE of at most 0.2 m. The RMSE follows
    /// from the information matrix of gt.info; for pairs.json, that matrix is computed from the points that have a
    /// partner within 0.05 m.
    #[command(after_help = "Examples:
  snake-cli eval registration scenes/val -o results/
  snake-cli eval registration 3dmatch/fragments --detectors snake,fps,random --descriptors fpfh --max-keypoints 1000,250
  snake-cli eval registration 3dmatch/fragments --preset 3dmatch --external d3feat=d3feat_npz --descriptors d3feat")]
    Registration(Box<RegistrationArguments>),
    /// Measure semantic consistency: mIoU with annotated keypoints, or between two poses of a body.
    ///
    /// DATA is one of these data sets:
    ///
    /// KeypointNet: a folder with annotations/CLASS.json, lists of {"class_id", "model_id", "keypoints": [{"pcd_info":
    /// {"point_index"}}, ..]}, and the clouds CLASS_ID/MODEL_ID.pcd, in pcds/ or in the folder itself. The file
    /// all.json is ignored. Distances are geodesic, and the figure is the mean IoU over the classes. For the paper's
    /// 630 shapes, set --split to the first 630 lines of the released code's list.
    ///
    /// SMPL: a downloaded body model of SMPL, SMPL+H or SMPL-X. DATA is its .npz file (`python -m
    /// snake_training.body_model` converts a .pkl), or a folder with model.npz. The model is posed at random as 100 pairs of bodies with
    /// 2048 points each, or with the parameters in pose_test_100.npy and beta_test_100.npy of that folder, as in the
    /// released code. A folder may also hold posed bodies: body_1.npy and body_2.npy of shape (S, N, 3) have S pairs
    /// with the same N points of the surface in two poses. Distances are Euclidean, and the best 20 keypoints are used.
    ///
    /// Each figure is computed by two rules. strict: points without a path between them never match, a body has only
    /// the keypoints that were found, and the IoU is averaged over the pairs. paper, as in the released code: points
    /// without a path always match, random points fill a body up to 20 keypoints, and the running IoU is averaged.
    #[command(after_help = "Examples:
  snake-cli eval semantic keypointnet/ --split test_630.txt --paper -o results/
  snake-cli eval semantic SMPL_NEUTRAL.npz --paper
  snake-cli eval semantic bodies/ --methods snake,iss,random")]
    Semantic(Box<SemanticArguments>),
}

/// The network and all classical detectors.
fn methods() -> impl Iterator<Item = &'static str> {
    std::iter::once("snake").chain(Detector::CLASSICAL.iter().map(|detector| detector.name()))
}

#[derive(Args)]
pub struct RegistrationArguments {
    /// The data set.
    pub data: PathBuf,
    /// Detectors to evaluate; all of them by default.
    #[arg(long, value_delimiter = ',', value_parser = named::<Detector>, default_values = methods())]
    pub detectors: Vec<Detector>,
    /// Descriptors to evaluate: field, fpfh, or the name of an --external, which describes a keypoint by the nearest
    /// point in the file.
    #[arg(long, value_delimiter = ',', default_value = "field,fpfh")]
    pub descriptors: Vec<String>,
    /// Numbers of keypoints to evaluate; each number takes the best keypoints of each cloud.
    #[arg(long, value_delimiter = ',', default_value = "2500,1000,500,250,100")]
    pub max_keypoints: Vec<usize>,
    /// Radius of non-maximum suppression, in metres or in multiples of the cloud's resolution (`3r`), of all detectors
    /// [default: a voxel of 0.03 for snake, none for the others; with --preset 3dmatch, as in the paper, 0.05 for snake and files].
    #[arg(long, value_name = "LENGTH")]
    pub nms_radius: Option<Length>,
    /// Also evaluate the keypoints in FOLDER/CLOUD.npz under this name: `keypoints` (K, 3) in the cloud's frame and, unless
    /// they are ranked, `scores` (K). Those with `descriptors` (K, D) are matched by them too. CLOUD is the path of the cloud's
    /// file from the data set on, without extension, such as `SCENE/cloud_bin_0`.
    #[arg(long, value_name = "NAME=FOLDER", value_parser = external)]
    pub external: Vec<(String, PathBuf)>,
    #[command(flatten)]
    pub run: RunArguments,
    #[command(flatten)]
    pub options: EncodeFlags,
}

#[derive(Args)]
pub struct RepeatabilityArguments {
    /// The data set.
    #[arg(required = true)]
    pub data: Vec<PathBuf>,
    /// The transform from the first cloud to the second, in a file as `register -o` writes it: .json with
    /// t_target_source, or .txt with the four rows of the matrix.
    #[arg(long)]
    pub transform: Option<PathBuf>,
    /// Evaluate only the shapes of KeypointNet in this list, a file with a CLASS_ID-MODEL_ID on each line. DATA is a folder with
    /// CLASS_ID/MODEL_ID.pcd, in pcds/ or in the folder itself. The shapes keep their units.
    #[arg(long, conflicts_with = "transform")]
    pub split: Option<PathBuf>,
    /// Distances below which a keypoint counts as repeated, in units of the data set (objects: their radius) [default:
    /// 0.03 to 0.1, rooms: 0.1 to 0.24].
    #[arg(long, value_delimiter = ',')]
    pub epsilon: Option<Vec<f64>>,
    /// The distance of --epsilon at which down-sampling and noise are tabulated [default: 0.04, with --split 0.03, rooms: 0.2].
    #[arg(long)]
    pub table_epsilon: Option<f64>,
    /// Down-sampling rates; a rate of N keeps one point in N.
    #[arg(long, value_delimiter = ',', default_value = "1,2,4,8,16")]
    pub downsample: Vec<usize>,
    /// Standard deviations of Gaussian noise on each coordinate, in units of the data set (objects: their radius)
    /// [default: 0 to 0.12, with --split 0 to 0.03, rooms: 0 to 0.1].
    #[arg(long, value_delimiter = ',')]
    pub noise: Option<Vec<f64>>,
    /// Number of points in each view, drawn at random [default: 5000, with --split 2048, rooms: 10240].
    #[arg(long)]
    pub num_points: Option<usize>,
    #[command(flatten)]
    pub common: EvalArguments,
}

#[derive(Args)]
pub struct SemanticArguments {
    /// The data set.
    pub data: PathBuf,
    /// Evaluate only the shapes of KeypointNet in this list, a file with a CLASS_ID-MODEL_ID on each line [default:
    /// all].
    #[arg(long)]
    pub split: Option<PathBuf>,
    /// Distances up to which keypoints match, in units of the data set.
    #[arg(long, value_delimiter = ',', default_value = "0,0.01,0.02,0.03,0.04,0.05,0.06,0.07,0.08,0.09,0.1")]
    pub threshold: Vec<f64>,
    #[command(flatten)]
    pub common: EvalArguments,
}

/// Options of keypoint evaluations.
#[derive(Args)]
pub struct EvalArguments {
    /// Methods to evaluate; all of them by default. snakex4 is snake averaged over 4 rotated copies of each cloud
    /// (--rotations of `detect`); any other number works as well.
    #[arg(long, value_delimiter = ',', default_values = methods())]
    pub methods: Vec<String>,
    /// How the classical detectors select keypoints. ranked: the strongest responses. paper: a random subset, as in the
    /// paper's tables, with Harris 3D without suppression and SIFT 3D on the y coordinate.
    #[arg(long, value_enum, default_value = "ranked")]
    pub protocol: ProtocolName,
    /// Number of keypoints of each cloud, the best ones.
    #[arg(long, value_name = "NUMBER", default_value_t = 64)]
    pub max_keypoints: usize,
    /// Radius of non-maximum suppression, in cloud units or in multiples of the cloud's resolution (`3r`). It applies
    /// to all ranked methods [default: from the options of snake, none for the others; in `semantic` 0.1 for all].
    #[arg(long, value_name = "LENGTH")]
    pub nms_radius: Option<Length>,
    /// Suppress the keypoints of each method until the mean distance from a point to the nearest keypoint is this, in units of
    /// the data set, so that methods are compared at equal coverage. The radius of each method and condition is found on the
    /// first cloud of every pair or shape.
    #[arg(long, value_name = "DISTANCE", conflicts_with = "nms_radius")]
    pub coverage: Option<f64>,
    /// Also evaluate the keypoints in FOLDER/CLOUD.npz under this name: `keypoints` (K, 3) in the cloud's frame and, unless
    /// they are ranked, `scores` (K). CLOUD is the path of the cloud's file from the data set on, without extension; of bodies
    /// `body_1_0`, `body_2_0` and so on.
    #[arg(long, value_name = "NAME=FOLDER", value_parser = external)]
    pub external: Vec<(String, PathBuf)>,
    #[command(flatten)]
    pub run: RunArguments,
    #[command(flatten)]
    pub options: EncodeFlags,
}

/// Options of every evaluation: its extent and its output.
#[derive(Args)]
pub struct RunArguments {
    /// Write the tables (.csv, .json, .md) and the curves (.svg) to this directory, named after the metric. A .jsonl
    /// file there keeps the finished figures, so that an interrupted run continues where it stopped.
    #[arg(short, long)]
    pub output: Option<PathBuf>,
    /// Evaluate only this many pairs or shapes, evenly spaced over the data set [default: all].
    #[arg(long)]
    pub limit: Option<usize>,
    /// Seed of all random choices.
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
    /// Evaluate with this many consecutive seeds from --seed on. The figures are the mean and the standard deviation
    /// over the seeds. With one seed, the deviation is over pairs, shapes or scenes.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..))]
    pub seeds: u16,
    /// Evaluate these models as one method, in place of that of --model: the figures are the mean and the standard deviation
    /// over them, as over networks that were trained with other seeds [default: only that of --model].
    #[arg(long, value_name = "MODEL", value_delimiter = ',')]
    pub models: Vec<PathBuf>,
    /// Also show the paper's figures, marked as such, where the paper has any.
    #[arg(long)]
    pub paper: bool,
    #[command(flatten)]
    pub columns: ColumnArguments,
    #[command(flatten)]
    pub compute: ComputeArguments,
}

impl RunArguments {
    /// The choosers for given values of options: one for each of `--models`, or else that of `--model`.
    pub fn choosers(&self, values: &Map<String, Value>) -> Result<Vec<Chooser>> {
        let named = |model: &PathBuf| Ok(Chooser::from(load(Some(model), recommended)?).with_values(values)?);
        match &self.models[..] {
            [] => Ok(vec![self.compute.chooser(values)?]),
            models => models.iter().map(named).collect(),
        }
    }

    /// Loads the models for all clouds of a data set: those of `--models`, else that of `--model`, else the built-in model `which`,
    /// with the options of `start`.
    pub fn load_models(&self, which: Option<Builtin>, start: impl Fn(&Model) -> Options) -> Result<Vec<NamedModel>> {
        match &self.models[..] {
            [] => Ok(vec![self.compute.load_model(which, start)?]),
            models => models.iter().map(|model| load(Some(model), &start)).collect(),
        }
    }
}

fn external(text: &str) -> std::result::Result<(String, PathBuf), String> {
    let (name, folder) = text.split_once('=').filter(|(name, _)| !name.is_empty()).ok_or("expected NAME=FOLDER")?;
    if named::<Detector>(name).is_ok() || named::<Descriptor>(name).is_ok() || name.starts_with("snake") {
        return Err(format!("{name} is a method of its own"));
    }
    Ok((name.into(), folder.into()))
}

/// The protocols of the classical detectors.
#[derive(Clone, Copy, ValueEnum)]
pub enum ProtocolName {
    Ranked,
    Paper,
}

//! The command line of `snake-cli register`.

use std::path::PathBuf;

use clap::Args;
use snake_core::Length;
use snake_registration::{Descriptor, KeypointDetector, RegisterOptions};

use crate::inputs::InputArguments;
use crate::setup::{ComputeArguments, named, override_with};

#[derive(Args)]
pub struct RegisterArguments {
    /// The cloud that is moved, in any format that `detect` reads; `-` is the standard input.
    pub source: PathBuf,
    /// The cloud that it is brought onto, in the same units.
    pub target: PathBuf,
    /// Write the result: .json as --json prints it, .txt the four rows of the matrix.
    #[arg(short, long)]
    pub output: Option<PathBuf>,
    /// Write the source's points in the target's frame (.ply, .pcd, .npy, .xyz or .csv).
    #[arg(long)]
    pub aligned: Option<PathBuf>,
    #[command(flatten)]
    pub input: InputArguments,
    /// Print one JSON object on one line instead of text.
    #[arg(long)]
    pub json: bool,
    #[command(flatten)]
    pub compute: ComputeArguments,
    #[command(flatten)]
    pub options: RegisterFlags,
}

/// What is not given keeps its default.
#[derive(Args)]
#[command(
    next_help_heading = "Registration options (LENGTH: in the clouds' units, or multiples of their resolution: 3r)"
)]
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
    #[arg(long, value_name = "LENGTH")]
    voxel_size: Option<Length>,
    /// Radius of normals [default: 2 voxels, or mean distances between the reduced points if they are greater].
    #[arg(long, value_name = "LENGTH")]
    normal_radius: Option<Length>,
    /// Radius of FPFH [default: 7 of these].
    #[arg(long, value_name = "LENGTH")]
    feature_radius: Option<Length>,
    /// Matches nearer than this under a transform agree with it [default: 1.5 of these].
    #[arg(long, value_name = "LENGTH")]
    inlier_distance: Option<Length>,
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

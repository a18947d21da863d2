//! The command line of `snake-cli register`.

use std::path::PathBuf;

use clap::Args;
use snake_core::Length;
use snake_registration::{Descriptor, KeypointDetector, RegisterOptions};

use crate::inputs::InputArguments;
use crate::setup::{ComputeArguments, named, override_with};

#[derive(Args)]
pub struct RegisterArguments {
    /// The cloud to align, in any format that `detect` reads; `-` is the standard input.
    pub source: PathBuf,
    /// The cloud to align it to, in the same units.
    pub target: PathBuf,
    /// Write the result to this file: .json has the same content as --json, .txt has the four rows of the matrix.
    #[arg(short, long)]
    pub output: Option<PathBuf>,
    /// Write the source's points in the target's frame to this file (.ply, .pcd, .npy, .xyz or .csv).
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

/// Options of registration; an option that is not given keeps its default.
#[derive(Args)]
#[command(
    next_help_heading = "Registration options (LENGTH: in the clouds' units, or multiples of their resolution: 3r)"
)]
pub struct RegisterFlags {
    /// Keypoint detector: snake (the model), or iss, harris3d, sift3d, fps or random on the downsampled clouds
    /// [default: snake].
    #[arg(long, value_parser = named::<KeypointDetector>)]
    detector: Option<KeypointDetector>,
    /// Descriptor of the keypoints: fpfh is invariant to rotation; field, the network's features, is for clouds of
    /// about the same orientation [default: fpfh].
    #[arg(long, value_parser = named::<Descriptor>)]
    descriptor: Option<Descriptor>,
    /// Use at most this many keypoints of each cloud, the best ones [default: 2500].
    #[arg(long)]
    max_keypoints: Option<usize>,
    /// Size of the voxels to which both clouds are downsampled for normals, FPFH, ICP and the classical detectors. It
    /// is also the least distance between the keypoints of snake [default: 1/80 of the diameter of the smaller cloud].
    #[arg(long, value_name = "LENGTH")]
    voxel_size: Option<Length>,
    /// Radius of the neighbourhood for normals [default: 2 units, where a unit is the voxel size, or the mean distance
    /// between neighbouring downsampled points if that is greater].
    #[arg(long, value_name = "LENGTH")]
    normal_radius: Option<Length>,
    /// Radius of the neighbourhood for FPFH [default: 7 such units].
    #[arg(long, value_name = "LENGTH")]
    feature_radius: Option<Length>,
    /// Distance up to which a match is an inlier of a transform [default: 1.5 such units].
    #[arg(long, value_name = "LENGTH")]
    inlier_distance: Option<Length>,
    /// Reject a RANSAC sample if the ratio of the shorter to the longer of two matched edges is below this, 0 to 1
    /// [default: 0.9].
    #[arg(long)]
    edge_length_ratio: Option<f64>,
    /// Maximum number of RANSAC samples [default: 100000].
    #[arg(long)]
    max_iterations: Option<usize>,
    /// Stop sampling when one of the samples is correct with this probability [default: 0.999].
    #[arg(long)]
    confidence: Option<f64>,
    /// Seed of the RANSAC samples and of random keypoints [default: 0].
    #[arg(long)]
    seed: Option<u64>,
    /// Number of point-to-plane ICP steps; 0 turns ICP off [default: 30].
    #[arg(long)]
    refine_steps: Option<usize>,
}

impl RegisterFlags {
    /// The defaults, overridden by the command line.
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

//! The command line of `snake-cli register`.

use std::path::PathBuf;

use clap::Args;
use snake_core::Length;
use snake_registration::{Axis, Descriptor, KeypointDetector, RegisterOptions};

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
    /// Write a page to this file (.html) that shows the source moved onto the target, with the matches that agree as lines.
    #[arg(long, value_name = "FILE")]
    pub view: Option<PathBuf>,
    /// Start from the transform in this file, as written by `register -o`, and search for no other.
    #[arg(long, value_name = "FILE")]
    pub initial: Option<PathBuf>,
    /// Exit with code 1 if the transform is not reliable or none fits. Files are written if there is a transform.
    #[arg(long)]
    pub require_reliable: bool,
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
    /// Keypoint detector: voxels (all points of the downsampled clouds), snake (the model), or iss, harris3d, sift3d, fps
    /// or random on the downsampled clouds [default: voxels].
    #[arg(long, value_parser = named::<KeypointDetector>)]
    detector: Option<KeypointDetector>,
    /// Descriptor of the keypoints: fpfh is invariant to rotation; field, the network's features, is for clouds of
    /// about the same orientation [default: fpfh].
    #[arg(long, value_parser = named::<Descriptor>)]
    descriptor: Option<Descriptor>,
    /// Use at most this many keypoints of each cloud, the best ones; of voxels a random part [default: 8000].
    #[arg(long)]
    max_keypoints: Option<usize>,
    /// Use this many keypoints of each cloud, spread evenly over it: the suppression radius follows from the number. For
    /// links of low bandwidth, such as 250 keypoints of iss [default: as many as --max-keypoints allows].
    #[arg(long, value_name = "N", conflicts_with = "max_keypoints")]
    num_keypoints: Option<usize>,
    /// Use at most this many matches, the most distinctive ones [default: 2000].
    #[arg(long)]
    max_matches: Option<usize>,
    /// Size of the voxels to which both clouds are downsampled for normals, FPFH, ICP and the classical detectors. It
    /// is also the least distance between the keypoints of snake [default: 1/80 of the diameter of the smaller cloud].
    #[arg(long, value_name = "LENGTH")]
    voxel_size: Option<Length>,
    /// Radius of the neighbourhood for normals [default: 2 units, where a unit is the voxel size, or the mean distance
    /// between neighbouring downsampled points if that is greater].
    #[arg(long, value_name = "LENGTH")]
    normal_radius: Option<Length>,
    /// Radius of the neighbourhood for FPFH [default: 5 such units].
    #[arg(long, value_name = "LENGTH")]
    feature_radius: Option<Length>,
    /// Distance up to which a match is an inlier of a transform [default: 1.5 such units].
    #[arg(long, value_name = "LENGTH")]
    inlier_distance: Option<Length>,
    /// Do not orient normals to the sensor and do not assume free space in front of it.
    #[arg(long)]
    no_viewpoints: bool,
    /// Position of the sensor in the source's frame [default: VIEWPOINT of a PCD file unless it is zero, else the
    /// frame's origin, if most of the cloud is visible from there].
    #[arg(long, value_name = "X,Y,Z", value_parser = position, allow_hyphen_values = true)]
    source_viewpoint: Option<[f64; 3]>,
    /// Position of the sensor in the target's frame [default: likewise].
    #[arg(long, value_name = "X,Y,Z", value_parser = position, allow_hyphen_values = true)]
    target_viewpoint: Option<[f64; 3]>,
    /// The axis that points up in both clouds, x, y or z: the transform is a rotation about it and a translation
    /// [default: any rotation].
    #[arg(long, value_name = "AXIS", value_parser = named::<Axis>)]
    gravity: Option<Axis>,
    /// Return this many transforms, best first [default: 1].
    #[arg(long, value_name = "N")]
    hypotheses: Option<usize>,
    /// Seed of random keypoints [default: 0].
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
        override_with(&mut options.num_keypoints, self.num_keypoints.map(Some));
        override_with(&mut options.voxel_size, self.voxel_size.map(Some));
        override_with(&mut options.normal_radius, self.normal_radius.map(Some));
        override_with(&mut options.feature_radius, self.feature_radius.map(Some));
        override_with(&mut options.inlier_distance, self.inlier_distance.map(Some));
        override_with(&mut options.max_matches, self.max_matches);
        options.use_viewpoints &= !self.no_viewpoints;
        override_with(&mut options.source_viewpoint, self.source_viewpoint.map(Some));
        override_with(&mut options.target_viewpoint, self.target_viewpoint.map(Some));
        override_with(&mut options.gravity, self.gravity.map(Some));
        override_with(&mut options.hypotheses, self.hypotheses);
        override_with(&mut options.seed, self.seed);
        override_with(&mut options.refine_steps, self.refine_steps);
        options
    }
}

fn position(text: &str) -> Result<[f64; 3], String> {
    let numbers: Result<Vec<f64>, _> = text.split(',').map(|number| number.trim().parse()).collect();
    let numbers = numbers.ok().and_then(|numbers| numbers.try_into().ok());
    numbers.ok_or_else(|| "needed are three numbers: x,y,z".into())
}

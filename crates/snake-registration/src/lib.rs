//! Rigid registration: finds the rotation and translation that map one point cloud onto another, without an initial
//! guess, and says whether they can be relied on. Descriptors of two clouds are matched, transforms on which many
//! matches agree are compared on the clouds, and ICP refines the best. Descriptors are FPFH or of a SNAKE model;
//! keypoints are all voxels, or those of a model or of classical methods ([`Detector`]).
//!
//! ```text
//! prepare     voxels, normals, sensors, keypoints         once for a cloud
//! describe    FPFH, or the features of a field            once for a cloud
//! match_rows  the most distinctive matches
//! consensus   transforms on which many matches agree
//! refine      overlap, free space and agreeing matches rank them; ICP
//! judge       verdict, fit and matches of the best
//! ```
//!
//! [`register()`] runs these [`steps`]; each is a function that yours can replace;
//! [`align()`] finds the poses of many clouds, and [`kabsch`] fits a transform to own matches.
//!
//! Folders: `steps/` are the steps and their tables of constants; `cloud/` is what they compute
//! with: voxels, normals, surfaces, planar patches; `many/` aligns many clouds.
//!
//! `t_target_source` maps a point from the source frame to the target frame:
//! `p_target = R p_source + t`. Results have the same bits for any number of threads.

#![forbid(unsafe_code)]

mod cloud;
mod many;
mod options;
mod register;
mod result;
mod rigid;
pub mod steps;

pub use cloud::normals::{estimate_normals, estimate_normals_with};
pub use many::{Alignment, Contradiction, Edge, Pose, align, align_with};
pub use options::{AlignOptions, AlignPriors, Axis, Descriptor, PairOptions, RegisterOptions};
pub use register::{PreparedMap, register, register_with};
pub use result::{CloudReport, Fit, Hypothesis, Matches, Registration, Verdict, ViewpointUsed};
pub use rigid::{kabsch, transform_points};
pub use snake_detectors::Detector;
pub use steps::describe::describe_keypoints;
pub use steps::describe::fpfh::{FPFH_DIMENSION, fpfh, fpfh_with};
pub use steps::match_rows::mutual_nearest;

use snake_geometry::{Record, RecordInfo};

/// The tables of all results, for other languages.
pub const RECORDS: [&RecordInfo; 10] = [
    Registration::INFO,
    Verdict::INFO,
    Fit::INFO,
    Matches::INFO,
    CloudReport::INFO,
    Hypothesis::INFO,
    Alignment::INFO,
    Pose::INFO,
    Edge::INFO,
    Contradiction::INFO,
];

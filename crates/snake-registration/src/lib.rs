//! Rigid registration: finds the rotation and translation that map one point cloud onto another, without an initial
//! guess, and says whether they can be relied on. Descriptors of two clouds are matched, transforms on which many matches
//! agree are compared on the clouds, and ICP refines the best. Descriptors are FPFH or of a SNAKE model; keypoints are all
//! voxels, or those of a model or of classical methods ([`detectors`]).
//!
//! ```text
//! cloud → voxels → normals → descriptors → matches → graph of compatible matches → transforms
//!       → overlap, free space and agreeing matches choose → ICP on the voxels → t_target_source, confidence
//! ```
//!
//! [`register()`] runs all steps. A [`Scan`] computes keypoints and descriptors of one cloud. [`fpfh()`],
//! [`mutual_nearest`], [`ransac()`] and [`kabsch`] are plain parts for own pipelines:
//!
//! ```
//! use snake_geometry::RigidTransform;
//! use snake_registration::{RansacOptions, ransac, transform_points};
//! let source = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 3.0], [1.0, 1.0, 1.0]];
//! let rows = [[0.0, -1.0, 0.0, 3.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];
//! let t_target_source = RigidTransform::from_matrix(rows)?;
//! let mut target = transform_points(&t_target_source, &source);
//! target[4] = [9.0, 9.0, 9.0]; // a wrong correspondence
//! let found = ransac(&source, &target, &RansacOptions::default())?.expect("four correspondences agree");
//! assert_eq!(found.inliers, [0, 1, 2, 3]);
//! # Ok::<(), snake_core::Error>(())
//! ```
//!
//! In folders: `parts/` are plain steps; `pair/` prepares two clouds, matches and refines; `verdict/` says whether the result can be
//! relied on; `many/` aligns many clouds; `detectors/` are classical keypoints.
//!
//! `t_target_source` maps a point from the source frame to the target frame: `p_target = R p_source + t`. Results have
//! the same bits for any number of threads.

#![forbid(unsafe_code)]

pub mod detectors;
mod many;
mod options;
mod pair;
mod parts;
mod result;
mod verdict;

pub use many::{AlignOptions, Alignment, Edge, Pose, align, align_with};
pub use options::{Axis, Descriptor, KeypointDetector, RegisterOptions};
pub use pair::describe::describe;
pub use pair::register::{register, register_with};
pub use pair::scan::Scan;
pub use parts::cloud::estimate_normals;
pub use parts::fpfh::{FPFH_DIMENSION, fpfh};
pub use parts::matching::mutual_nearest;
pub use parts::ransac::{Consensus, RansacOptions, ransac};
pub use parts::rigid::{kabsch, transform_points};
pub use result::{Hypothesis, Registration, ViewpointUsed};

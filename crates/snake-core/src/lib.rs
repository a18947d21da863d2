//! SNAKE (Shape-aware Neural 3D Keypoint Field, NeurIPS 2022) on the CPU: repeatable keypoints of point clouds, and
//! surface occupancy and saliency at any point of space.
//!
//! ```text
//! points → normalise → PointNet → scatter mean → volume → 3-D U-Net → Field ─ occupancy, saliency, gradients
//!                                                                       │
//!          query grid → occupancy filter → refine → threshold → NMS ────┴→ keypoints
//! ```
//!
//! | folder | what it holds |
//! |---|---|
//! | `models/` | the weights that come with the crate, and which of them suits a cloud |
//! | `network/` | weights → layers; points → encoder → volume, dense or in blocks; decoder |
//! | `field/` | encode once, query many; grid; surface |
//! | `detect/` | Algorithm 1, a step a file; its options; tiles |
//! | `live/` | the same for the next frame: detector, real time, tracker |
//! | `call/` | what a call may do: progress, cancellation, limits, threads |
//!
//! | you have | you want | use |
//! |---|---|---|
//! | a cloud | its keypoints | [`Model::detect`] |
//! | a cloud | occupancy, saliency, descriptors or a mesh as well | [`Model::encode`], then [`Field`] |
//! | one cloud after another | keypoints without allocations | [`Detector`] |
//! | keypoints of frames | the same keypoint in each frame | [`Tracker`] |
//! | a cloud larger than memory | keypoints | [`TileDetector`], or the crate `snake-tiles` |
//! | a time limit or a server | progress, cancellation, limits | [`Control`], with the methods that end in `_with` |
//!
//! Results have the same bits for any number of threads. The crate `snake-geometry` has points and what can be said of
//! them without a network, `snake-eval` the metrics of keypoints, and `snake-registration` classical detectors for
//! comparison.

#![forbid(unsafe_code)]

mod call;
mod detect;
mod error;
mod field;
#[cfg(test)]
mod golden;
mod live;
mod models;
mod network;
#[doc(hidden)]
pub mod steps;

pub use call::{CancelFlag, Control, Counter, Limits, Progress, Stage, check_num_threads, side_by_side};
#[doc(hidden)]
pub use detect::in_words;
#[doc(hidden)]
pub use detect::option_names;
pub use detect::{
    Candidate, Counts, DetectOptions, Detection, EncodeOptions, MeshOptions, Options, Preset, RefineMethod, Selection,
    TileCandidates, TileDetector, TileSettings, Timing, by_rank, cluster_hint, with_named_values,
};
pub use error::{Error, Result};
pub use field::{Field, Grid};
pub use live::{Detector, Tracker, TrackerOptions};
#[cfg(feature = "builtin-models")]
pub use models::Builtin;
pub use models::{Model, scale_hint, scene_signs};
pub use network::{ModelConfig, PointEncoder, Scatter, Volume, VolumeFrame, VolumeShape, read_weight_file};
#[cfg(feature = "arrow")]
pub use snake_geometry::ArrowPoints;
pub use snake_geometry::{
    Bounds, Cloud, Fate, Keypoint, Length, Mesh, Normalization, NormalizationMethod, OptionGroup, OptionInfo,
    OptionKind, Outliers, Point, PointCloud2Layout, PointCloud2View, PointField, PointSource, RigidTransform,
    SeparateAxes, add_origin, subtract_origin, zero_hint,
};
#[doc(hidden)]
pub use snake_geometry::{excerpt, is_harmful, printable, setters};
pub use snake_kernels::SimdLevel;

/// The README's example runs as a test.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct ReadMe;

//! SNAKE (Shape-aware Neural 3D Keypoint Field, NeurIPS 2022) on the CPU: repeatable keypoints of point clouds, and
//! surface occupancy and saliency at any point of space.
//!
//! ```text
//! points → normalise → PointNet → scatter mean → volume → 3-D U-Net → Field ─ occupancy, saliency, gradients
//!                                                                       │
//!          query grid → occupancy filter → refine → threshold → NMS ────┴→ keypoints
//! ```
//!
//! | folder | content |
//! |---|---|
//! | `control/` | control of a call: progress, cancellation, deadline, threads |
//! | `options/` | options of encoding, detection and meshes |
//! | `cloud/` | the used points of a cloud, and its measures |
//! | `lattice/` | where voxels and queries lie: in a cube, or around the points of a scene |
//! | `network/` | weights → layers; points → encoder → volume; decoder |
//! | `field/` | encode once, query many; grid; surface |
//! | `detect/` | Algorithm 1, one step per file; tiles |
//! | `choose/` | which model a cloud gets |
//! | `live/` | the same for the next frame |
//!
//! Each of them uses those above it, and none below.
//!
//! | you have | you want | use |
//! |---|---|---|
//! | a cloud | its keypoints | [`Model::detect`] |
//! | a cloud | occupancy, saliency, descriptors or a mesh as well | [`Model::encode`], then [`Field`] |
//! | a sequence of clouds | the keypoints of each, reusing the memory of the previous one | [`FrameDetector`] |
//! | a cloud larger than memory | keypoints | [`TileDetector`], or the crate `snake-tiles` |
//! | a time limit or a server | progress, cancellation, a deadline | [`Control`], with the methods that end in `_with` |
//!
//! Results have the same bits for any number of threads. The crate `snake-geometry` analyses points without a network,
//! and `snake-detectors` has classical detectors for comparison.

#![forbid(unsafe_code)]

#[cfg(feature = "builtin-models")]
mod builtin;
mod choose;
mod cloud;
mod control;
mod detect;
mod field;
#[cfg(test)]
mod golden;
mod lattice;
mod live;
mod model;
mod network;
mod options;
#[doc(hidden)]
pub mod steps;

#[cfg(feature = "builtin-models")]
pub use builtin::Builtin;
#[cfg(feature = "builtin-models")]
pub use choose::{Chooser, Chosen, ChosenBy, NamedModel};
pub use cloud::{UsedCloud, scene_signs};
pub use control::{
    CancelFlag, Control, Counter, ProcessPool, Progress, Stage, max_num_threads, parallel_map, run_watched,
};
pub use detect::{
    Candidate, Counts, Detection, PlacedDetector, TileCandidates, TileDetector, TileOutcome, TileSettings, Timing,
    by_rank,
};
pub use field::{Field, Grid};
pub use lattice::{VolumeFrame, VolumeShape};
pub use live::FrameDetector;
pub use model::Model;
pub use network::{ModelConfig, Scatter, Volume, read_weight_file};
#[doc(hidden)]
pub use options::in_words;
#[doc(hidden)]
pub use options::option_names;
pub use options::{
    DetectOptions, EncodeOptions, MeshOptions, MeshSurface, Options, Preference, Preset, RefineMethod, Selection,
    with_named_values,
};
pub use snake_geometry::{
    Bounds, Cloud, Covariance, Fate, Keypoint, Length, Mesh, Normalization, NormalizationMethod, OptionGroup,
    OptionInfo, OptionKind, Outliers, Point, PointCloud2Layout, PointCloud2View, PointField, PointSource,
    RigidTransform, SeparateAxes, add_origin, subtract_origin,
};
pub use snake_geometry::{Error, Result};
#[doc(hidden)]
pub use snake_geometry::{excerpt, is_harmful, printable, setters, shortened, shortened_value};
pub use snake_kernels::SimdLevel;

/// The README's example runs as a test.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct ReadMe;

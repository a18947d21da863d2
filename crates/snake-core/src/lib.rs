//! SNAKE (Shape-aware Neural 3D Keypoint Field, NeurIPS 2022) on the CPU: repeatable keypoints of point clouds, and
//! surface occupancy and saliency at any point of space.
//!
//! ```text
//! points → normalise → PointNet → scatter mean → volume → 3-D U-Net → Field ─ occupancy, saliency, gradients
//!                                                                       │
//!          query grid → occupancy filter → refine → threshold → NMS ────┴→ keypoints
//! ```
//!
//! [`Model::encode`] encodes a cloud once. Its [`Field`] answers any number of queries, and [`Field::detect`] finds its
//! keypoints. [`Model::detect`] does both. Results have the same bits for any number of threads.
//!
//! The crate `snake-eval` has the metrics of keypoints, and `snake-registration` has classical detectors for comparison.

#![forbid(unsafe_code)]

#[cfg(feature = "arrow")]
mod arrow;
mod budget;
mod clock;
mod cloud;
mod cluster_hint;
mod config;
mod control;
mod decoder;
mod detect;
mod detector;
mod encoder;
mod error;
mod excerpt;
mod farthest;
mod field;
#[cfg(test)]
mod golden;
mod grid;
mod kd_tree;
mod length;
mod limits;
mod model;
mod modes;
mod named_options;
mod neighbors;
mod network;
mod nms;
mod nn;
mod options;
mod outliers;
mod point_cloud2;
mod point_source;
mod point_tree;
mod points;
mod printable;
mod progress;
mod query_grid;
mod radius_cells;
mod realtime;
mod refine;
mod rigid_transform;
mod rotations;
mod sampling;
mod scale_hint;
mod scene;
mod setters;
mod side_by_side;
pub mod space;
mod span;
mod spread;
mod surface;
mod threads;
mod tiles;
mod tracker;
mod volume;
mod weights;
mod zero_hint;

#[cfg(feature = "arrow")]
pub use arrow::ArrowPoints;
pub use cloud::{Bounds, Cloud, add_origin, subtract_origin};
pub use cluster_hint::cluster_hint;
pub use config::{ModelConfig, PointEncoder, Scatter, VolumeShape};
pub use control::{CancelFlag, Control, Counter};
pub use detect::{Counts, Detection, Keypoint, Timing};
pub use detector::Detector;
pub use error::{Error, Result};
#[doc(hidden)]
pub use excerpt::excerpt;
pub use field::Field;
pub use grid::Grid;
pub use length::Length;
pub use limits::Limits;
#[cfg(feature = "builtin-models")]
pub use model::Builtin;
pub use model::Model;
pub use named_options::with_named_values;
pub use nms::Fate;
pub use options::{DetectOptions, EncodeOptions, MeshOptions, Options, Preset, RefineMethod, Selection};
pub use outliers::Outliers;
pub use point_cloud2::{PointCloud2Layout, PointCloud2View, PointField};
pub use point_source::{PointSource, SeparateAxes};
pub use points::{Normalization, NormalizationMethod, Point};
#[doc(hidden)]
pub use printable::{is_harmful, printable};
pub use progress::{Progress, Stage};
pub use rigid_transform::RigidTransform;
pub use scale_hint::scale_hint;
pub use scene::scene_signs;
pub use side_by_side::side_by_side;
pub use snake_kernels::SimdLevel;
pub use surface::Mesh;
pub use threads::check_num_threads;
pub use tiles::{Candidate, TileCandidates, TileDetector, TileSettings, by_rank};
pub use tracker::{Tracker, TrackerOptions};
pub use volume::{Volume, VolumeFrame};
pub use zero_hint::zero_hint;

/// The README's example runs as a test.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct ReadMe;

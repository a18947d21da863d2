//! The base of snake-rs: point clouds and their analysis without a network.
//!
//! ```text
//! source/     other programs' clouds → points      transform/  rigid transforms, rotations
//! clouds/     points, lengths, outliers, results    near/       neighbours
//! text/       text that is safe to show in errors   subset/     suppression, samples
//! ```
//!
//! | question | structure |
//! |---|---|
//! | nearest points, or all within any radius, in f64 or f32 | [`KdTree`] (kiddo's tree) |
//! | the same in f64, with normals, covariances and the resolution | [`Neighbors`], on that tree |
//! | all candidates within one radius | [`RadiusCells`], on [`CellGroups`], the points of each cell |
//! | the nearest point, of a cloud or of each keypoint | [`PointTree`] |
//! | the nearest point within one distance, for every step of ICP | `NearGrid` of snake-registration, cells of a box |
//!
//! Lengths are in the units of the cloud. Results have the same bits for any number of threads.

#![forbid(unsafe_code)]

mod clouds;
mod error;
mod near;
mod options;
mod parallel;
mod record;
mod setters;
mod source;
mod subset;
mod text;
mod transform;

pub use clouds::{
    Bounds, Cloud, Covariance, FinitePoints, Keypoint, Length, Mesh, Normalization, NormalizationMethod, Outliers,
    Point, Reach, Sensor, add_origin, check_extent, check_pairs, check_points, gaps, one_a_cell, resolution,
    subtract_origin, unit,
};
pub use error::{Error, Result};
pub use near::{CellGroups, KdTree, Neighbors, PointTree, RadiusCells, Vector, eigen, floor, least_spread, vector};
pub use options::{OptionGroup, OptionInfo, OptionKind};
#[doc(hidden)]
pub use options::{Ranged, check_range};
pub use parallel::{Items, chunks_in_parallel, in_parallel, some_in_parallel, try_chunks_in_parallel, try_in_parallel};
pub use record::{Record, RecordField, RecordInfo, RecordKind, RecordValue};
pub use source::{PointCloud2Layout, PointCloud2View, PointField, PointSource, SeparateAxes};
pub use subset::{
    Fate, by_falling_score, drawn, farthest_points, keep_apart, keep_in_order, lot, nearest_points, sample, suppress,
    suppress_ranked, suppress_seen, suppress_to_count,
};
#[doc(hidden)]
pub use text::{excerpt, is_harmful, printable, shortened, shortened_value};
pub use transform::{RigidTransform, rotations};

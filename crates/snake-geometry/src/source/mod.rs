//! Clouds in the memory of other programs.

#[cfg(feature = "arrow")]
mod arrow;
mod point_cloud2;
mod point_source;

#[cfg(feature = "arrow")]
pub use arrow::ArrowPoints;
pub use point_cloud2::{PointCloud2Layout, PointCloud2View, PointField};
pub use point_source::{PointSource, SeparateAxes};

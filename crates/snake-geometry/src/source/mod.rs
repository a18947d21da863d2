//! Clouds in the memory of other programs.

mod point_cloud2;
mod point_source;

pub use point_cloud2::{PointCloud2Layout, PointCloud2View, PointField};
pub use point_source::{PointSource, SeparateAxes};

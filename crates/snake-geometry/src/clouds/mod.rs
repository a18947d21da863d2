//! Points in the units of their cloud, and the results for them.

mod cloud;
mod covariance;
mod dense_core;
mod housing;
mod keypoint;
mod length;
mod mesh;
mod missing;
mod outliers;
mod points;
mod sensor;

pub use cloud::{Bounds, Cloud, add_origin, subtract_origin};
pub use covariance::Covariance;
pub use keypoint::Keypoint;
pub use length::{Length, gaps, one_a_cell, resolution};
pub use mesh::{Mesh, unit};
pub use outliers::{Outliers, Reach};
pub use points::{FinitePoints, Normalization, NormalizationMethod, Point, check_extent, check_pairs, check_points};
pub use sensor::Sensor;

//! Neighbours of points. The table of the crate says which structure answers which question.

#[cfg(test)]
pub(crate) mod hard_clouds;
mod kd_tree;
mod neighbors;
mod point_tree;
mod radius_cells;

pub use kd_tree::KdTree;
pub use neighbors::{Neighbors, Vector, eigen, least_spread, vector};
pub use point_tree::PointTree;
pub use radius_cells::RadiusCells;

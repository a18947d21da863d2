//! Neighbours of points. A table in the crate's documentation says which structure to use.

mod cell_groups;
#[cfg(test)]
pub(crate) mod hard_clouds;
mod kd_tree;
mod neighbors;
mod point_tree;
mod radius_cells;

pub use cell_groups::{CellGroups, floor};
pub use kd_tree::KdTree;
pub use neighbors::{Neighbors, Vector, eigen, least_spread, vector};
pub use point_tree::PointTree;
pub use radius_cells::RadiusCells;

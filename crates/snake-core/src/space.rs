//! Neighbour queries and checks of points, for this crate and for crates that build on it.

pub use crate::farthest::farthest_points;
pub use crate::kd_tree::KdTree;
pub use crate::length::{gaps, resolution};
pub use crate::neighbors::{Neighbors, Vector, eigen, vector};
pub use crate::nms::{nearest_points, suppress_ranked};
pub use crate::points::{FinitePoints, check_points};
pub use crate::spread::suppress_to_count;

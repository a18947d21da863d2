//! Neighbour queries and checks of points, for this crate and for crates that build on it.

pub use snake_geometry::farthest_points;
pub use snake_geometry::KdTree;
pub use snake_geometry::{gaps, resolution};
pub use snake_geometry::{Neighbors, Vector, eigen, vector};
pub use snake_geometry::{nearest_points, suppress_ranked};
pub use snake_geometry::{FinitePoints, check_points};
pub use snake_geometry::suppress_to_count;

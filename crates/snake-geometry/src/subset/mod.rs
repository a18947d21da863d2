//! Subsets of points: suppression, samples, farthest points.

mod farthest;
mod nms;
mod sampling;
mod spread;

pub use farthest::farthest_points;
pub use nms::{
    Fate, by_falling_score, keep_apart, keep_in_order, nearest_points, suppress, suppress_ranked, suppress_seen,
};
pub(crate) use sampling::mixed;
pub use sampling::{drawn, lot, sample};
pub use spread::suppress_to_count;

//! The six steps of [`register`](crate::register()), functions that you can replace by your own:
//!
//! ```text
//! prepare → describe → match_rows → consensus → refine → judge
//! ```
//!
//! [`prepare()`] downsamples and measures clouds; a prepared cloud serves any number of pairs. For a [`Pair`],
//! [`describe()`] computes descriptors, [`match_rows()`] matches them, and [`consensus()`] searches for transforms.
//! [`refine()`] turns the transforms into candidates, best first. [`judge()`] compares the best candidate with the
//! others. [`challenge()`] compares it with rotations and shifts that the search may have missed.

pub mod consensus;
pub mod describe;
pub mod judge;
pub mod match_rows;
mod matches;
mod pair;
pub mod prepare;
pub mod refine;
pub(crate) mod single_matches;

pub use consensus::consensus;
pub use describe::{Rows, describe};
pub use judge::{challenge, judge};
pub use match_rows::match_rows;
pub use matches::{Criteria, Match};
pub use pair::Pair;
pub use prepare::{Lengths, PreparedCloud, PreparedClouds, VoxelCloud, prepare};
pub use refine::{Candidate, approach, refine};

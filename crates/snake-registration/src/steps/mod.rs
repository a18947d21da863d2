//! The six steps of [`register`](crate::register()), each a function that yours can replace:
//!
//! ```text
//! prepare → describe → match_rows → consensus → refine → judge
//! ```
//!
//! [`prepare()`] downsamples and measures clouds, which can be kept for any number of pairs. A
//! [`Pair`] of them is described by [`describe()`], matched by [`match_rows()`], and searched for
//! transforms by [`consensus()`]. [`refine()`] makes candidates of transforms, best first, and
//! [`judge()`] weighs the best against the others, and [`challenge()`] against turns and shifts that
//! the search need not have met.

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

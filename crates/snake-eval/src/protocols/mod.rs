//! Steps of benchmarks whose protocol fixes them.

mod ransac;

pub use ransac::{Consensus, RansacOptions, ransac};

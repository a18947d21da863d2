//! The checks of the fuzz targets, which the tests of `snake-io` share.

#[path = "../../crates/snake-io/tests/checks/mod.rs"]
mod checks;

pub use checks::{load_model, read_cloud};

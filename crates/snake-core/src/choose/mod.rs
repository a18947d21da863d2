//! Which model a cloud gets, with which options: one rule for the command line, Python, C and Rust.

#[cfg(feature = "builtin-models")]
mod chooser;
mod cloud_note;
mod few_voxels;
#[cfg(feature = "builtin-models")]
mod network;
#[cfg(feature = "builtin-models")]
mod rule;

#[cfg(feature = "builtin-models")]
pub use self::chooser::{Chooser, Chosen, ChosenBy, NamedModel};

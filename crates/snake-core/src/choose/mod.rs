//! Which model a cloud gets, with which options: one rule for the command line, Python, C and Rust.

#[cfg(feature = "builtin-models")]
mod chooser;
#[cfg(feature = "builtin-models")]
mod rule;
mod scale_hint;

#[cfg(feature = "builtin-models")]
pub use self::chooser::{Chooser, Chosen, ChosenBy, NamedModel};
pub use self::scale_hint::scale_hint;

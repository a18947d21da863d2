//! Which model a cloud gets, with which options: one rule for the command line, Python, C and Rust.

#[cfg(feature = "builtin-models")]
mod chooser;
#[cfg(feature = "builtin-models")]
mod model_choice;
#[cfg(feature = "builtin-models")]
mod rule;
mod scale_hint;

#[cfg(feature = "builtin-models")]
pub use self::chooser::{Chooser, Chosen, ChosenBy};
#[cfg(feature = "builtin-models")]
pub use self::model_choice::{BuiltinModels, ModelChoice, NamedModel};
pub use self::scale_hint::scale_hint;

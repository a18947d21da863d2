//! Words of errors that are safe to show.

mod excerpt;
mod printable;

pub use excerpt::excerpt;
pub use printable::{is_harmful, printable};

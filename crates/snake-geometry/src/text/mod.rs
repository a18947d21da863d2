//! Words of errors that are safe to show.

mod excerpt;
mod printable;
mod shortened;

pub use excerpt::excerpt;
pub use printable::{is_harmful, printable};
pub use shortened::{shortened, shortened_value};

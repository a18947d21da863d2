//! Text that is safe to show in errors.

mod excerpt;
mod printable;
mod shortened;

pub use excerpt::excerpt;
pub use printable::{is_harmful, printable};
pub use shortened::{shortened, shortened_value};

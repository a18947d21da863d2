//! Pictures.

pub mod canvas;
pub mod colormap;
pub mod figure;

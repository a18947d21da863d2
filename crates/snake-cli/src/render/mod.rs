//! Pictures and web pages.

pub mod canvas;
pub mod colormap;
pub mod figure;
pub mod page;

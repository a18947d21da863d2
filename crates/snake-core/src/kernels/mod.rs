//! The arithmetic, and the only place with `unsafe`: each public function picks the code compiled for this processor.
//!
//! Every kernel is written once, as plain loops over [`simd::Lanes`], and compiled once per [`SimdLevel`].
//! `naive.rs` holds the textbook version of each, which the tests compare with.
//!
//! Work is parallel over outputs, never over a sum, so the bits of a result do not depend on the number of threads.
#![allow(unsafe_code)]

mod blank;
mod group_norm;
mod linear;
#[cfg(test)]
mod naive;
mod simd;
mod trilinear;
mod winograd;

pub(crate) use blank::Blank;
pub(crate) use group_norm::{GroupNorm, channel_sums};
pub(crate) use linear::{PackedLinear, Then, linear};
pub use simd::SimdLevel;
pub(crate) use trilinear::{Corners, interpolate, interpolate_backward};
pub(crate) use winograd::{Conv3d, PackedConv3d, Source, conv3d};

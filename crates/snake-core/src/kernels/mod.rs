//! The arithmetic, and the only place with `unsafe`: each public function picks the code compiled for this processor.
//!
//! Every kernel is written once, as plain loops over [`simd::Lanes`], and compiled once per [`SimdLevel`].
//! `naive.rs` holds the textbook version of each, which the tests compare with.
//!
//! Work is parallel over outputs, never over a sum, so the bits of a result do not depend on the number of threads.
#![allow(unsafe_code)]

mod conv3d;
mod group_norm;
mod linear;
#[cfg(test)]
mod naive;
mod simd;
mod trilinear;

pub(crate) use conv3d::{PackedConv3d, conv3d};
pub(crate) use group_norm::{group_statistics, normalize_into_padded};
pub(crate) use linear::{PackedLinear, linear};
pub use simd::SimdLevel;
pub(crate) use trilinear::{Corners, interpolate};

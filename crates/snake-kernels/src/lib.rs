//! The arithmetic of [snake-rs](https://crates.io/crates/snake-core): kernels on slices, compiled for each SIMD level of
//! the processor.
//!
//! | kernel | layout |
//! |---|---|
//! | [`linear()`] | rows of features `(rows, width)` |
//! | [`conv3d()`] | volumes `[z][y][x][channel]`; applies [`GroupNorm`] while reading and ReLU while writing |
//! | [`conv3d_blocks()`] | blocks of a sparse volume `[block][z][y][x][channel]` |
//! | [`ConstantRegion`] | tiles of a volume that repeat each other, which [`conv3d()`] copies |
//! | [`relu`], [`max_rows`], [`add_weighted`], [`nearest_row`] | rows of features |
//! | [`interpolate`], [`interpolate_backward`] | trilinearly interpolated features of queries, and their gradient |
//!
//! Every kernel is written once, as plain loops over the lanes of a register, and compiled once for each [`SimdLevel`].
//! The tests compare each kernel with a textbook version in float64. Work is parallel over outputs, never over a sum, so
//! results have the same bits for any number of threads.
//!
//! Only this crate and `snake-capi` have `unsafe` code. A [`SimdLevel`] can only come from detection, so no safe call
//! runs an instruction that the processor lacks.
//!
//! ```
//! use snake_kernels::{Epilogue, PackedLinear, SimdLevel, linear};
//!
//! let layer = PackedLinear::new(2, 1, &[3.0, 4.0], &[0.5]);
//! let mut output = [0.0; 2];
//! linear(SimdLevel::current(), &layer, &[1.0, 1.0, -1.0, 0.0], &mut output, Epilogue::Relu);
//! assert_eq!(output, [7.5, 0.0]);
//! ```
#![allow(unsafe_code)]

mod buffer_pool;
mod constant_region;
mod conv3d;
mod group_norm;
mod linear;
#[cfg(test)]
mod naive;
mod rows;
mod simd;
mod trilinear;

pub use buffer_pool::{Buffer, BufferPool};
pub use constant_region::ConstantRegion;
pub use conv3d::{
    BLOCK_SIDE, BLOCK_VOXELS, BlockActivation, BlockConv3d, BlockSource, Conv3d, PackedConv3d, Source, conv3d,
    conv3d_blocks,
};
pub use group_norm::{GroupNorm, channel_sums};
pub use linear::{Epilogue, PackedLinear, linear};
pub use rows::{add_weighted, max_rows, nearest_row, relu};
pub use simd::SimdLevel;
pub use trilinear::{Corners, interpolate, interpolate_backward};

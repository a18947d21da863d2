//! 3x3x3 convolution of a normalised, zero-padded volume by Winograd's minimal filtering, then ReLU.
//!
//! Along one axis, M outputs of a 3-tap filter g need N = M + 2 products instead of 3 M. The filter and its N inputs d
//! are polynomials, which are multiplied by their values at N points; one point is infinity (Toom and Cook). For M = 2
//! the other points are 0, 1 and -1:
//!
//! ```text
//! V = (d0 - d2, d1 + d2, d2 - d1, d1 - d3)        U = (g0, (g0 + g1 + g2) / 2, (g0 - g1 + g2) / 2, g2)
//! y = (V0 U0 + V1 U1 + V2 U2, V1 U1 - V2 U2 - V3 U3)
//! ```
//!
//! For M = 4 the points are 0, ±11/16 and ±23/16. They keep the rounding error near that of a plain sum; the usual points
//! 0, ±1 and ±2 make it four times as large. Over three axes, a tile of 4x4x4 outputs needs 216 products instead of 1728
//! for each pair of channels, 8 times fewer; a tile of 2x2x2 needs 64 instead of 216. The products of many tiles at one of
//! the N³ points are a matrix product. Larger tiles need more transformed weights, so small volumes use the small tiles.
//!
//! A coarser input that is upsampled by two is read in place. With M = 2 it has d1 = d2, so V2 = 0 along every axis and 27
//! of the 64 points remain. A block of 4x4x4 outputs needs as many products as with M = 4, but an eighth of the weights.

mod blocks;
mod pack;
mod products;
#[cfg(test)]
mod tests;
mod transform;

use std::cell::RefCell;

use rayon::prelude::*;

use crate::SimdLevel;
use crate::buffer_pool::in_huge_page;
use crate::constant_region::copy_constant_tiles;
use crate::group_norm::add_in_order;
use crate::simd::{LANES, Lanes, simd_levels};

pub use self::blocks::{BLOCK_SIDE, BLOCK_VOXELS, BlockActivation, BlockConv3d, BlockSource, conv3d_blocks};
pub use self::pack::PackedConv3d;
use self::pack::{BLOCK, Block, points};
use self::products::multiply;
use self::transform::{MAX_TILE, Partial, transform_inputs, transform_outputs};

/// With M = 4, the points other than 0 and infinity are plus and minus these two.
const NEAR: f64 = 11.0 / 16.0;
const FAR: f64 = 23.0 / 16.0;

/// One input volume of a convolution. The channels of several sources are concatenated.
#[derive(Debug, Clone, Copy)]
pub struct Source<'a> {
    /// Values `[z][y][x][channel]`; half the output's size along each axis if the volume is upsampled.
    pub values: &'a [f32],
    /// Channels of this volume.
    pub channels: usize,
    /// Whether the volume is upsampled by two, by nearest neighbour.
    pub upsampled: bool,
}

/// The arguments of [`conv3d`].
#[derive(Debug, Clone, Copy)]
pub struct Conv3d<'a> {
    /// Weights of the convolution.
    pub layer: &'a PackedConv3d,
    /// The output's D, H, W.
    pub size: [usize; 3],
    /// Input volumes.
    pub sources: &'a [Source<'a>],
    /// Factor of each input channel, applied before the convolution.
    pub scale: &'a [f32],
    /// Offset of each input channel, added after the factor.
    pub shift: &'a [f32],
    /// For each tile, the tile of which it is a copy, from [`ConstantRegion::originals`](crate::ConstantRegion::originals).
    /// Empty: every tile is computed.
    pub originals: &'a [Option<u32>],
}

/// The part of the output that one task computes: the rows of tiles from `row` on, in the tile plane `plane`.
struct Task<'a> {
    plane: usize,
    row: usize,
    /// M planes of voxels; planes beyond the end of the volume are empty. Each slice holds the rows of this task.
    planes: [&'a mut [f32]; MAX_TILE],
}

impl Task<'_> {
    /// Splits a task after `rows` rows of tiles, which have `share` values in each plane of voxels.
    fn split(self, rows: usize, share: usize) -> [Self; 2] {
        let mut rest: [&mut [f32]; MAX_TILE] = Default::default();
        let mut first = self.planes;
        for (first, rest) in first.iter_mut().zip(&mut rest) {
            let whole = std::mem::take(first);
            (*first, *rest) = whole.split_at_mut(share.min(whole.len()));
        }
        [Self { planes: first, ..self }, Self { plane: self.plane, row: self.row + rows, planes: rest }]
    }
}

/// Tiles, transformed inputs and products of a task.
#[derive(Default)]
struct Buffers {
    values: Values,
    /// The rows and places of the tiles to compute.
    tiles: Vec<[usize; 2]>,
}

/// Memory of transformed inputs and products. Their points lie far apart: in small pages, each access would wait for its address.
#[derive(Default)]
struct Values {
    memory: Vec<f32>,
    /// The index at which the huge page begins.
    first: usize,
}

impl Values {
    /// Slices for so many inputs and products. Old contents stay if the memory is long enough.
    fn parts(&mut self, inputs: usize, products: usize) -> [&mut [f32]; 2] {
        if self.memory.len() < self.first + inputs + products {
            (self.memory, self.first) = in_huge_page(inputs + products);
        }
        let (inputs, rest) = self.memory[self.first..].split_at_mut(inputs);
        [inputs, &mut rest[..products]]
    }
}

thread_local! {
    /// Kept between tasks, because new memory costs more than the arithmetic on it.
    static BUFFERS: RefCell<Buffers> = RefCell::default();
}

/// Normalises the sources (`value * scale + shift`), pads them with zeros, convolves and applies the ReLU. `output` is
/// `[z][y][x][channel]`. Returns the sum and the sum of squares of each output channel, in float64 and in a fixed order.
///
/// `stop` is called before each of the many parts of the work. Once it returns true, the remaining parts are skipped, and
/// output and sums must not be used.
///
/// # Panics
/// If a slice is shorter than the sizes say.
pub fn conv3d(level: SimdLevel, conv: &Conv3d, stop: &(dyn Fn() -> bool + Sync), output: &mut [f32]) -> Vec<[f64; 2]> {
    let &Conv3d { layer, size, originals, .. } = conv;
    let [_, height, width] = size;
    let plane = height * width * layer.outputs;
    let tile_rows = height.div_ceil(layer.tile);
    let batch = if layer.tile == 2 { BATCH_2 } else { BATCH_4 };
    // If many tiles are copies, a task spans more rows to find enough tiles to compute.
    let rows_factor = if originals.is_empty() { 1 } else { 4 };
    let rows = (rows_factor * batch / width.div_ceil(layer.tile)).clamp(1, tile_rows);
    let share = layer.tile * rows * width * layer.outputs;
    let tasks_of_plane = tile_rows.div_ceil(rows);
    let mut partial = vec![[0.0; 2]; size[0].div_ceil(layer.tile) * tasks_of_plane * layer.outputs];
    let run = |task: Task, sums: &mut [[f64; 2]]| {
        if !stop() {
            BUFFERS.with_borrow_mut(|buffers| conv3d_task(level, conv, buffers, task, sums));
        }
    };
    let sums_of_plane = partial.par_chunks_mut(tasks_of_plane * layer.outputs);
    output.par_chunks_mut(layer.tile * plane).zip(sums_of_plane).enumerate().for_each(|(z, (planes, sums))| {
        let mut planes = planes.chunks_mut(plane);
        let planes = std::array::from_fn(|_| planes.next().unwrap_or_default());
        divide(Task { plane: z, row: 0, planes }, sums, layer.outputs, [rows, share], &run);
    });
    let mut sums = add_in_order(&partial, layer.outputs);
    if !originals.is_empty() {
        copy_constant_tiles(originals, layer.tile, size, layer.outputs, output, &mut sums);
    }
    sums
}

/// Runs a task in parts of `rows` rows of tiles, with `share` values in each plane of voxels and `outputs` sums each.
fn divide(
    task: Task,
    sums: &mut [[f64; 2]],
    outputs: usize,
    [rows, share]: [usize; 2],
    run: &(impl Fn(Task, &mut [[f64; 2]]) + Sync),
) {
    let half = sums.len() / outputs / 2;
    if half == 0 {
        return run(task, sums);
    }
    let [first, rest] = task.split(half * rows, half * share);
    let (sums_of_first, sums_of_rest) = sums.split_at_mut(half * outputs);
    let part = [rows, share];
    rayon::join(|| divide(first, sums_of_first, outputs, part, run), || divide(rest, sums_of_rest, outputs, part, run));
}

/// Tiles that are multiplied together, with M = 2 and M = 4: their transforms stay in the second-level cache.
const BATCH_2: usize = 32;
const BATCH_4: usize = 24;

simd_levels! {
    fn conv3d_task(conv: &Conv3d, buffers: &mut Buffers, task: Task, sums: &mut [[f64; 2]]) = conv3d_task_body
}

#[inline(always)]
fn conv3d_task_body<L: Lanes, const ROWS: usize>(
    token: L::Token,
    conv: &Conv3d,
    buffers: &mut Buffers,
    task: Task,
    sums: &mut [[f64; 2]],
) {
    match conv.layer.tile {
        2 => conv3d_tiles::<L, ROWS, 4>(token, conv, buffers, task, sums, BATCH_2),
        _ => conv3d_tiles::<L, ROWS, 6>(token, conv, buffers, task, sums, BATCH_4),
    }
}

#[inline(always)]
fn conv3d_tiles<L: Lanes, const ROWS: usize, const N: usize>(
    token: L::Token,
    conv: &Conv3d,
    buffers: &mut Buffers,
    mut task: Task,
    sums: &mut [[f64; 2]],
    batch: usize,
) {
    let &Conv3d { layer, size, originals, .. } = conv;
    let [tile_rows, tiles_along] = [size[1].div_ceil(N - 2), size[2].div_ceil(N - 2)];
    let rows = (task.planes[0].len() / (size[2] * layer.outputs)).div_ceil(N - 2);
    let Buffers { values, tiles } = buffers;
    tiles.clear();
    for row in task.row..task.row + rows {
        for x in 0..tiles_along {
            let tile = (task.plane * tile_rows + row) * tiles_along + x;
            if originals.get(tile).copied().flatten().is_none_or(|original| original as usize == tile) {
                tiles.push([row, x]);
            }
        }
    }
    let output_blocks = layer.outputs.div_ceil(LANES);
    let mut partial = Partial::<L, N>::new(token);
    for tiles in tiles.chunks(batch) {
        let gather = TilesOfPlane { conv, plane: task.plane, tiles };
        let (products, product_pitch) = multiply_tiles::<L, ROWS, N>(token, layer, tiles.len(), &gather, values);
        for (tile, &[row, x]) in tiles.iter().enumerate() {
            for out in 0..output_blocks {
                let products = &products[out * product_pitch + tile * LANES..];
                let place = [row - task.row, x, out];
                let pitch = output_blocks * product_pitch;
                transform_outputs::<L, N>(conv, products, pitch, &mut partial, place, &mut task, sums);
            }
        }
    }
}

/// Reads the inputs of the tiles of a batch, from a dense or a sparse volume.
trait Gather {
    /// Transforms the block's input channels of each tile to V. `to` has `pitch` values per point, and the block's width per tile.
    fn transform<L: Lanes, const N: usize>(&self, token: L::Token, block: &Block, to: &mut [f32], pitch: usize);

    /// Prefetches one of `_parts` equal parts of the inputs of the next batch.
    #[inline(always)]
    fn fetch_ahead<L: Lanes>(&self, _part: usize, _parts: usize) {}
}

/// Tiles `[row, x]` of one plane of tiles.
struct TilesOfPlane<'a> {
    conv: &'a Conv3d<'a>,
    plane: usize,
    tiles: &'a [[usize; 2]],
}

impl Gather for TilesOfPlane<'_> {
    #[inline(always)]
    fn transform<L: Lanes, const N: usize>(&self, token: L::Token, block: &Block, to: &mut [f32], pitch: usize) {
        for half in 0..block.channels.div_ceil(LANES) {
            transform_inputs::<L, N>(token, self, block, half, &mut to[half * LANES..], pitch);
        }
    }
}

/// The products of a batch of tiles at all points, `[point][output block][tile][lane]`, and the stride between points.
#[inline(always)]
fn multiply_tiles<'a, L: Lanes, const ROWS: usize, const N: usize>(
    token: L::Token,
    layer: &PackedConv3d,
    num_tiles: usize,
    gather: &impl Gather,
    values: &'a mut Values,
) -> (&'a [f32], usize) {
    let output_blocks = layer.outputs.div_ceil(LANES);
    let padded_tiles = num_tiles.next_multiple_of(ROWS);
    // One additional cache line keeps the points out of the same cache sets.
    let product_pitch = padded_tiles * LANES + LANES;
    let num_inputs = N * N * N * (padded_tiles * BLOCK + LANES);
    let [inputs, products] = values.parts(num_inputs, N * N * N * output_blocks * product_pitch);
    for (number, block) in layer.blocks.iter().enumerate() {
        let input_pitch = padded_tiles * block.width() + LANES;
        gather.transform::<L, N>(token, block, inputs, input_pitch);
        for (k, p) in points(N, block.upsampled).enumerate() {
            if number == 0 {
                gather.fetch_ahead::<L>(k, N * N * N);
            }
            let inputs = &inputs[p * input_pitch..][..padded_tiles * block.width()];
            let products = &mut products[p * output_blocks * product_pitch..][..output_blocks * product_pitch];
            for (out, products) in products.chunks_exact_mut(product_pitch).enumerate() {
                let from = (k * output_blocks + out) * block.channels;
                let (weights, rest) = block.weights[from..].split_at(block.channels);
                let next = &rest[..rest.len().min(block.channels)];
                multiply::<L, ROWS>(
                    token,
                    inputs,
                    block.width(),
                    weights,
                    next,
                    &mut products[..padded_tiles * LANES],
                    number == 0,
                );
            }
        }
    }
    (products, product_pitch)
}

//! 3x3x3 convolution of a normalised, zero-padded volume by Winograd's F(2x2x2, 3x3x3), then ReLU.
//!
//! Along one axis two outputs of a 3-tap filter g on four inputs d need four products instead of six:
//!
//! ```text
//! V = (d0 - d2, d1 + d2, d2 - d1, d1 - d3)        U = (g0, (g0 + g1 + g2) / 2, (g0 - g1 + g2) / 2, g2)
//! y = (V0 U0 + V1 U1 + V2 U2, V1 U1 - V2 U2 - V3 U3)
//! ```
//!
//! Over three axes a tile of 2x2x2 outputs needs 64 products instead of 216 for each pair of channels. The products of
//! many tiles at one of the 64 points are a matrix product. If the input is a coarser volume upsampled by two, d1 = d2,
//! so V2 = 0 along every axis: 27 of the 64 points remain, and the upsampled volume is never made.

use std::cell::RefCell;

use rayon::prelude::*;

use super::SimdLevel;
use super::blank::copy_blank;
use super::group_norm::add_in_order;
use super::simd::{LANES, Lanes, accumulate_tile, load, pack, simd_levels, store};

/// Input channels of one matrix product.
const BLOCK: usize = 2 * LANES;
/// Tiles of one task, about: their transformed inputs and outputs stay in the second-level cache.
const TASK_TILES: usize = 32;

/// What is convolved: one or two volumes whose channels follow each other.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Source<'a> {
    /// `(D, H, W, channels)`; half of the output's size along each axis if it is to be upsampled.
    pub(crate) values: &'a [f32],
    pub(crate) channels: usize,
    pub(crate) upsampled: bool,
}

/// Up to BLOCK channels of one source.
#[derive(Debug)]
struct Block {
    source: usize,
    /// First channel within the source and within the whole input.
    first: [usize; 2],
    channels: usize,
    /// `[point][output block][channel][lane]`; only the points that are not zero.
    weights: Vec<[f32; LANES]>,
    upsampled: bool,
}

/// Weights of a 3x3x3 convolution without bias, transformed and packed.
#[derive(Debug)]
pub(crate) struct PackedConv3d {
    pub(crate) outputs: usize,
    blocks: Vec<Block>,
}

/// The points of a source: all 64, or those without a 2 along any axis.
fn points(upsampled: bool) -> impl Iterator<Item = usize> {
    (0..64).filter(move |p| !upsampled || [p / 16, p / 4 % 4, p % 4].iter().all(|&k| k != 2))
}

impl PackedConv3d {
    /// From weights `(outputs, inputs, 3, 3, 3)` in the order z, y, x; `sources` are the channels of each source and
    /// whether it is upsampled.
    pub(crate) fn new(sources: &[(usize, bool)], outputs: usize, weight: &[f32]) -> Self {
        let inputs: usize = sources.iter().map(|s| s.0).sum();
        let transform = |[a, b, c]: [f64; 3]| [a, 0.5 * (a + b + c), 0.5 * (a - b + c), c];
        // The transformed filter of one pair of channels: z, y, x in turn.
        let transformed = |output: usize, input: usize| -> [f32; 64] {
            let g = &weight[(output * inputs + input) * 27..][..27];
            let at = |z: usize, y: usize| transform(std::array::from_fn(|x| f64::from(g[(z * 3 + y) * 3 + x])));
            let rows: [[[f64; 4]; 3]; 3] = std::array::from_fn(|z| std::array::from_fn(|y| at(z, y)));
            let planes: [[[f64; 4]; 4]; 3] = std::array::from_fn(|z| {
                let columns: [[f64; 4]; 4] = std::array::from_fn(|x| transform(rows[z].map(|row| row[x])));
                std::array::from_fn(|y| columns.map(|column| column[y]))
            });
            std::array::from_fn(|p| transform(planes.map(|plane| plane[p / 4 % 4][p % 4]))[p / 16] as f32)
        };
        let mut blocks = Vec::new();
        let mut before = 0;
        for (source, &(channels, upsampled)) in sources.iter().enumerate() {
            for first in (0..channels).step_by(BLOCK) {
                let width = BLOCK.min(channels - first);
                let filters: Vec<[f32; 64]> = (0..outputs)
                    .flat_map(|o| (0..width).map(move |k| (o, k)))
                    .map(|(o, k)| transformed(o, before + first + k))
                    .collect();
                let mut weights = Vec::new();
                for p in points(upsampled) {
                    weights.extend(pack(outputs, width, |output, k| filters[output * width + k][p]));
                }
                blocks.push(Block { source, first: [first, before + first], channels: width, weights, upsampled });
            }
            before += channels;
        }
        Self { outputs, blocks }
    }
}

/// One task's share of the output: up to two planes of rows that begin at tile row `row` of tile plane `plane`.
struct Task<'a> {
    plane: usize,
    row: usize,
    planes: [&'a mut [f32]; 2],
}

/// What a task works on: inputs, their transforms and the products.
#[derive(Default)]
struct Scratch {
    /// Row within the task and place along the row of each tile to compute.
    tiles: Vec<[usize; 2]>,
    gathered: Vec<f32>,
    inputs: Vec<f32>,
    products: Vec<f32>,
}

/// The first `length` values, whatever they are.
fn at_least(values: &mut Vec<f32>, length: usize) -> &mut [f32] {
    if values.len() < length {
        values.resize(length, 0.0);
    }
    &mut values[..length]
}

thread_local! {
    /// Kept from task to task: fresh memory costs more than the arithmetic on it.
    static SCRATCH: RefCell<Scratch> = RefCell::default();
}

/// A convolution to carry out.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Conv3d<'a> {
    pub(crate) layer: &'a PackedConv3d,
    /// The output's D, H, W.
    pub(crate) size: [usize; 3],
    pub(crate) sources: &'a [Source<'a>],
    /// Of each input channel.
    pub(crate) scale: &'a [f32],
    pub(crate) shift: &'a [f32],
    /// Of which tile each one is a copy, not to be computed; empty if none is.
    pub(crate) originals: &'a [Option<u32>],
}

/// Normalises the sources (`value * scale + shift`), pads with zeros, convolves, applies ReLU. Returns sum and sum of
/// squares of each output channel, in float64 and in a fixed order.
pub(crate) fn conv3d(level: SimdLevel, conv: &Conv3d, output: &mut [f32]) -> Vec<[f64; 2]> {
    let &Conv3d { layer, size, originals, .. } = conv;
    let [_, height, width] = size;
    let plane = height * width * layer.outputs;
    let rows = (TASK_TILES / width.div_ceil(2)).clamp(1, height.div_ceil(2));
    let share = 2 * rows * width * layer.outputs;
    let mut tasks = Vec::new();
    for (z, pair) in output.chunks_mut(2 * plane).enumerate() {
        let (near, far) = pair.split_at_mut(plane);
        let mut far = far.chunks_mut(share);
        for (task, near) in near.chunks_mut(share).enumerate() {
            tasks.push(Task { plane: z, row: task * rows, planes: [near, far.next().unwrap_or_default()] });
        }
    }
    let partial: Vec<Vec<[f64; 2]>> = tasks
        .into_par_iter()
        .map(|task| {
            let mut sums = vec![[0.0; 2]; layer.outputs];
            SCRATCH.with_borrow_mut(|scratch| {
                conv3d_task(level, conv, scratch, task, &mut sums);
            });
            sums
        })
        .collect();
    let mut sums = add_in_order(&partial, layer.outputs);
    if !originals.is_empty() {
        copy_blank(originals, size, layer.outputs, output, &mut sums);
    }
    sums
}

simd_levels! {
    fn conv3d_task(conv: &Conv3d, scratch: &mut Scratch, task: Task, sums: &mut [[f64; 2]]) = conv3d_task_body
}

#[inline(always)]
fn conv3d_task_body<L: Lanes, const ROWS: usize>(
    conv: &Conv3d,
    scratch: &mut Scratch,
    task: Task,
    sums: &mut [[f64; 2]],
) {
    let &Conv3d { layer, size, originals, .. } = conv;
    let Task { plane, row: first_row, planes } = task;
    let height = planes[0].len() / (size[2] * layer.outputs);
    let [tile_rows, tiles_along] = [size[1].div_ceil(2), size[2].div_ceil(2)];
    let (rows, line_voxels) = (height.div_ceil(2), 2 * tiles_along + 2);
    scratch.tiles.clear();
    for row in 0..rows {
        for x in 0..tiles_along {
            let tile = (plane * tile_rows + first_row + row) * tiles_along + x;
            if originals.get(tile).copied().flatten().is_none_or(|original| original as usize == tile) {
                scratch.tiles.push([row, x]);
            }
        }
    }
    if scratch.tiles.is_empty() {
        return;
    }
    let padded_tiles = scratch.tiles.len().next_multiple_of(ROWS);
    // One cache line more than a power of two, so that the 64 points do not fall into the same cache sets.
    let input_pitch = padded_tiles * BLOCK + LANES;
    let output_blocks = layer.outputs.div_ceil(LANES);
    let product_pitch = padded_tiles * LANES + LANES;
    let gathered = at_least(&mut scratch.gathered, 4 * (2 * rows + 2) * line_voxels * BLOCK);
    let inputs = at_least(&mut scratch.inputs, 64 * input_pitch);
    let products = at_least(&mut scratch.products, 64 * output_blocks * product_pitch);
    for (number, block) in layer.blocks.iter().enumerate() {
        gather::<L>(conv, block, [plane, first_row, rows], gathered);
        let strides = [(2 * rows + 2) * line_voxels * BLOCK, line_voxels * BLOCK];
        for (tile, [row, x]) in scratch.tiles.iter().enumerate() {
            for half in 0..block.channels.div_ceil(LANES) {
                let from = &gathered[(2 * row * line_voxels + 2 * x) * BLOCK + half * LANES..];
                let to = &mut inputs[tile * BLOCK + half * LANES..];
                transform_input::<L>(from, strides, to, input_pitch);
            }
        }
        for (k, p) in points(block.upsampled).enumerate() {
            let inputs = &inputs[p * input_pitch..][..padded_tiles * BLOCK];
            let weights = &block.weights[k * output_blocks * block.channels..][..output_blocks * block.channels];
            let products = &mut products[p * output_blocks * product_pitch..][..output_blocks * product_pitch];
            let weights = weights.chunks_exact(block.channels);
            for (weights, products) in weights.zip(products.chunks_exact_mut(product_pitch)) {
                multiply::<L, ROWS>(inputs, weights, &mut products[..padded_tiles * LANES], number == 0);
            }
        }
    }
    for (tile, [row, x]) in scratch.tiles.iter().enumerate() {
        for out in 0..output_blocks {
            let lanes = LANES.min(layer.outputs - out * LANES);
            let products = &products[out * product_pitch + tile * LANES..];
            let (mut sum, mut squares) = (L::splat(0.0), L::splat(0.0));
            for (k, values) in transform_output::<L>(products, output_blocks * product_pitch).into_iter().enumerate() {
                let (z, y, x) = (k / 4, 2 * row + k / 2 % 2, 2 * x + k % 2);
                if planes[z].is_empty() || y >= height || x >= size[2] {
                    continue;
                }
                store(values, &mut planes[z][(y * size[2] + x) * layer.outputs + out * LANES..], lanes);
                sum = sum.plus(values);
                squares = values.multiply_add(values, squares);
            }
            let totals = sum.to_array().into_iter().zip(squares.to_array());
            for (total, (sum, squares)) in sums[out * LANES..][..lanes].iter_mut().zip(totals) {
                total[0] += f64::from(sum);
                total[1] += f64::from(squares);
            }
        }
    }
}

/// Writes the block's channels of all inputs of a task at `[plane, row, rows]`, normalised and padded with zeros, as
/// `(4, 2 rows + 2, W + 2, BLOCK)`, W rounded up to even.
#[inline(always)]
fn gather<L: Lanes>(conv: &Conv3d, block: &Block, [plane, row, rows]: [usize; 3], gathered: &mut [f32]) {
    let &Conv3d { size, sources, scale, shift, .. } = conv;
    let source = &sources[block.source];
    let [first, global] = block.first;
    let mut factors = [[[0.0; LANES]; 2]; 2];
    for (lanes, values) in factors.iter_mut().zip([scale, shift]) {
        lanes.as_flattened_mut()[..block.channels].copy_from_slice(&values[global..][..block.channels]);
    }
    let repeats = if source.upsampled { 2 } else { 1 };
    let line = (size[2].next_multiple_of(2) + 2) * BLOCK;
    for (number, line) in gathered.chunks_exact_mut(line).enumerate() {
        let z = (2 * plane + number / (2 * rows + 2)).wrapping_sub(1);
        let y = (2 * row + number % (2 * rows + 2)).wrapping_sub(1);
        if z >= size[0] || y >= size[1] {
            line.fill(0.0);
            continue;
        }
        let voxels = line.as_chunks_mut::<BLOCK>().0;
        voxels[0].fill(0.0);
        voxels[size[2] + 1..].as_flattened_mut().fill(0.0);
        let [z, y, width] = [z, y, size[2]].map(|n| n / repeats);
        let from = &source.values[(z * size[1] / repeats + y) * width * source.channels..][..width * source.channels];
        for (voxels, from) in voxels[1..].chunks_exact_mut(repeats).zip(from.chunks_exact(source.channels)) {
            for half in 0..block.channels.div_ceil(LANES) {
                let lanes = LANES.min(block.channels - half * LANES);
                let value = load::<L>(&from[first + half * LANES..], lanes)
                    .multiply_add(L::load(&factors[0][half]), L::load(&factors[1][half]));
                for voxel in &mut *voxels {
                    store(value, &mut voxel[half * LANES..], LANES);
                }
            }
        }
    }
}

/// V of LANES channels of a tile, one row of lanes at each multiple of `pitch`, from its 4x4x4 inputs, which are
/// `strides` apart along z and y and BLOCK along x.
#[inline(always)]
fn transform_input<L: Lanes>(from: &[f32], [z_stride, y_stride]: [usize; 2], to: &mut [f32], pitch: usize) {
    let mut rows = [[L::splat(0.0); 4]; 16];
    for (zy, row) in rows.iter_mut().enumerate() {
        let line = &from[zy / 4 * z_stride + zy % 4 * y_stride..][..3 * BLOCK + LANES];
        for (x, value) in row.iter_mut().enumerate() {
            *value = load(&line[x * BLOCK..], LANES);
        }
        *row = inputs_of_axis(*row);
    }
    for [first, second, third, fourth] in rows.as_chunks_mut().0 {
        for (((a, b), c), d) in first.iter_mut().zip(second).zip(third).zip(fourth) {
            [*a, *b, *c, *d] = inputs_of_axis([*a, *b, *c, *d]);
        }
    }
    for y in 0..4 {
        for x in 0..4 {
            let column = inputs_of_axis([rows[y][x], rows[4 + y][x], rows[8 + y][x], rows[12 + y][x]]);
            for (z, value) in column.iter().enumerate() {
                store(*value, &mut to[(z * 16 + y * 4 + x) * pitch..], LANES);
            }
        }
    }
}

// The bodies of kernels are loops and functions marked for inlining: a closure would be compiled without the level's
// instructions.

/// V of four inputs along an axis.
#[inline(always)]
fn inputs_of_axis<L: Lanes>(d: [L; 4]) -> [L; 4] {
    [d[0].minus(d[2]), d[1].plus(d[2]), d[2].minus(d[1]), d[1].minus(d[3])]
}

/// The two outputs of four products along an axis.
#[inline(always)]
fn outputs_of_axis<L: Lanes>(m: [L; 4]) -> [L; 2] {
    [m[0].plus(m[1]).plus(m[2]), m[1].minus(m[2]).minus(m[3])]
}

/// `products (tiles, LANES) += inputs (tiles, BLOCK) weights (channels, LANES)`; `fresh` starts from zero.
#[inline(always)]
fn multiply<L: Lanes, const ROWS: usize>(inputs: &[f32], weights: &[[f32; LANES]], products: &mut [f32], fresh: bool) {
    let inputs = inputs.as_chunks::<BLOCK>().0.chunks_exact(ROWS);
    let products = products.as_chunks_mut::<LANES>().0.chunks_exact_mut(ROWS);
    for (inputs, products) in inputs.zip(products) {
        let mut sums = [L::splat(0.0); ROWS];
        if !fresh {
            for (sum, product) in sums.iter_mut().zip(products.iter()) {
                *sum = L::load(product);
            }
        }
        let sums = accumulate_tile::<L, ROWS>(sums, inputs.as_flattened(), BLOCK, weights);
        for (product, sum) in products.iter_mut().zip(sums) {
            sum.store(product);
        }
    }
}

/// The 2x2x2 outputs of a tile, after ReLU, from its products at the 64 points, `pitch` apart.
#[inline(always)]
fn transform_output<L: Lanes>(products: &[f32], pitch: usize) -> [L; 8] {
    let zero = L::splat(0.0);
    let mut rows = [[zero; 2]; 16];
    for (zy, row) in rows.iter_mut().enumerate() {
        let mut products_of_row = [zero; 4];
        for (x, value) in products_of_row.iter_mut().enumerate() {
            *value = load(&products[(zy * 4 + x) * pitch..], LANES);
        }
        *row = outputs_of_axis(products_of_row);
    }
    let mut planes = [[zero; 4]; 4];
    for (z, plane) in planes.iter_mut().enumerate() {
        for x in 0..2 {
            let column = [rows[z * 4][x], rows[z * 4 + 1][x], rows[z * 4 + 2][x], rows[z * 4 + 3][x]];
            [plane[x], plane[2 + x]] = outputs_of_axis(column);
        }
    }
    let mut result = [zero; 8];
    for yx in 0..4 {
        let [near, far] = outputs_of_axis([planes[0][yx], planes[1][yx], planes[2][yx], planes[3][yx]]);
        (result[yx], result[4 + yx]) = (near.at_least(zero), far.at_least(zero));
    }
    result
}

#[cfg(test)]
mod tests {
    use super::super::{Blank, naive};
    use super::*;

    #[test]
    fn every_level_equals_the_textbook() {
        let mut random = naive::Random::new(2);
        let dense = |channels| vec![(channels, false)];
        for (size, sources, outputs) in [
            ([1, 1, 1], dense(1), 1),
            ([2, 3, 5], dense(3), 7),
            ([3, 2, 8], dense(16), 16),
            ([4, 5, 9], dense(17), 33),
            ([6, 6, 17], dense(48), 16),
            ([2, 4, 6], vec![(5, false), (7, true)], 20),
            ([8, 4, 8], vec![(16, false), (33, true)], 32),
        ] {
            let inputs: usize = sources.iter().map(|s| s.0).sum();
            let weight = random.values(outputs * inputs * 27);
            let norm = [random.values(inputs), random.values(inputs)];
            let volumes: Vec<Vec<f32>> = sources
                .iter()
                .map(|&(channels, up)| {
                    random.values(size.iter().product::<usize>() * channels / if up { 8 } else { 1 })
                })
                .collect();
            let expected =
                naive::conv3d_relu(size, inputs, outputs, &weight, &naive::normalized(size, &sources, &volumes, &norm));
            let values = volumes.iter().zip(&sources);
            let volumes_: Vec<Source> =
                values.map(|(values, &(channels, upsampled))| Source { values, channels, upsampled }).collect();
            for level in SimdLevel::available() {
                let mut output = vec![f32::NAN; expected.len()];
                let layer = PackedConv3d::new(&sources, outputs, &weight);
                let [scale, shift] = &norm;
                let conv = Conv3d { layer: &layer, size, sources: &volumes_, scale, shift, originals: &[] };
                let sums = conv3d(level, &conv, &mut output);
                let case = format!("{level:?} {size:?} {sources:?} {outputs}");
                // Sums of up to 1296 products of values below 2.
                naive::assert_close(&output, &expected, 4e-4, &case);
                for (channel, sums) in sums.iter().enumerate() {
                    let found = output.iter().skip(channel).step_by(outputs).map(|&v| f64::from(v));
                    let expected = [found.clone().sum::<f64>(), found.map(|v| v * v).sum::<f64>()];
                    for (sum, expected) in sums.iter().zip(expected) {
                        assert!((sum - expected).abs() <= 1e-5 * expected.abs().max(1.0), "{case}: {sum} {expected}");
                    }
                }
            }
        }
    }

    #[test]
    fn copied_tiles_are_those_that_would_be_computed() {
        let mut random = naive::Random::new(3);
        for (size, occupied) in [([12, 10, 14], vec![700]), ([9, 11, 13], vec![0, 600]), ([4, 4, 30], vec![])] {
            let (channels, outputs) = (3, 20);
            let mut volume = vec![0.0; size.iter().product::<usize>() * channels];
            for voxel in &occupied {
                volume[voxel * channels..][..channels].copy_from_slice(&random.values(channels));
            }
            let mut blank = Blank::around(size, occupied.into_iter());
            let mut inputs = channels;
            for _ in 0..2 {
                blank = blank.convolved();
                let originals = blank.originals();
                assert!(originals.iter().enumerate().any(|(i, o)| o.is_some_and(|o| (o as usize) < i)), "{size:?}");
                let layer = PackedConv3d::new(&[(inputs, false)], outputs, &random.values(outputs * inputs * 27));
                let norm = [random.values(inputs), random.values(inputs)];
                let mut next = Vec::new();
                let source = [Source { values: &volume, channels: inputs, upsampled: false }];
                for level in SimdLevel::available() {
                    let run = |originals: &[_]| {
                        let mut output = vec![f32::NAN; size.iter().product::<usize>() * outputs];
                        let sums = conv3d(
                            level,
                            &Conv3d {
                                layer: &layer,
                                size,
                                sources: &source,
                                scale: &norm[0],
                                shift: &norm[1],
                                originals,
                            },
                            &mut output,
                        );
                        (output, sums)
                    };
                    let ((computed, sums), (copied, copied_sums)) = (run(&[]), run(&originals));
                    assert_eq!(computed, copied, "{level:?} {size:?}");
                    for (found, expected) in copied_sums.as_flattened().iter().zip(sums.as_flattened()) {
                        assert!((found - expected).abs() <= 1e-6 * expected.max(1.0), "{found} {expected}");
                    }
                    next = computed;
                }
                volume = next;
                inputs = outputs;
            }
        }
    }
}

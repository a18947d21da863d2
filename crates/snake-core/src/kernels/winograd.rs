//! 3x3x3 convolution of a normalised, zero-padded volume by Winograd's minimal filtering, then ReLU.
//!
//! Along one axis M outputs of a 3-tap filter g on N = M + 2 inputs d need N products instead of 3 M: the filter and the
//! inputs are polynomials, multiplied by their values at N points, of which one is infinity (Toom and Cook). For M = 2
//! the points are 0, 1, -1:
//!
//! ```text
//! V = (d0 - d2, d1 + d2, d2 - d1, d1 - d3)        U = (g0, (g0 + g1 + g2) / 2, (g0 - g1 + g2) / 2, g2)
//! y = (V0 U0 + V1 U1 + V2 U2, V1 U1 - V2 U2 - V3 U3)
//! ```
//!
//! and for M = 4 they are 0, ±11/16, ±23/16, which keep the rounding error near that of a plain sum (with the usual 0,
//! ±1, ±2 it is four times as large). Over three axes a tile of 4x4x4 outputs needs 216 products instead of 1728 for each
//! pair of channels, 8 times fewer; a tile of 2x2x2 needs 64 instead of 216. The products of many tiles at one of the N³
//! points are a matrix product. Larger tiles need more transformed weights, so small volumes take the small ones.
//!
//! An input that is a coarser volume upsampled by two is read in place. With M = 2 it has d1 = d2, so V2 = 0 along every
//! axis and 27 of the 64 points remain.

use std::cell::RefCell;

use rayon::prelude::*;

use super::SimdLevel;
use super::blank::copy_blank;
use super::group_norm::add_in_order;
use super::simd::{LANES, Lanes, accumulate_tile, load, pack, simd_levels, store};

/// Input channels of one matrix product.
const BLOCK: usize = 2 * LANES;
/// The largest M.
const MOST: usize = 4;

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
    /// Outputs of a tile along an axis: M.
    pub(crate) tile: usize,
    blocks: Vec<Block>,
}

/// The points of a source: all N³, or with N = 4 for an upsampled one those without a 2 along any axis.
fn points(n: usize, upsampled: bool) -> impl Iterator<Item = usize> {
    let skip = upsampled && n == 4;
    (0..n * n * n).filter(move |p| !skip || [p / 16, p / 4 % 4, p % 4].iter().all(|&k| k != 2))
}

/// U of a filter along an axis, in the first N places.
fn weights_of_axis(n: usize, [a, b, c]: [f64; 3]) -> [f64; 6] {
    if n == 4 {
        return [a, 0.5 * (a + b + c), 0.5 * (a - b + c), c, 0.0, 0.0];
    }
    // The filter's polynomial at a point, divided by the point's distances from the others except infinity.
    let at = |node: f64, distances: f64| (a + node * (b + node * c)) / distances;
    let [near, far] = [NEAR * NEAR, FAR * FAR];
    let [of_near, of_far] = [2.0 * near * (near - far), 2.0 * far * (far - near)];
    [a / (near * far), at(NEAR, of_near), at(-NEAR, of_near), at(FAR, of_far), at(-FAR, of_far), c]
}

/// The points beside 0 and infinity for M = 4 are plus and minus these.
const NEAR: f64 = 11.0 / 16.0;
const FAR: f64 = 23.0 / 16.0;

impl PackedConv3d {
    /// From weights `(outputs, inputs, 3, 3, 3)` in the order z, y, x; `sources` are the channels of each source and
    /// whether it is upsampled; `tile` is M, 2 or 4.
    pub(crate) fn new(sources: &[(usize, bool)], outputs: usize, weight: &[f32], tile: usize) -> Self {
        let inputs: usize = sources.iter().map(|s| s.0).sum();
        let n = tile + 2;
        // The transformed filter of one pair of channels: x, y, z in turn.
        let transformed = |output: usize, input: usize| -> Vec<f32> {
            let g = &weight[(output * inputs + input) * 27..][..27];
            let rows: [[f64; 6]; 9] =
                std::array::from_fn(|zy| weights_of_axis(n, std::array::from_fn(|x| f64::from(g[zy * 3 + x]))));
            let mut values = vec![0.0; n * n * n];
            for x in 0..n {
                let planes: [[f64; 6]; 3] =
                    std::array::from_fn(|z| weights_of_axis(n, std::array::from_fn(|y| rows[z * 3 + y][x])));
                for y in 0..n {
                    let column = weights_of_axis(n, planes.map(|plane| plane[y]));
                    for z in 0..n {
                        values[(z * n + y) * n + x] = column[z] as f32;
                    }
                }
            }
            values
        };
        let mut blocks = Vec::new();
        let mut before = 0;
        for (source, &(channels, upsampled)) in sources.iter().enumerate() {
            for first in (0..channels).step_by(BLOCK) {
                let width = BLOCK.min(channels - first);
                let filters: Vec<Vec<f32>> = (0..outputs * width)
                    .into_par_iter()
                    .map(|i| transformed(i / width, before + first + i % width))
                    .collect();
                let points: Vec<usize> = points(n, upsampled).collect();
                let weights = points
                    .into_par_iter()
                    .flat_map_iter(|p| pack(outputs, width, |output, k| filters[output * width + k][p]))
                    .collect();
                blocks.push(Block { source, first: [first, before + first], channels: width, weights, upsampled });
            }
            before += channels;
        }
        Self { outputs, tile, blocks }
    }
}

/// One task's share of the output: rows of tiles from `row` on of tile plane `plane`.
struct Task<'a> {
    plane: usize,
    row: usize,
    /// The share of each of the M planes of voxels.
    planes: Vec<&'a mut [f32]>,
}

/// Transformed inputs and products of a task.
#[derive(Default)]
struct Scratch {
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
    let tile_rows = height.div_ceil(layer.tile);
    let batch = if layer.tile == 2 { BATCH_2 } else { BATCH_4 };
    // If many tiles are copies, a task looks for its own among more rows.
    let spread = if originals.is_empty() { 1 } else { 4 };
    let rows = (spread * batch / width.div_ceil(layer.tile)).clamp(1, tile_rows);
    let share = layer.tile * rows * width * layer.outputs;
    let mut tasks = Vec::new();
    for (z, planes) in output.chunks_mut(layer.tile * plane).enumerate() {
        let mut planes: Vec<_> = planes.chunks_mut(plane).map(|plane| plane.chunks_mut(share)).collect();
        for row in (0..tile_rows).step_by(rows) {
            tasks.push(Task { plane: z, row, planes: planes.iter_mut().filter_map(Iterator::next).collect() });
        }
    }
    let partial: Vec<Vec<[f64; 2]>> = tasks
        .into_par_iter()
        .map(|task| {
            let mut sums = vec![[0.0; 2]; layer.outputs];
            SCRATCH.with_borrow_mut(|scratch| conv3d_task(level, conv, scratch, task, &mut sums));
            sums
        })
        .collect();
    let mut sums = add_in_order(&partial, layer.outputs);
    if !originals.is_empty() {
        copy_blank(originals, layer.tile, size, layer.outputs, output, &mut sums);
    }
    sums
}

/// Tiles whose products are made together, with M = 2 and 4: their transforms stay in the second-level cache.
const BATCH_2: usize = 32;
const BATCH_4: usize = 16;

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
    match conv.layer.tile {
        2 => conv3d_tiles::<L, ROWS, 4>(conv, scratch, task, sums, BATCH_2),
        _ => conv3d_tiles::<L, ROWS, 6>(conv, scratch, task, sums, BATCH_4),
    }
}

#[inline(always)]
fn conv3d_tiles<L: Lanes, const ROWS: usize, const N: usize>(
    conv: &Conv3d,
    scratch: &mut Scratch,
    mut task: Task,
    sums: &mut [[f64; 2]],
    batch: usize,
) {
    let &Conv3d { layer, size, originals, .. } = conv;
    let [tile_rows, tiles_along] = [size[1].div_ceil(N - 2), size[2].div_ceil(N - 2)];
    let rows = (task.planes[0].len() / (size[2] * layer.outputs)).div_ceil(N - 2);
    let mut tiles = Vec::with_capacity(rows * tiles_along);
    for row in task.row..task.row + rows {
        for x in 0..tiles_along {
            let tile = (task.plane * tile_rows + row) * tiles_along + x;
            if originals.get(tile).copied().flatten().is_none_or(|original| original as usize == tile) {
                tiles.push([row, x]);
            }
        }
    }
    let output_blocks = layer.outputs.div_ceil(LANES);
    for tiles in tiles.chunks(batch) {
        let padded_tiles = tiles.len().next_multiple_of(ROWS);
        // One cache line more than a power of two, so that the points do not fall into the same cache sets.
        let input_pitch = padded_tiles * BLOCK + LANES;
        let product_pitch = padded_tiles * LANES + LANES;
        let inputs = at_least(&mut scratch.inputs, N * N * N * input_pitch);
        let products = at_least(&mut scratch.products, N * N * N * output_blocks * product_pitch);
        for (number, block) in layer.blocks.iter().enumerate() {
            for half in 0..block.channels.div_ceil(LANES) {
                transform_inputs::<L, N>(
                    conv,
                    block,
                    half,
                    task.plane,
                    tiles,
                    &mut inputs[half * LANES..],
                    input_pitch,
                );
            }
            for (k, p) in points(N, block.upsampled).enumerate() {
                let inputs = &inputs[p * input_pitch..][..padded_tiles * BLOCK];
                let weights = &block.weights[k * output_blocks * block.channels..][..output_blocks * block.channels];
                let products = &mut products[p * output_blocks * product_pitch..][..output_blocks * product_pitch];
                let weights = weights.chunks_exact(block.channels);
                for (weights, products) in weights.zip(products.chunks_exact_mut(product_pitch)) {
                    multiply::<L, ROWS>(inputs, weights, &mut products[..padded_tiles * LANES], number == 0);
                }
            }
        }
        for (tile, &[row, x]) in tiles.iter().enumerate() {
            for out in 0..output_blocks {
                let products = &products[out * product_pitch + tile * LANES..];
                let place = [row - task.row, x];
                transform_outputs::<L, N>(conv, products, output_blocks * product_pitch, place, out, &mut task, sums);
            }
        }
    }
}

/// V of LANES channels of some tiles `[row, x]` of a plane of tiles: of each point `pitch` values, BLOCK of each tile.
///
/// Along z and y each column of inputs is transformed once, for all the tiles along x that it belongs to.
#[inline(always)]
fn transform_inputs<L: Lanes, const N: usize>(
    conv: &Conv3d,
    block: &Block,
    half: usize,
    plane: usize,
    tiles: &[[usize; 2]],
    to: &mut [f32],
    pitch: usize,
) {
    let &Conv3d { size, sources, scale, shift, .. } = conv;
    let source = &sources[block.source];
    let lanes = LANES.min(block.channels - half * LANES);
    let [first, global] = block.first.map(|first| first + half * LANES);
    let norm = [load::<L>(&scale[global..], lanes), load::<L>(&shift[global..], lanes)];
    let values = &source.values[first..];
    // Two neighbours of an upsampled volume are one voxel.
    let shift = usize::from(source.upsampled);
    let [height, width] = [size[1] >> shift, size[2] >> shift];
    let zero = L::splat(0.0);
    let mut columns = [[[zero; N]; N]; N];
    let mut previous = None;
    for (tile, &[row, x]) in tiles.iter().enumerate() {
        // Where the lines along x begin; nothing beyond the border.
        let mut lines = [[None; N]; N];
        for (j, lines) in lines.iter_mut().enumerate() {
            for (k, line) in lines.iter_mut().enumerate() {
                let [z, y] = [(N - 2) * plane + k, (N - 2) * row + j];
                if (1..=size[0]).contains(&z) && (1..=size[1]).contains(&y) {
                    *line = Some((((z - 1) >> shift) * height + ((y - 1) >> shift)) * width * source.channels);
                }
            }
        }
        // Neighbours along x share two columns.
        let known = if x > 0 && previous == Some([row, x - 1]) { 2 } else { 0 };
        for i in 0..known {
            columns[i] = columns[N - 2 + i];
        }
        previous = Some([row, x]);
        for i in known..N {
            let column = (N - 2) * x + i;
            if source.upsampled && i > 0 && i % 2 == 0 {
                columns[i] = columns[i - 1];
                continue;
            }
            if !(1..=size[2]).contains(&column) {
                columns[i] = [[zero; N]; N];
                continue;
            }
            let from = ((column - 1) >> shift) * source.channels;
            let mut rows = [[zero; N]; N];
            for (along_z, lines) in rows.iter_mut().zip(&lines) {
                for (value, line) in along_z.iter_mut().zip(lines) {
                    if let Some(line) = line {
                        let values = &values[line + from..];
                        // The first half of the block's channels fetches ahead for both.
                        if half == 0 {
                            let ahead = values.as_ptr().wrapping_add((N >> shift) * source.channels);
                            L::prefetch(ahead);
                            L::prefetch(ahead.wrapping_add(LANES));
                        }
                        *value = load::<L>(values, lanes).multiply_add(norm[0], norm[1]);
                    }
                }
                *along_z = inputs_of_axis(*along_z);
            }
            for z in 0..N {
                let mut along_y = [zero; N];
                for (value, row) in along_y.iter_mut().zip(&rows) {
                    *value = row[z];
                }
                columns[i][z] = inputs_of_axis(along_y);
            }
        }
        for z in 0..N {
            for y in 0..N {
                let mut along_x = [zero; N];
                for (i, value) in along_x.iter_mut().enumerate() {
                    *value = columns[i][z][y];
                }
                for (i, value) in inputs_of_axis(along_x).into_iter().enumerate() {
                    store(value, &mut to[((z * N + y) * N + i) * pitch + tile * BLOCK..], LANES);
                }
            }
        }
    }
}

/// Writes the outputs of a tile at `[row, x]` of the task for one block of channels, after ReLU, and adds them to the
/// sums; the products of each point are `pitch` apart.
#[inline(always)]
fn transform_outputs<L: Lanes, const N: usize>(
    conv: &Conv3d,
    products: &[f32],
    pitch: usize,
    [row, x]: [usize; 2],
    out: usize,
    task: &mut Task,
    sums: &mut [[f64; 2]],
) {
    let &Conv3d { layer, size, .. } = conv;
    let zero = L::splat(0.0);
    let mut planes = [[[zero; MOST]; MOST]; N];
    for (z, plane) in planes.iter_mut().enumerate() {
        let mut rows = [[zero; MOST]; N];
        for (y, along_x) in rows.iter_mut().enumerate() {
            let mut products_of_row = [zero; N];
            for (x, value) in products_of_row.iter_mut().enumerate() {
                *value = load(&products[((z * N + y) * N + x) * pitch..], LANES);
            }
            *along_x = outputs_of_axis(products_of_row);
        }
        for x in 0..N - 2 {
            let mut column = [zero; N];
            for (value, row) in column.iter_mut().zip(&rows) {
                *value = row[x];
            }
            for (row, value) in plane.iter_mut().zip(outputs_of_axis(column)) {
                row[x] = value;
            }
        }
    }
    let lanes = LANES.min(layer.outputs - out * LANES);
    let (mut sum, mut squares) = (zero, zero);
    let (first_y, first_x) = ((N - 2) * row, (N - 2) * x);
    for y in 0..N - 2 {
        for x in 0..(N - 2).min(size[2] - first_x) {
            let mut column = [zero; N];
            for (value, plane) in column.iter_mut().zip(&planes) {
                *value = plane[y][x];
            }
            let place = (((first_y + y) * size[2]) + first_x + x) * layer.outputs + out * LANES;
            for (plane, value) in task.planes.iter_mut().zip(outputs_of_axis(column)) {
                if let Some(voxel) = plane.get_mut(place..place + lanes) {
                    let value = value.at_least(zero);
                    store(value, voxel, lanes);
                    sum = sum.plus(value);
                    squares = value.multiply_add(value, squares);
                }
            }
        }
    }
    let totals = sum.to_array().into_iter().zip(squares.to_array());
    for (total, (sum, squares)) in sums[out * LANES..][..lanes].iter_mut().zip(totals) {
        total[0] += f64::from(sum);
        total[1] += f64::from(squares);
    }
}

// The bodies of kernels are loops and functions marked for inlining: a closure would be compiled without the level's
// instructions.

/// V of N inputs along an axis.
#[inline(always)]
fn inputs_of_axis<L: Lanes, const N: usize>(d: [L; N]) -> [L; N] {
    let mut v = d;
    if N == 4 {
        v[0] = d[0].minus(d[2]);
        v[1] = d[1].plus(d[2]);
        v[2] = d[2].minus(d[1]);
        v[3] = d[1].minus(d[3]);
        return v;
    }
    let [near, far] = [L::splat(NEAR as f32), L::splat(FAR as f32)];
    let minus = [L::splat(-(NEAR * NEAR) as f32), L::splat(-(FAR * FAR) as f32)];
    let [sum, product] = [L::splat(-(NEAR * NEAR + FAR * FAR) as f32), L::splat((NEAR * NEAR * FAR * FAR) as f32)];
    v[0] = d[0].multiply_add(product, d[2].multiply_add(sum, d[4]));
    v[5] = d[1].multiply_add(product, d[3].multiply_add(sum, d[5]));
    let [even, odd] = [d[2].multiply_add(minus[1], d[4]), d[1].multiply_add(minus[1], d[3])];
    v[1] = odd.multiply_add(near, even);
    v[2] = odd.multiply_add(L::splat(-NEAR as f32), even);
    let [even, odd] = [d[2].multiply_add(minus[0], d[4]), d[1].multiply_add(minus[0], d[3])];
    v[3] = odd.multiply_add(far, even);
    v[4] = odd.multiply_add(L::splat(-FAR as f32), even);
    v
}

/// The M outputs of N products along an axis.
#[inline(always)]
fn outputs_of_axis<L: Lanes, const N: usize>(m: [L; N]) -> [L; MOST] {
    let zero = L::splat(0.0);
    if N == 4 {
        return [m[0].plus(m[1]).plus(m[2]), m[1].minus(m[2]).minus(m[3]), zero, zero];
    }
    let (near_sum, near_difference) = (m[1].plus(m[2]), m[1].minus(m[2]));
    let (far_sum, far_difference) = (m[3].plus(m[4]), m[3].minus(m[4]));
    let mut y = [m[0].plus(near_sum).plus(far_sum), zero, zero, m[5]];
    let [mut near, mut far] = [1.0; 2];
    for (value, [of_near, of_far]) in y[1..].iter_mut().zip([
        [near_difference, far_difference],
        [near_sum, far_sum],
        [near_difference, far_difference],
    ]) {
        (near, far) = (near * NEAR as f32, far * FAR as f32);
        *value = of_near.multiply_add(L::splat(near), of_far.multiply_add(L::splat(far), *value));
    }
    y
}

/// `products (tiles, LANES) += inputs (tiles, BLOCK) weights (channels, LANES)`; `fresh` starts from zero.
#[inline(always)]
fn multiply<L: Lanes, const ROWS: usize>(inputs: &[f32], weights: &[[f32; LANES]], products: &mut [f32], fresh: bool) {
    let inputs = inputs.as_chunks::<BLOCK>().0.as_chunks::<ROWS>().0;
    let products = products.as_chunks_mut::<LANES>().0.as_chunks_mut::<ROWS>().0;
    for (inputs, products) in inputs.iter().zip(products) {
        let mut sums = [L::splat(0.0); ROWS];
        if !fresh {
            for r in 0..ROWS {
                sums[r] = L::load(&products[r]);
            }
        }
        let sums = accumulate_tile::<L, ROWS>(sums, inputs.as_flattened(), BLOCK, weights);
        for r in 0..ROWS {
            sums[r].store(&mut products[r]);
        }
    }
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
            for (level, tile) in SimdLevel::available().into_iter().flat_map(|level| [(level, 2), (level, 4)]) {
                let mut output = vec![f32::NAN; expected.len()];
                let layer = PackedConv3d::new(&sources, outputs, &weight, tile);
                let [scale, shift] = &norm;
                let conv = Conv3d { layer: &layer, size, sources: &volumes_, scale, shift, originals: &[] };
                let sums = conv3d(level, &conv, &mut output);
                let case = format!("{level:?} {tile} {size:?} {sources:?} {outputs}");
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
        for (size, occupied) in [([16, 20, 24], vec![3700]), ([9, 21, 23], vec![0, 600]), ([4, 4, 40], vec![])] {
            let (channels, outputs) = (3, 20);
            let mut volume = vec![0.0; size.iter().product::<usize>() * channels];
            for voxel in &occupied {
                volume[voxel * channels..][..channels].copy_from_slice(&random.values(channels));
            }
            let mut blank = Blank::around(size, occupied.into_iter());
            let mut inputs = channels;
            for _ in 0..2 {
                blank = blank.convolved();
                let weight = random.values(outputs * inputs * 27);
                let [scale, shift] = [random.values(inputs), random.values(inputs)];
                let mut next = Vec::new();
                let sources = [Source { values: &volume, channels: inputs, upsampled: false }];
                for (level, tile) in SimdLevel::available().into_iter().flat_map(|level| [(level, 4), (level, 2)]) {
                    let originals = blank.originals(tile);
                    assert!(originals.iter().enumerate().any(|(i, o)| o.is_some_and(|o| (o as usize) < i)), "{size:?}");
                    let layer = PackedConv3d::new(&[(inputs, false)], outputs, &weight, tile);
                    let run = |originals: &[_]| {
                        let mut output = vec![f32::NAN; size.iter().product::<usize>() * outputs];
                        let (scale, shift) = (&scale, &shift);
                        let conv = Conv3d { layer: &layer, size, sources: &sources, scale, shift, originals };
                        let sums = conv3d(level, &conv, &mut output);
                        (output, sums)
                    };
                    let ((computed, sums), (copied, copied_sums)) = (run(&[]), run(&originals));
                    assert_eq!(computed, copied, "{level:?} {tile} {size:?}");
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

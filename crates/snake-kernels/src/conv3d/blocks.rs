//! The convolution of a sparse volume of blocks of 4x4x4 voxels. A block is one Winograd tile with M = 4, or eight tiles with
//! M = 2 if the input is upsampled.
//!
//! A volume stores the differences between its voxels and a constant vector, the value of every voxel far from the
//! points. So a voxel without a block is zero, and the padding beyond the last block is exact. A layer computes
//! `relu(W x + bias) - constant`, where `bias` includes what the constant of its input adds, and `constant = relu(bias)`.
//! The sums `W x` of several inputs are added one after another, so an input needs no memory while the next is computed.

use rayon::prelude::*;

use super::pack::Block;
use super::transform::{MAX_TILE, Partial, inputs_of_axis, outputs_of_axis, store_points, tile_of};
use super::{BATCH_4, BUFFERS, Buffers, Gather, PackedConv3d, multiply_tiles};
use crate::SimdLevel;
use crate::simd::{LANES, Lanes, load, load_at, simd_levels, store};

/// Voxels of a block along each axis.
pub const BLOCK_SIDE: usize = MAX_TILE;

/// Voxels in a block.
pub const BLOCK_VOXELS: usize = BLOCK_SIDE * BLOCK_SIDE * BLOCK_SIDE;

/// Inputs and points along each axis of a block's tile, with M = 4.
const SAME: usize = BLOCK_SIDE + 2;

/// Points along each axis of a tile of an upsampled block, with M = 2.
const UPSAMPLED: usize = 3;

/// Different inputs along each axis of the two tiles of an upsampled block.
const SHARED_INPUTS: usize = 4;

/// Different points along each axis of these two tiles, which share the middle one.
const SHARED_POINTS: usize = 2 * UPSAMPLED - 1;

/// Blocks of an upsampled source in one batch of multiplications: their products stay in the second-level cache.
const BATCH_UPSAMPLED: usize = 4;

/// The input volume of a convolution of blocks.
#[derive(Debug, Clone, Copy)]
pub struct BlockSource<'a> {
    /// Values `[block][z][y][x][channel]`. Block 0 is zero and stands for every missing block. Numbers beyond the last block
    /// mean block 0, too.
    pub values: &'a [f32],
    /// Channels of this volume.
    pub channels: usize,
    /// For each output block, the 27 blocks of this volume around it, x fastest. If this volume is upsampled, those around
    /// the block that covers the output block.
    pub neighbors: &'a [[u32; 27]],
    /// For each output block, in which half of the covering block it lies, if this volume is upsampled by two; bit 0 is x,
    /// bit 1 is y, bit 2 is z.
    pub halves: Option<&'a [u8]>,
}

impl BlockSource<'_> {
    /// The addresses of the values around an output block: COUNT voxels along each axis, beginning one voxel before the block. If
    /// the volume is upsampled, these are its coarse voxels, each once.
    #[inline(always)]
    fn about<const COUNT: usize>(&self, output: usize) -> About<COUNT> {
        let size = BLOCK_VOXELS * self.channels;
        let number = self.values.len() / size;
        let mut about = About { starts: [[0; 3]; 9], first: [BLOCK_SIDE - 1; 3], channels: self.channels };
        for (place, &neighbor) in self.neighbors[output].iter().enumerate() {
            let neighbor = neighbor as usize;
            about.starts[place % 9][place / 9] = if neighbor < number { neighbor * size } else { 0 };
        }
        if let Some(halves) = self.halves {
            for (axis, first) in about.first.iter_mut().enumerate() {
                *first += BLOCK_SIDE / 2 * usize::from(halves[output] >> axis & 1);
            }
        }
        about
    }
}

/// The addresses of the values around an output block.
struct About<const COUNT: usize> {
    /// The first value of each block around it, `[yx][z]`; missing blocks have that of block 0.
    starts: [[usize; 3]; 9],
    /// The first voxel along x, y and z, counted from the first voxel of the lower neighbour. It varies only for upsampled blocks.
    first: [usize; 3],
    channels: usize,
}

impl<const COUNT: usize> About<COUNT> {
    /// The first value of each voxel along z, at this position along x and y.
    #[inline(always)]
    fn along_z(&self, x: usize, y: usize) -> [usize; COUNT] {
        let first = if COUNT == SAME { [BLOCK_SIDE - 1; 3] } else { self.first };
        let [x, y] = [first[0] + x, first[1] + y];
        let starts = self.starts[y / BLOCK_SIDE * 3 + x / BLOCK_SIDE];
        let place = (y % BLOCK_SIDE * BLOCK_SIDE + x % BLOCK_SIDE) * self.channels;
        let mut values = [0; COUNT];
        for (z, value) in values.iter_mut().enumerate() {
            let z = first[2] + z;
            *value = starts[z / BLOCK_SIDE] + place + z % BLOCK_SIDE * BLOCK_SIDE * BLOCK_SIDE * self.channels;
        }
        values
    }
}

/// The arguments of [`conv3d_blocks`].
#[derive(Debug, Clone, Copy)]
pub struct BlockConv3d<'a> {
    /// Weights for this input, from [`PackedConv3d::for_blocks`].
    pub layer: &'a PackedConv3d,
    /// The input volume.
    pub source: BlockSource<'a>,
    /// Whether the output holds the sums of other inputs, to which this input's sums are added.
    pub adds: bool,
    /// The activation after the last input's sums.
    pub activation: Option<BlockActivation<'a>>,
}

/// The activation of a layer, for each output channel.
#[derive(Debug, Clone, Copy)]
pub struct BlockActivation<'a> {
    /// Added before the ReLU.
    pub bias: &'a [f32],
    /// Subtracted after the ReLU.
    pub constant: &'a [f32],
}

/// Convolves blocks with their neighbours. If an activation is given, adds the bias, applies the ReLU and subtracts the constant.
/// `output` holds the output blocks `[block][z][y][x][channel]`, without block 0.
///
/// `stop` is called before each batch of blocks. Once it returns true, the remaining batches are skipped and the output
/// must not be used.
///
/// # Panics
/// If the layer is not from [`PackedConv3d::for_blocks`] for this source, or a slice is shorter than the sizes say.
pub fn conv3d_blocks(level: SimdLevel, conv: &BlockConv3d, stop: &(dyn Fn() -> bool + Sync), output: &mut [f32]) {
    let BlockConv3d { layer, source, .. } = conv;
    assert_eq!(layer.tile == 2, source.halves.is_some(), "upsampled blocks have tiles of 2");
    let channels: usize = layer.blocks.iter().map(|block| block.channels).sum();
    assert!(channels == source.channels && source.values.len() >= BLOCK_VOXELS * channels, "block 0, and all channels");
    let batch = BATCH_4 * BLOCK_VOXELS * conv.layer.outputs;
    output.par_chunks_mut(batch).enumerate().for_each(|(number, output)| {
        if !stop() {
            BUFFERS.with_borrow_mut(|buffers| batch_of_blocks(level, conv, buffers, number * BATCH_4, output));
        }
    });
}

simd_levels! {
    fn batch_of_blocks(conv: &BlockConv3d, buffers: &mut Buffers, first: usize, output: &mut [f32]) = batch_of_blocks_body
}

#[inline(always)]
fn batch_of_blocks_body<L: Lanes, const ROWS: usize>(
    token: L::Token,
    conv: &BlockConv3d,
    buffers: &mut Buffers,
    first: usize,
    output: &mut [f32],
) {
    if conv.layer.tile == 2 {
        // Eight tiles per block.
        for (number, output) in output.chunks_mut(BATCH_UPSAMPLED * BLOCK_VOXELS * conv.layer.outputs).enumerate() {
            tiles_of_blocks::<L, ROWS, UPSAMPLED>(token, conv, buffers, first + number * BATCH_UPSAMPLED, output);
        }
    } else {
        tiles_of_blocks::<L, ROWS, SAME>(token, conv, buffers, first, output);
    }
}

#[inline(always)]
fn tiles_of_blocks<L: Lanes, const ROWS: usize, const POINTS: usize>(
    token: L::Token,
    conv: &BlockConv3d,
    buffers: &mut Buffers,
    first: usize,
    output: &mut [f32],
) {
    let &BlockConv3d { layer, adds, activation, .. } = conv;
    let number = output.len() / (BLOCK_VOXELS * layer.outputs);
    let gather = BlocksFrom { conv, first, number };
    let side = tile_of(POINTS);
    let tiles_along = BLOCK_SIDE / side;
    let num_tiles = number * tiles_along.pow(3);
    let (products, pitch) = multiply_tiles::<L, ROWS, POINTS>(token, layer, num_tiles, &gather, &mut buffers.values);
    let output_blocks = layer.outputs.div_ceil(LANES);
    let zero = L::splat(token, 0.0);
    let mut partial = Partial::<L, POINTS>::new(token);
    for tile in 0..num_tiles {
        let [block, within] = [tile / tiles_along.pow(3), tile % tiles_along.pow(3)];
        let [tile_z, tile_y, tile_x] =
            [within / (tiles_along * tiles_along), within / tiles_along % tiles_along, within % tiles_along];
        let first_voxel =
            ((block * BLOCK_SIDE + tile_z * side) * BLOCK_SIDE + tile_y * side) * BLOCK_SIDE + tile_x * side;
        for out in 0..output_blocks {
            partial.read(&products[out * pitch + tile * LANES..], output_blocks * pitch);
            let lanes = LANES.min(layer.outputs - out * LANES);
            let terms = match activation {
                Some(BlockActivation { bias, constant }) => {
                    let at = out * LANES;
                    Some([load::<L>(token, &bias[at..], lanes), load::<L>(token, &constant[at..], lanes)])
                }
                None => None,
            };
            for y in 0..side {
                for x in 0..side {
                    let mut column = [zero; POINTS];
                    for (value, plane) in column.iter_mut().zip(&partial.planes) {
                        *value = plane[y][x];
                    }
                    for (z, value) in outputs_of_axis(column).into_iter().enumerate().take(side) {
                        let voxel = first_voxel + (z * BLOCK_SIDE + y) * BLOCK_SIDE + x;
                        let output = &mut output[voxel * layer.outputs + out * LANES..];
                        // Prefetches the output of the next block.
                        L::prefetch(output.as_ptr().wrapping_add(BLOCK_VOXELS * layer.outputs));
                        let value = if adds { value.add(load(token, output, lanes)) } else { value };
                        let value = match terms {
                            Some([bias, constant]) => value.add(bias).max(zero).sub(constant),
                            None => value,
                        };
                        store(value, output, lanes);
                    }
                }
            }
        }
    }
}

/// `number` output blocks, from `first` on.
struct BlocksFrom<'a> {
    conv: &'a BlockConv3d<'a>,
    first: usize,
    number: usize,
}

impl Gather for BlocksFrom<'_> {
    #[inline(always)]
    fn fetch_ahead<L: Lanes>(&self, part: usize, parts: usize) {
        let source = &self.conv.source;
        if let Some(neighbors) = source.neighbors.get(self.first + self.number) {
            let blocks = if source.halves.is_some() { self.number.div_ceil(8) } else { self.number };
            let lines = blocks * BLOCK_VOXELS * source.channels / LANES;
            let first = neighbors[13] as usize * BLOCK_VOXELS * source.channels;
            for line in part * lines / parts..(part + 1) * lines / parts {
                L::prefetch(source.values.as_ptr().wrapping_add(first + line * LANES));
            }
        }
    }

    #[inline(always)]
    fn transform<L: Lanes, const M: usize>(&self, token: L::Token, block: &Block, to: &mut [f32], pitch: usize) {
        if M == SAME {
            self.transform_about::<L, SAME, SAME>(token, block, to, pitch);
        } else {
            self.transform_about::<L, SHARED_INPUTS, SHARED_POINTS>(token, block, to, pitch);
        }
    }
}

impl BlocksFrom<'_> {
    /// Transforms INPUTS inputs along each axis to POINTS values.
    #[inline(always)]
    fn transform_about<L: Lanes, const INPUTS: usize, const POINTS: usize>(
        &self,
        token: L::Token,
        block: &Block,
        to: &mut [f32],
        pitch: usize,
    ) {
        let source = &self.conv.source;
        let zero = L::splat(token, 0.0);
        let tiles = if INPUTS == SAME { 1 } else { 8 };
        // `[x][z][y]`, and the values along z at one x.
        let mut columns = [[[zero; POINTS]; POINTS]; INPUTS];
        let mut rows = [[zero; POINTS]; INPUTS];
        let mut next = source.about::<INPUTS>(self.first);
        for number in 0..self.number {
            let about = next;
            next = source.about((self.first + number + 1).min(source.neighbors.len() - 1));
            for half in 0..block.channels.div_ceil(LANES) {
                let lanes = LANES.min(block.channels - half * LANES);
                let values = &source.values[block.first[0] + half * LANES..];
                for (x, column) in columns.iter_mut().enumerate() {
                    for (y, row) in rows.iter_mut().enumerate() {
                        let mut along_z = [zero; INPUTS];
                        let [starts, ahead] = [about.along_z(x, y), next.along_z(x, y)];
                        for (z, value) in along_z.iter_mut().enumerate() {
                            L::prefetch(values.as_ptr().wrapping_add(ahead[z]));
                            let from = starts[z];
                            *value = if lanes == LANES {
                                // SAFETY: `about` gives blocks that have values, of as many channels as the layer reads.
                                // `conv3d_blocks` asserts both.
                                unsafe { load_at(token, values, from) }
                            } else {
                                load(token, &values[from..], lanes)
                            };
                        }
                        *row = inputs_of_axis(along_z);
                    }
                    for (z, along_y) in column.iter_mut().enumerate() {
                        let mut inputs = [zero; INPUTS];
                        for (value, row) in inputs.iter_mut().zip(&rows) {
                            *value = row[z];
                        }
                        *along_y = inputs_of_axis(inputs);
                    }
                }
                let first = number * tiles * block.width() + half * LANES;
                store_points(&columns, &mut to[first..], block.width(), pitch);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::naive;

    /// All blocks of a volume with `blocks` blocks along each side, zeros in block 0, and their neighbours.
    struct Whole {
        blocks: usize,
    }

    impl Whole {
        fn number(&self, [x, y, z]: [isize; 3]) -> u32 {
            let inside = [x, y, z].iter().all(|&i| (0..self.blocks as isize).contains(&i));
            if inside { 1 + ((z * self.blocks as isize + y) * self.blocks as isize + x) as u32 } else { 0 }
        }

        fn places(&self) -> impl Iterator<Item = [isize; 3]> {
            let blocks = self.blocks as isize;
            (0..blocks.pow(3)).map(move |i| [i % blocks, i / blocks % blocks, i / blocks / blocks])
        }

        fn neighbors(&self, shift: u32, places: impl Iterator<Item = [isize; 3]>) -> Vec<[u32; 27]> {
            let about = |place: [isize; 3]| {
                std::array::from_fn(|n| {
                    let step = [n % 3, n / 3 % 3, n / 9];
                    self.number(std::array::from_fn(|axis| (place[axis] >> shift) + step[axis] as isize - 1))
                })
            };
            places.map(about).collect()
        }

        /// Converts values `[z][y][x][channel]` to the order of blocks.
        fn blocked(&self, channels: usize, volume: &[f32]) -> Vec<f32> {
            let side = self.blocks * BLOCK_SIDE;
            let mut values = vec![0.0; (1 + self.blocks.pow(3)) * BLOCK_VOXELS * channels];
            for (i, voxel) in volume.chunks_exact(channels).enumerate() {
                let at = [i % side, i / side % side, i / side / side];
                let block = self.number(at.map(|v| (v / BLOCK_SIDE) as isize)) as usize;
                let [x, y, z] = at.map(|v| v % BLOCK_SIDE);
                let place = block * BLOCK_VOXELS + (z * BLOCK_SIDE + y) * BLOCK_SIDE + x;
                values[place * channels..][..channels].copy_from_slice(voxel);
            }
            values
        }
    }

    #[test]
    fn blocks_equal_the_textbook_at_every_level() {
        let mut random = naive::Random::new(5);
        let cases = [
            (1, vec![(1, false)], 1),
            (2, vec![(5, false), (7, true)], 33),
            (2, vec![(17, false)], 20),
            (2, vec![(32, false)], 16),
            (4, vec![(16, false), (32, true)], 16),
        ];
        for (blocks, sources, outputs) in naive::cases(cases, 1) {
            let side = blocks * BLOCK_SIDE;
            let inputs: usize = sources.iter().map(|source| source.0).sum();
            let weight = random.values(outputs * inputs * 27);
            let [bias, constant] = [random.values(outputs), random.values(outputs)];
            let of = |up: bool| Whole { blocks: if up { blocks / 2 } else { blocks } };
            let volumes: Vec<Vec<f32>> = sources
                .iter()
                .map(|&(channels, up)| random.values((if up { side / 2 } else { side }).pow(3) * channels))
                .collect();
            let joined = naive::normalized([side; 3], &sources, &volumes, &[vec![1.0; inputs], vec![0.0; inputs]]);
            let convolved = naive::conv3d([side; 3], inputs, outputs, &weight, &joined);
            let channel_terms = bias.iter().zip(&constant).cycle();
            let expected: Vec<f32> =
                convolved.iter().zip(channel_terms).map(|(v, (b, c))| (v + b).max(0.0) - c).collect();
            let expected = of(false).blocked(outputs, &expected)[BLOCK_VOXELS * outputs..].to_vec();
            let halves: Vec<u8> =
                of(false).places().map(|p| (0..3).map(|axis| ((p[axis] & 1) << axis) as u8).sum()).collect();
            let blocked: Vec<(Vec<f32>, Vec<[u32; 27]>)> = volumes
                .iter()
                .zip(&sources)
                .map(|(volume, &(channels, up))| {
                    (of(up).blocked(channels, volume), of(up).neighbors(u32::from(up), of(false).places()))
                })
                .collect();
            let parts = PackedConv3d::for_blocks(&sources, outputs, &weight);
            let last = parts.len() - 1;
            for level in SimdLevel::available() {
                let mut output = vec![f32::NAN; expected.len()];
                for (part, ((values, neighbors), &(channels, up))) in blocked.iter().zip(&sources).enumerate() {
                    let source = BlockSource { values, channels, neighbors, halves: up.then_some(&halves[..]) };
                    let activation = BlockActivation { bias: &bias, constant: &constant };
                    let activation = (part == last).then_some(activation);
                    let conv = BlockConv3d { layer: &parts[part], source, adds: part > 0, activation };
                    conv3d_blocks(level, &conv, &|| false, &mut output);
                }
                // Sums of up to 1296 products of values below 2.
                naive::assert_close(&output, &expected, 4e-4, &format!("{level:?} {blocks} {sources:?} {outputs}"));
            }
        }
    }
}

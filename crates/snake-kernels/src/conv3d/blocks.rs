//! The convolution of a sparse volume: blocks of 4x4x4 voxels, one Winograd tile each.
//!
//! A volume stores the differences of its voxels from a constant vector, which every voxel far from the points has. So a
//! voxel without a block is zero, and the padding beyond the last block is exact. A layer computes
//! `relu(W x + bias) - constant`, where `bias` holds what the constant of its input adds, and `constant = relu(bias)`.
//! Of several inputs the sums `W x` are added one after another, so that an input needs no memory while the next is made.

use rayon::prelude::*;

use super::pack::Block;
use super::transform::{MAX_TILE, Partial, inputs_of_axis, outputs_of_axis, store_inputs};
use super::{BATCH_4, BUFFERS, Buffers, Gather, PackedConv3d, multiply_tiles};
use crate::SimdLevel;
use crate::simd::{LANES, Lanes, load, simd_levels, store};

/// Voxels of a block along each axis.
pub const BLOCK_SIDE: usize = MAX_TILE;

/// Voxels of a block.
pub const BLOCK_VOXELS: usize = BLOCK_SIDE * BLOCK_SIDE * BLOCK_SIDE;

/// Values of a tile's input along each axis.
const N: usize = BLOCK_SIDE + 2;

/// The input volume of a convolution of blocks.
#[derive(Debug, Clone, Copy)]
pub struct BlockSource<'a> {
    /// Values `[block][z][y][x][channel]`. Block 0 stands for every missing block and is zero; so do numbers beyond the last
    /// block.
    pub values: &'a [f32],
    /// Channels of this volume.
    pub channels: usize,
    /// For each output block the blocks of this volume about it, x fastest. Of an upsampled volume: about the block that
    /// covers the output block.
    pub neighbors: &'a [[u32; 27]],
    /// Of a volume that is upsampled by two: the half of the covering block in which each output block lies; bit 0 is x,
    /// bit 1 is y, bit 2 is z.
    pub halves: Option<&'a [u8]>,
}

impl BlockSource<'_> {
    /// The blocks about an output block; 0 for those that have no values.
    #[inline(always)]
    fn stored(&self, output: usize) -> [u32; 27] {
        let number = (self.values.len() / (BLOCK_VOXELS * self.channels)) as u32;
        self.neighbors[output].map(|neighbor| if neighbor < number { neighbor } else { 0 })
    }

    /// Where the values of a voxel begin, at these places along x, y and z.
    #[inline(always)]
    fn first_value(&self, neighbors: &[u32; 27], [x, y, z]: [[usize; 2]; 3]) -> usize {
        let neighbor = neighbors[(z[0] * 3 + y[0]) * 3 + x[0]] as usize;
        let voxel = (z[1] * BLOCK_SIDE + y[1]) * BLOCK_SIDE + x[1];
        (neighbor * BLOCK_VOXELS + voxel) * self.channels
    }

    /// For the voxels about an output block along one axis, which of the three blocks holds each, and its place there.
    #[inline(always)]
    fn places(&self, output: usize, axis: usize) -> [[usize; 2]; N] {
        let mut places = [[0; 2]; N];
        for (i, place) in places.iter_mut().enumerate() {
            // Counted from the first voxel of the lower neighbour.
            let at = match self.halves {
                None => i + BLOCK_SIDE - 1,
                Some(halves) => {
                    i.div_ceil(2) + BLOCK_SIDE - 1 + BLOCK_SIDE / 2 * usize::from(halves[output] >> axis & 1)
                }
            };
            *place = [at / BLOCK_SIDE, at % BLOCK_SIDE];
        }
        places
    }
}

/// The arguments of [`conv3d_blocks`].
#[derive(Debug, Clone, Copy)]
pub struct BlockConv3d<'a> {
    /// Weights of this input, with tiles of 4.
    pub layer: &'a PackedConv3d,
    /// The input volume.
    pub source: BlockSource<'a>,
    /// Whether the output holds the sums of other inputs, to which those of this one are added.
    pub adds: bool,
    /// What follows the last input's sums.
    pub activation: Option<BlockActivation<'a>>,
}

/// The end of a layer, for each output channel.
#[derive(Debug, Clone, Copy)]
pub struct BlockActivation<'a> {
    /// Added before the ReLU.
    pub bias: &'a [f32],
    /// Subtracted after the ReLU.
    pub constant: &'a [f32],
}

/// Convolves blocks with their neighbours, and adds the bias, applies the ReLU and subtracts the constant where they are given.
/// `output` holds the output blocks `[block][z][y][x][channel]`, without a block for the missing ones.
///
/// `stop` is asked before each batch of blocks. Once it says true, the remaining ones are left out, and the output is not
/// to be used.
///
/// # Panics
/// If the layer has tiles of 2, or a slice is shorter than the sizes say.
pub fn conv3d_blocks(level: SimdLevel, conv: &BlockConv3d, stop: &(dyn Fn() -> bool + Sync), output: &mut [f32]) {
    assert_eq!(conv.layer.tile, BLOCK_SIDE, "a block is one tile");
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
    let &BlockConv3d { layer, adds, activation, .. } = conv;
    let number = output.len() / (BLOCK_VOXELS * layer.outputs);
    let gather = BlocksFrom { conv, first, number };
    let (products, pitch) =
        multiply_tiles::<L, ROWS, N>(token, layer, number, &gather, &mut buffers.inputs, &mut buffers.products);
    let output_blocks = layer.outputs.div_ceil(LANES);
    let zero = L::splat(token, 0.0);
    let mut partial = Partial::<L, N>::new(token);
    for (block, output) in output.chunks_exact_mut(BLOCK_VOXELS * layer.outputs).enumerate() {
        for out in 0..output_blocks {
            partial.read(&products[out * pitch + block * LANES..], output_blocks * pitch);
            let lanes = LANES.min(layer.outputs - out * LANES);
            let terms = activation.map(|BlockActivation { bias, constant }| {
                [bias, constant].map(|terms| load::<L>(token, &terms[out * LANES..], lanes))
            });
            for y in 0..BLOCK_SIDE {
                for x in 0..BLOCK_SIDE {
                    let mut column = [zero; N];
                    for (value, plane) in column.iter_mut().zip(&partial.planes) {
                        *value = plane[y][x];
                    }
                    for (z, value) in outputs_of_axis(column).into_iter().enumerate() {
                        let voxel = (z * BLOCK_SIDE + y) * BLOCK_SIDE + x;
                        let output = &mut output[voxel * layer.outputs + out * LANES..];
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

/// So many output blocks from the first one on.
struct BlocksFrom<'a> {
    conv: &'a BlockConv3d<'a>,
    first: usize,
    number: usize,
}

impl Gather for BlocksFrom<'_> {
    #[inline(always)]
    fn transform<L: Lanes, const M: usize>(
        &self,
        token: L::Token,
        block: &Block,
        half: usize,
        to: &mut [f32],
        pitch: usize,
    ) {
        let source = &self.conv.source;
        let lanes = LANES.min(block.channels - half * LANES);
        let values = &source.values[block.first[0] + half * LANES..];
        let zero = L::splat(token, 0.0);
        let mut columns = [[[zero; M]; M]; M];
        let mut rows = [[zero; M]; M];
        for tile in 0..self.number {
            let output = self.first + tile;
            let neighbors = source.stored(output);
            // The first half of the block's channels fetches the next block's values for both halves.
            let next = if half == 0 && output + 1 < source.neighbors.len() { output + 1 } else { output };
            let fetched = source.stored(next);
            let [next_x, next_y, next_z] = [source.places(next, 0), source.places(next, 1), source.places(next, 2)];
            let [x, y, z] = [source.places(output, 0), source.places(output, 1), source.places(output, 2)];
            // Two neighbours of an upsampled volume are one voxel.
            let is_repeated = |i: usize| block.upsampled && i > 0 && i.is_multiple_of(2);
            for i in 0..M {
                if is_repeated(i) {
                    columns[i] = columns[i - 1];
                    continue;
                }
                for j in 0..M {
                    if is_repeated(j) {
                        rows[j] = rows[j - 1];
                        continue;
                    }
                    let mut along_z = [zero; M];
                    for k in 0..M {
                        if is_repeated(k) {
                            along_z[k] = along_z[k - 1];
                            continue;
                        }
                        if half == 0 {
                            let from = source.first_value(&fetched, [next_x[i], next_y[j], next_z[k]]);
                            let ahead = values.as_ptr().wrapping_add(from);
                            L::prefetch(ahead);
                            L::prefetch(ahead.wrapping_add(LANES));
                        }
                        along_z[k] = load(token, &values[source.first_value(&neighbors, [x[i], y[j], z[k]])..], lanes);
                    }
                    rows[j] = inputs_of_axis(along_z);
                }
                for z in 0..M {
                    let mut along_y = [zero; M];
                    for (value, row) in along_y.iter_mut().zip(&rows) {
                        *value = row[z];
                    }
                    columns[i][z] = inputs_of_axis(along_y);
                }
            }
            store_inputs(&columns, &mut to[tile * super::pack::BLOCK..], pitch);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::naive;

    /// All blocks of a volume of `blocks` blocks a side, with zeros in the missing block 0, and their neighbours.
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

        /// Values `[z][y][x][channel]` block by block.
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
            let parts = PackedConv3d::new(&sources, outputs, &weight, BLOCK_SIDE).into_sources();
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

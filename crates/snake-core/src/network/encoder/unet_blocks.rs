//! The U-Net on blocks. It has the shape of the dense one, but its convolutions have a bias instead of a normalisation.

use snake_geometry::chunks_in_parallel;
use std::ops::Range;

use snake_kernels::{
    BLOCK_VOXELS, BlockActivation, BlockConv3d, BlockSource, Buffer, BufferPool, Epilogue, PackedConv3d, SimdLevel,
    conv3d_blocks,
};

use crate::Result;
use crate::control::Counter;
use crate::lattice::Level;
use crate::network::config::ModelConfig;
use crate::network::layers::{Linear, TILE};
use crate::network::weights::Scope;

/// Convolution with a bias, then ReLU.
#[derive(Debug)]
struct BlockConv {
    /// The weights for each input.
    parts: Vec<PackedConv3d>,
    /// The bias plus the contribution of the input's constant, because values are stored as differences from it.
    bias: Vec<f32>,
    /// The output far from all points.
    constant: Vec<f32>,
}

impl BlockConv {
    /// Loads the layer for inputs with these numbers of channels, each upsampled or not, and with these constants.
    fn load(scope: &Scope, sources: &[(usize, bool)], outputs: usize, constants: &[f32]) -> Result<Self> {
        let inputs: usize = sources.iter().map(|source| source.0).sum();
        let weight = scope.tensor("conv.weight", &[outputs, inputs, 3, 3, 3])?;
        let constant_outputs = weight.chunks_exact(27 * inputs).map(|filters| {
            let taps = filters.chunks_exact(27).zip(constants);
            taps.map(|(taps, &value)| taps.iter().map(|&w| f64::from(w)).sum::<f64>() * f64::from(value)).sum::<f64>()
        });
        let bias = scope.tensor("conv.bias", &[outputs])?;
        let bias: Vec<f32> =
            bias.iter().zip(constant_outputs).map(|(&b, added)| (f64::from(b) + added) as f32).collect();
        Ok(Self {
            parts: PackedConv3d::for_blocks(sources, outputs, &weight),
            constant: bias.iter().map(|value| value.max(0.0)).collect(),
            bias,
        })
    }

    fn outputs(&self) -> usize {
        self.bias.len()
    }

    /// Adds the convolution of input number `part` for as many blocks as `values` holds, block 0 included. The first input
    /// overwrites the values. After the last one, the values are differences between the activations and the layer's constant.
    fn forward(&self, part: usize, source: BlockSource, values: &mut [f32], counter: &Counter) -> Result<()> {
        let (missing, stored) = values.split_at_mut(BLOCK_VOXELS * self.outputs());
        missing.fill(0.0);
        let activation = BlockActivation { bias: &self.bias, constant: &self.constant };
        let activation = (part + 1 == self.parts.len()).then_some(activation);
        let conv = BlockConv3d { layer: &self.parts[part], source, adds: part > 0, activation };
        conv3d_blocks(SimdLevel::current(), &conv, &|| counter.is_stopped(), stored);
        counter.check()
    }
}

/// Two convolutions.
type DoubleConv = [BlockConv; 2];

/// The U-Net of a scene model.
#[derive(Debug)]
pub(super) struct BlockUnet {
    encoders: Vec<DoubleConv>,
    /// From the finest level on.
    decoders: Vec<DoubleConv>,
    final_conv: Linear,
    channels: Vec<usize>,
    pool: BufferPool,
}

/// The numbers of values of one level.
struct Lengths {
    input: usize,
    /// Between the two convolutions of the encoder.
    middle: usize,
    /// The output of the encoder.
    skip: usize,
    /// Between the two convolutions of the decoder; 0 on the coarsest level.
    decoded: usize,
    result: usize,
}

/// Where the values of one level lie in the memory. Each level has a window of it. The input, the encoder's output and the
/// result lie at one end of the window, and values between convolutions at the other. The next level's window excludes the
/// decoder's sums, and its input lies beside them.
struct Places {
    input: Range<usize>,
    middle: Range<usize>,
    skip: Range<usize>,
    /// The decoder's sums: first over the encoder's output only, later also over the upsampled coarser level.
    sums: Range<usize>,
    result: Range<usize>,
}

/// Two parts of the memory that do not overlap.
fn two<'a>(memory: &'a mut [f32], from: &Range<usize>, to: &Range<usize>) -> [&'a mut [f32]; 2] {
    memory.get_disjoint_mut([from.clone(), to.clone()]).expect("the memory has room for both")
}

impl BlockUnet {
    pub(super) fn load(scope: &Scope, config: &ModelConfig) -> Result<Self> {
        let channels: Vec<usize> = (0..config.unet_levels).map(|level| config.unet_base_channels << level).collect();
        let double =
            |name: String, sources: &[(usize, bool)], middle, outputs, constants: &[f32]| -> Result<DoubleConv> {
                let scope = |number: u8| scope.at(&format!("{name}.basic_module.SingleConv{number}"));
                let first = BlockConv::load(&scope(1), sources, middle, constants)?;
                let second = BlockConv::load(&scope(2), &[(middle, false)], outputs, &first.constant)?;
                Ok([first, second])
            };
        let mut encoders: Vec<DoubleConv> = Vec::new();
        let mut constant = vec![0.0; config.c_dim];
        for (level, &outputs) in channels.iter().enumerate() {
            let inputs = if level == 0 { config.c_dim } else { channels[level - 1] };
            let name = format!("encoders.{level}");
            encoders.push(double(name, &[(inputs, false)], inputs.max(outputs / 2), outputs, &constant)?);
            constant.clone_from(&encoders[level][1].constant);
        }
        let mut decoders: Vec<DoubleConv> = Vec::new();
        for level in (0..config.unet_levels - 1).rev() {
            let outputs = channels[level];
            let constants = [&encoders[level][1].constant[..], &constant].concat();
            let name = format!("decoders.{}", config.unet_levels - 2 - level);
            let sources = [(outputs, false), (2 * outputs, true)];
            decoders.insert(0, double(name, &sources, outputs, outputs, &constants)?);
            constant.clone_from(&decoders[0][1].constant);
        }
        let scope = scope.at("final_conv");
        let weight = scope.tensor("weight", &[config.c_dim, channels[0], 1, 1, 1])?;
        let mut bias = scope.tensor("bias", &[config.c_dim])?;
        for (bias, weights) in bias.iter_mut().zip(weight.chunks_exact(channels[0])) {
            *bias += weights.iter().zip(&constant).map(|(w, c)| w * c).sum::<f32>();
        }
        let final_conv = Linear::new(channels[0], config.c_dim, &weight, &bias);
        Ok(Self { encoders, decoders, final_conv, channels, pool: BufferPool::default() })
    }

    pub(super) fn num_levels(&self) -> usize {
        self.encoders.len()
    }

    /// The progress units of [`BlockUnet::forward`]: the nodes of each level for each pair of convolutions.
    pub(super) fn work(&self, levels: &[Level]) -> usize {
        let nodes = |level: &Level| level.grid.len() * BLOCK_VOXELS;
        levels.iter().map(nodes).sum::<usize>() + levels[..levels.len() - 1].iter().map(nodes).sum::<usize>()
    }

    /// The memory for all levels. The nodes of the filled blocks, block 0 included, are at its end, and at least `also` values
    /// fit before them.
    pub(super) fn memory(&self, levels: &[Level], also: usize) -> Buffer {
        let Lengths { input, result, .. } = self.lengths(levels, 0);
        let output = num_values(levels[0].near.len(), self.final_conv.outputs());
        self.pool.take(self.needs(levels, 0).max(output + result).max(input + also))
    }

    fn lengths(&self, levels: &[Level], number: usize) -> Lengths {
        let Level { grid, near, filled, .. } = &levels[number];
        let inputs = self.inputs(number);
        let (middle, outputs) = (self.encoders[number][0].outputs(), self.channels[number]);
        let skip = num_values(grid.len(), outputs);
        let decoder = self.decoders.get(number);
        Lengths {
            input: num_values(filled.len(), inputs),
            middle: num_values(near.len(), middle),
            skip,
            decoded: decoder.map_or(0, |decoder| num_values(grid.len(), decoder[0].outputs())),
            result: decoder.map_or(skip, |_| num_values(near.len(), outputs)),
        }
    }

    /// The number of channels of a level's input.
    fn inputs(&self, number: usize) -> usize {
        if number == 0 { self.final_conv.outputs() } else { self.channels[number - 1] }
    }

    /// The number of values that a level and all coarser ones need.
    fn needs(&self, levels: &[Level], number: usize) -> usize {
        let Lengths { input, middle, skip, decoded, result } = self.lengths(levels, number);
        let encoder = middle + input.max(skip);
        if number + 1 == self.num_levels() {
            return encoder;
        }
        let pooled = self.lengths(levels, number + 1).input;
        encoder.max(skip + pooled + decoded).max(decoded + self.needs(levels, number + 1)).max(decoded + result)
    }

    /// The places of all levels in a memory of `num_values` values. The input of the finest level is at its end.
    fn places(&self, levels: &[Level], num_values: usize) -> Vec<Places> {
        let (mut window, mut is_at_start) = (0..num_values, false);
        let mut places = Vec::new();
        for number in 0..self.num_levels() {
            let lengths = self.lengths(levels, number);
            let at = |is_at_start, length| {
                if is_at_start { window.start..window.start + length } else { window.end - length..window.end }
            };
            let near = |length| at(is_at_start, length);
            let far = |length| at(!is_at_start, length);
            let sums = far(lengths.decoded);
            places.push(Places {
                input: near(lengths.input),
                middle: far(lengths.middle),
                skip: near(lengths.skip),
                sums: sums.clone(),
                result: near(lengths.result),
            });
            window = if is_at_start { window.start..sums.start } else { sums.end..window.end };
            is_at_start = !is_at_start;
        }
        places
    }

    /// Maps the nodes `[block][z][y][x][c_dim]` of the finest level's filled blocks, which are at the end of the memory, to
    /// features of the near blocks. Block 0 of the output has the features far from all points.
    pub(super) fn forward(&self, levels: &[Level], mut memory: Buffer, counter: &Counter) -> Result<Buffer> {
        let places = self.places(levels, memory.len());
        for (number, place) in places.iter().enumerate() {
            let (level, channels) = (&levels[number], self.channels[number]);
            let [first, second] = &self.encoders[number];
            let [input, middle] = two(&mut memory, &place.input, &place.middle);
            first.forward(0, own(level, input, self.inputs(number)), middle, counter)?;
            let [middle, skip] = two(&mut memory, &place.middle, &place.skip);
            second.forward(0, own(level, middle, first.outputs()), skip, counter)?;
            counter.add(level.grid.len() * BLOCK_VOXELS);
            if let Some([first, _]) = self.decoders.get(number) {
                let [skip, pooled] = two(&mut memory, &place.skip, &places[number + 1].input);
                max_pool(skip, channels, &levels[number + 1], pooled);
                let [skip, sums] = two(&mut memory, &place.skip, &place.sums);
                first.forward(0, own(level, skip, channels), sums, counter)?;
            }
        }
        for (number, [first, second]) in self.decoders.iter().enumerate().rev() {
            let (level, place) = (&levels[number], &places[number]);
            let [coarse, sums] = two(&mut memory, &places[number + 1].result, &place.sums);
            let upsampled = BlockSource {
                values: coarse,
                channels: self.channels[number + 1],
                neighbors: &level.coarser,
                halves: Some(&level.halves),
            };
            first.forward(1, upsampled, sums, counter)?;
            let [sums, result] = two(&mut memory, &place.sums, &place.result);
            second.forward(0, own(level, sums, first.outputs()), result, counter)?;
            counter.add(level.grid.len() * BLOCK_VOXELS);
        }
        let (channels, outputs) = (self.channels[0], self.final_conv.outputs());
        let output = places[0].result.len() / channels * outputs;
        let [made, values] = two(&mut memory, &places[0].result, &(0..output));
        chunks_in_parallel(values, TILE * outputs, &|tile, out| {
            let input = &made[tile * TILE * channels..][..out.len() / outputs * channels];
            self.final_conv.forward(input, out, Epilogue::Store);
        });
        memory.truncate(output);
        Ok(memory)
    }
}

/// Values of a level as the source of a convolution on the same level.
fn own<'a>(level: &'a Level, values: &'a [f32], channels: usize) -> BlockSource<'a> {
    BlockSource { values, channels, neighbors: &level.neighbors, halves: None }
}

/// The number of values of `num_blocks` blocks and block 0.
fn num_values(num_blocks: usize, channels: usize) -> usize {
    (num_blocks + 1) * BLOCK_VOXELS * channels
}

/// Max-pooling over 2x2x2 nodes, into the blocks of the next coarser level.
fn max_pool(values: &[f32], channels: usize, coarser: &Level, pooled: &mut [f32]) {
    let block = BLOCK_VOXELS * channels;
    let (missing, stored) = pooled.split_at_mut(block);
    missing.fill(0.0);
    chunks_in_parallel(stored, block, &|number, pooled| {
        let children = &coarser.children[number];
        for (voxel, out) in pooled.chunks_exact_mut(channels).enumerate() {
            let [x, y, z] = [voxel % 4, voxel / 4 % 4, voxel / 16];
            let child = children[(z / 2 * 2 + y / 2) * 2 + x / 2] as usize;
            out.fill(f32::NEG_INFINITY);
            for corner in 0..8 {
                let [x, y, z] = [x % 2 * 2 + (corner & 1), y % 2 * 2 + (corner >> 1 & 1), z % 2 * 2 + (corner >> 2)];
                let node = child * BLOCK_VOXELS + (z * 4 + y) * 4 + x;
                for (most, &value) in out.iter_mut().zip(&values[node * channels..][..channels]) {
                    *most = if value > *most { value } else { *most };
                }
            }
        }
    });
}

//! The U-Net on blocks. It has the shape of the dense one, with a bias in each convolution instead of a normalisation.

use rayon::prelude::*;
use snake_kernels::{
    BLOCK_SIDE, BLOCK_VOXELS, BlockConv3d, BlockSource, Buffer, BufferPool, Epilogue, PackedConv3d, SimdLevel,
    conv3d_blocks,
};

use crate::Result;
use crate::control::Counter;
use crate::lattice::Level;
use crate::network::config::ModelConfig;
use crate::network::layers::{Linear, TILE};
use crate::network::weights::Scope;

/// Values of all blocks of a level, as differences from the layer's constant; block 0 is zero.
type Values = Buffer;

/// Convolution with a bias, then ReLU.
#[derive(Debug)]
struct BlockConv {
    packed: PackedConv3d,
    /// The bias, with what the constant of the input adds to each output.
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
            packed: PackedConv3d::new(sources, outputs, &weight, BLOCK_SIDE),
            constant: bias.iter().map(|value| value.max(0.0)).collect(),
            bias,
        })
    }

    fn forward(&self, sources: &[BlockSource], number: usize, pool: &BufferPool, counter: &Counter) -> Result<Values> {
        let block = BLOCK_VOXELS * self.packed.outputs();
        let mut values = pool.take((number + 1) * block);
        values[..block].fill(0.0);
        let conv = BlockConv3d { layer: &self.packed, sources, bias: &self.bias, constant: &self.constant };
        conv3d_blocks(SimdLevel::current(), &conv, &|| counter.is_stopped(), &mut values[block..]);
        counter.check()?;
        Ok(values)
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
    channels: usize,
    pub(super) pool: BufferPool,
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
        Ok(Self { encoders, decoders, final_conv, channels: channels[0], pool: BufferPool::default() })
    }

    pub(super) fn num_levels(&self) -> usize {
        self.encoders.len()
    }

    /// The progress units of [`BlockUnet::forward`]: the nodes that each pair of convolutions makes.
    pub(super) fn work(&self, levels: &[Level]) -> usize {
        let nodes = |level: &Level| level.grid.len() * BLOCK_VOXELS;
        levels.iter().map(nodes).sum::<usize>() + levels[..levels.len() - 1].iter().map(nodes).sum::<usize>()
    }

    /// Maps nodes `[block][z][y][x][c_dim]` of the near blocks of the finest level, block 0 included, to features of the same
    /// shape. Block 0 of the output has the features far from all points.
    pub(super) fn forward(&self, levels: &[Level], input: Values, counter: &Counter) -> Result<Buffer> {
        let made = self.level(levels, &self.encoders, &self.decoders, input, counter)?;
        let mut output = self.pool.take(made.len() / self.channels * self.final_conv.outputs());
        let outputs = output.par_chunks_mut(TILE * self.final_conv.outputs());
        let chunks = made.par_chunks(TILE * self.channels);
        outputs.zip(chunks).for_each(|(out, input)| self.final_conv.forward(input, out, Epilogue::Store));
        Ok(output)
    }

    /// One level of the U-Net and all coarser ones.
    fn level(
        &self,
        levels: &[Level],
        encoders: &[DoubleConv],
        decoders: &[DoubleConv],
        input: Values,
        counter: &Counter,
    ) -> Result<Values> {
        let (level, encoder) = (&levels[0], &encoders[0]);
        let [near, all] = [level.near.len(), level.grid.len()];
        let skip = self.convolve(encoder, level, [near, all], vec![(input, false)], counter)?;
        let Some((decoder, decoders)) = decoders.split_first() else { return Ok(skip) };
        let pooled = self.max_pool(&skip, encoder[1].packed.outputs(), &levels[1]);
        let coarse = self.level(&levels[1..], &encoders[1..], decoders, pooled, counter)?;
        self.convolve(decoder, level, [all, near], vec![(skip, false), (coarse, true)], counter)
    }

    /// Two convolutions of inputs, each upsampled or not, that make the first so many blocks.
    fn convolve(
        &self,
        [first, second]: &DoubleConv,
        level: &Level,
        made: [usize; 2],
        inputs: Vec<(Values, bool)>,
        counter: &Counter,
    ) -> Result<Values> {
        let sources: Vec<BlockSource> = inputs
            .iter()
            .zip(first.packed.sources())
            .map(|((values, upsampled), channels)| BlockSource {
                values,
                channels,
                neighbors: if *upsampled { &level.coarser } else { &level.neighbors },
                halves: upsampled.then_some(&level.halves[..]),
            })
            .collect();
        let middle = first.forward(&sources, made[0], &self.pool, counter)?;
        drop(sources);
        drop(inputs);
        let channels = first.packed.outputs();
        let source = BlockSource { values: &middle, channels, neighbors: &level.neighbors, halves: None };
        let values = second.forward(&[source], made[1], &self.pool, counter)?;
        counter.add(level.grid.len() * BLOCK_VOXELS);
        Ok(values)
    }

    /// Max-pooling over 2x2x2 nodes, into the blocks of the next coarser level.
    fn max_pool(&self, values: &Values, channels: usize, coarser: &Level) -> Values {
        let block = BLOCK_VOXELS * channels;
        let mut pooled = self.pool.take((coarser.grid.len() + 1) * block);
        pooled[..block].fill(0.0);
        pooled[block..].par_chunks_mut(block).zip(&coarser.children).for_each(|(pooled, children)| {
            for (voxel, out) in pooled.chunks_exact_mut(channels).enumerate() {
                let [x, y, z] = [voxel % 4, voxel / 4 % 4, voxel / 16];
                let child = children[(z / 2 * 2 + y / 2) * 2 + x / 2] as usize;
                out.fill(f32::NEG_INFINITY);
                for corner in 0..8 {
                    let [x, y, z] =
                        [x % 2 * 2 + (corner & 1), y % 2 * 2 + (corner >> 1 & 1), z % 2 * 2 + (corner >> 2)];
                    let node = child * BLOCK_VOXELS + (z * 4 + y) * 4 + x;
                    for (most, &value) in out.iter_mut().zip(&values[node * channels..][..channels]) {
                        *most = if value > *most { value } else { *most };
                    }
                }
            }
        });
        pooled
    }
}

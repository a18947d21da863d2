//! Layers: they hold weights, check shapes and call kernels. Features are flat `(rows, width)`.

use crate::Result;
use crate::network::weights::Scope;
use snake_geometry::chunks_in_parallel;
use snake_kernels::{
    Buffer, BufferPool, ConstantRegion, Conv3d, Epilogue, GroupNorm, PackedConv3d, PackedLinear, SimdLevel, Source,
    channel_sums,
};

/// Rows per task: their features fit the first-level cache.
pub(crate) const TILE: usize = 64;

/// A fully connected layer.
#[derive(Debug)]
pub(crate) struct Linear {
    packed: PackedLinear,
    /// The transposed weights, for gradients.
    transposed: PackedLinear,
}

impl Linear {
    pub(crate) fn load(scope: &Scope, inputs: usize, outputs: usize) -> Result<Self> {
        let bias = scope.tensor("bias", &[outputs])?;
        Ok(Self::new(inputs, outputs, &scope.tensor("weight", &[outputs, inputs])?, &bias))
    }

    pub(crate) fn new(inputs: usize, outputs: usize, weight: &[f32], bias: &[f32]) -> Self {
        let transposed: Vec<f32> = (0..inputs * outputs).map(|i| weight[i % outputs * inputs + i / outputs]).collect();
        Self {
            packed: PackedLinear::new(inputs, outputs, weight, bias),
            transposed: PackedLinear::new(outputs, inputs, &transposed, &[]),
        }
    }

    pub(crate) fn outputs(&self) -> usize {
        self.packed.outputs()
    }

    /// `W input + b`.
    pub(crate) fn forward(&self, input: &[f32], output: &mut [f32], epilogue: Epilogue) {
        snake_kernels::linear(SimdLevel::current(), &self.packed, input, output, epilogue);
    }

    /// `Wᵀ gradient`.
    pub(crate) fn backward(&self, gradient: &[f32], output: &mut [f32], epilogue: Epilogue) {
        snake_kernels::linear(SimdLevel::current(), &self.transposed, gradient, output, epilogue);
    }
}

/// Pre-activation residual block: `x + fc_1(relu(fc_0(relu(x))))`.
#[derive(Debug)]
pub(crate) struct ResnetBlockFc {
    pub(crate) fc_0: Linear,
    pub(crate) fc_1: Linear,
}

impl ResnetBlockFc {
    pub(crate) fn load(scope: &Scope, width: usize) -> Result<Self> {
        Ok(Self {
            fc_0: Linear::load(&scope.at("fc_0"), width, width)?,
            fc_1: Linear::load(&scope.at("fc_1"), width, width)?,
        })
    }
}

/// Channels-last values of a volume while it passes through the U-Net.
#[derive(Debug)]
pub(crate) struct Tensor {
    /// D, H, W.
    pub(crate) size: [usize; 3],
    pub(crate) channels: usize,
    pub(crate) values: Buffer,
    /// Sum and sum of squares of each channel.
    pub(crate) sums: Vec<[f64; 2]>,
    /// The region of voxels with constant values.
    pub(crate) constant: Option<ConstantRegion>,
}

impl Tensor {
    fn new(size: [usize; 3], channels: usize, values: Buffer) -> Self {
        let sums = channel_sums(&values, channels);
        Self { size, channels, values, sums, constant: None }
    }

    pub(crate) fn voxels(&self) -> usize {
        self.size.iter().product()
    }

    /// Max-pooling over 2x2x2 blocks; an odd last slice is dropped.
    pub(crate) fn max_pool(&self, pool: &BufferPool) -> Self {
        let (size, channels) = (self.size.map(|n| n / 2), self.channels);
        let [_, height, width] = size;
        let mut pooled = pool.take(size.iter().product::<usize>() * channels);
        pooled.fill(f32::NEG_INFINITY);
        chunks_in_parallel(&mut pooled, width * channels, &|row, out| {
            let (z, y) = (row / height, row % height);
            for corner in 0..4 {
                let line = &self.line(2 * z + corner / 2, 2 * y + corner % 2)[..2 * width * channels];
                for (out, pair) in out.chunks_exact_mut(channels).zip(line.chunks_exact(2 * channels)) {
                    let (left, right) = pair.split_at(channels);
                    for ((o, l), r) in out.iter_mut().zip(left).zip(right) {
                        *o = o.max(l.max(*r));
                    }
                }
            }
        });
        Self { constant: self.constant.as_ref().map(ConstantRegion::pooled), ..Self::new(size, channels, pooled) }
    }

    /// Concatenates the channels of `self` and of `coarse`, which is upsampled by nearest neighbour to the size of
    /// `self` (index = floor(i · coarse / fine)).
    pub(crate) fn concat_upsampled(&self, coarse: &Self, pool: &BufferPool) -> Self {
        let ([_, height, width], channels) = (self.size, self.channels + coarse.channels);
        let mut joined = pool.take(self.voxels() * channels);
        let source = |axis: usize, i: usize| i * coarse.size[axis] / self.size[axis];
        chunks_in_parallel(&mut joined, width * channels, &|row, out| {
            let (z, y) = (row / height, row % height);
            let (fine_line, coarse_line) = (self.line(z, y), coarse.line(source(0, z), source(1, y)));
            for (x, out) in out.chunks_exact_mut(channels).enumerate() {
                let (skip, upsampled) = out.split_at_mut(self.channels);
                skip.copy_from_slice(&fine_line[x * self.channels..][..self.channels]);
                upsampled.copy_from_slice(&coarse_line[source(2, x) * coarse.channels..][..coarse.channels]);
            }
        });
        Self::new(self.size, channels, joined)
    }

    /// A linear layer at each voxel (a 1x1x1 convolution).
    pub(crate) fn pointwise(&self, layer: &Linear, pool: &BufferPool) -> Buffer {
        let mut output = pool.take(self.voxels() * layer.outputs());
        chunks_in_parallel(&mut output, TILE * layer.outputs(), &|tile, out| {
            let input = &self.values[tile * TILE * self.channels..][..out.len() / layer.outputs() * self.channels];
            layer.forward(input, out, Epilogue::Store);
        });
        output
    }

    fn line(&self, z: usize, y: usize) -> &[f32] {
        let [_, height, width] = self.size;
        &self.values[(z * height + y) * width * self.channels..][..width * self.channels]
    }
}

/// From this number of voxels on, the savings of 4x4x4 tiles outweigh their larger weights.
const LARGE: usize = 16 * 16 * 16;

/// GroupNorm, 3x3x3 convolution without bias, ReLU ("gcr").
#[derive(Debug)]
pub(crate) struct SingleConv {
    norm: GroupNorm,
    conv: PackedConv3d,
}

impl SingleConv {
    /// Loads the layer for concatenated inputs with these numbers of channels, each upsampled by two or not, and for
    /// volumes of `voxels` voxels.
    pub(crate) fn load(
        scope: &Scope,
        sources: &[(usize, bool)],
        outputs: usize,
        groups: usize,
        voxels: usize,
    ) -> Result<Self> {
        let inputs = sources.iter().map(|source| source.0).sum();
        let weight = scope.tensor("conv.weight", &[outputs, inputs, 3, 3, 3])?;
        let groups = if inputs < groups { 1 } else { groups };
        if !inputs.is_multiple_of(groups) {
            let actual = format!("{inputs} channels at a normalisation");
            return Err(crate::network::weights::error(
                "group_norm_groups",
                "a divisor of every layer's channels",
                actual,
            ));
        }
        let (weight_of_norm, bias) =
            (scope.tensor("groupnorm.weight", &[inputs])?, scope.tensor("groupnorm.bias", &[inputs])?);
        Ok(Self {
            norm: GroupNorm { groups, weight: weight_of_norm, bias },
            conv: PackedConv3d::new(sources, outputs, &weight, if voxels >= LARGE { 4 } else { 2 }),
        })
    }

    /// The first input has the output's size, a second one half of it. Once `stop` returns true, the rest is skipped
    /// and the output must not be used.
    pub(crate) fn forward<const N: usize>(
        &self,
        inputs: [&Tensor; N],
        pool: &BufferPool,
        stop: &(dyn Fn() -> bool + Sync),
    ) -> Tensor {
        let size = inputs[0].size;
        let voxels = inputs[0].voxels();
        // Upsampling repeats each value eight times.
        let sums = inputs.iter().flat_map(|input| {
            let repeats = (voxels / input.voxels()) as f64;
            input.sums.iter().map(move |sum| sum.map(|s| s * repeats))
        });
        let sums: Vec<_> = sums.collect();
        let norm = self.norm.scale_and_shift(&sums, voxels);
        let sources = inputs.map(|input| Source {
            values: &input.values,
            channels: input.channels,
            upsampled: input.size != size,
        });
        let constant = match &inputs[..] {
            [input] => input.constant.as_ref().map(ConstantRegion::convolved),
            _ => None,
        };
        let originals = constant.as_ref().map(|constant| constant.originals(self.conv.tile()));
        let conv = Conv3d {
            layer: &self.conv,
            size,
            sources: &sources,
            scale: &norm[0],
            shift: &norm[1],
            originals: originals.as_deref().unwrap_or_default(),
        };
        let mut values = pool.take(voxels * self.conv.outputs());
        let sums = snake_kernels::conv3d(SimdLevel::current(), &conv, stop, &mut values);
        Tensor { size, channels: self.conv.outputs(), values, sums, constant }
    }
}

//! Layers: weights, shape check, call to a kernel. Rows of features are flat `(rows, width)`.

use rayon::prelude::*;

use crate::Result;
use crate::kernels::{self, PackedConv3d, PackedLinear, SimdLevel};
use crate::weights::Scope;

/// Rows that one task handles at a time: their features stay in the first-level cache.
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

    fn load_without_bias(scope: &Scope, inputs: usize, outputs: usize) -> Result<Self> {
        Ok(Self::new(inputs, outputs, &scope.tensor("weight", &[outputs, inputs])?, &[]))
    }

    pub(crate) fn new(inputs: usize, outputs: usize, weight: &[f32], bias: &[f32]) -> Self {
        let turned: Vec<f32> = (0..inputs * outputs).map(|i| weight[i % outputs * inputs + i / outputs]).collect();
        Self {
            packed: PackedLinear::new(inputs, outputs, weight, bias),
            transposed: PackedLinear::new(outputs, inputs, &turned, &[]),
        }
    }

    pub(crate) fn outputs(&self) -> usize {
        self.packed.outputs
    }

    /// `output = W input + b`.
    pub(crate) fn forward(&self, input: &[f32], output: &mut [f32]) {
        kernels::linear(SimdLevel::current(), &self.packed, input, output, false);
    }

    /// `output += W input + b`.
    pub(crate) fn forward_add(&self, input: &[f32], output: &mut [f32]) {
        kernels::linear(SimdLevel::current(), &self.packed, input, output, true);
    }

    /// `output = Wᵀ gradient`.
    pub(crate) fn backward(&self, gradient: &[f32], output: &mut [f32]) {
        kernels::linear(SimdLevel::current(), &self.transposed, gradient, output, false);
    }

    /// `output += Wᵀ gradient`.
    pub(crate) fn backward_add(&self, gradient: &[f32], output: &mut [f32]) {
        kernels::linear(SimdLevel::current(), &self.transposed, gradient, output, true);
    }
}

/// Pre-activation residual block: `shortcut(x) + fc_1(relu(fc_0(relu(x))))`.
#[derive(Debug)]
pub(crate) struct ResnetBlockFc {
    pub(crate) fc_0: Linear,
    pub(crate) fc_1: Linear,
    shortcut: Option<Linear>,
}

impl ResnetBlockFc {
    pub(crate) fn load(scope: &Scope, inputs: usize, outputs: usize) -> Result<Self> {
        let hidden = inputs.min(outputs);
        let shortcut = (inputs != outputs).then(|| Linear::load_without_bias(&scope.at("shortcut"), inputs, outputs));
        Ok(Self {
            fc_0: Linear::load(&scope.at("fc_0"), inputs, hidden)?,
            fc_1: Linear::load(&scope.at("fc_1"), hidden, outputs)?,
            shortcut: shortcut.transpose()?,
        })
    }

    /// The block's output for rows of input; `hidden`, resized as needed, keeps what `fc_0` gave.
    pub(crate) fn forward(&self, input: &[f32], hidden: &mut Vec<f32>, output: &mut [f32]) {
        let rows = output.len() / self.fc_1.outputs();
        hidden.resize(rows * self.fc_0.outputs(), 0.0);
        self.fc_0.forward(&relu(input), hidden);
        match &self.shortcut {
            Some(shortcut) => shortcut.forward(input, output),
            None => output.copy_from_slice(input),
        }
        self.fc_1.forward_add(&relu(hidden), output);
    }
}

/// `max(x, 0)` of each value.
pub(crate) fn relu(values: &[f32]) -> Vec<f32> {
    values.iter().map(|v| v.max(0.0)).collect()
}

/// Channels-last values of a volume while it passes through the U-Net.
#[derive(Debug)]
pub(crate) struct Tensor {
    /// D, H, W.
    pub(crate) size: [usize; 3],
    pub(crate) channels: usize,
    pub(crate) values: Vec<f32>,
}

impl Tensor {
    pub(crate) fn zeros(size: [usize; 3], channels: usize) -> Self {
        Self { size, channels, values: vec![0.0; size.iter().product::<usize>() * channels] }
    }

    /// Maximum over blocks of 2x2x2; an odd last slice is dropped.
    pub(crate) fn max_pool(&self) -> Self {
        let mut pooled = Self::zeros(self.size.map(|n| n / 2), self.channels);
        let ([_, height, width], channels) = (pooled.size, self.channels);
        pooled.values.par_chunks_mut(width * channels).enumerate().for_each(|(row, out)| {
            let (z, y) = (row / height, row % height);
            out.fill(f32::NEG_INFINITY);
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
        pooled
    }

    /// `self` and, behind its channels, `coarse` upsampled to its size by nearest neighbour
    /// (index = floor(i · coarse / fine)).
    pub(crate) fn concat_upsampled(&self, coarse: &Self) -> Self {
        let mut joined = Self::zeros(self.size, self.channels + coarse.channels);
        let ([_, height, width], channels) = (self.size, joined.channels);
        let source = |axis: usize, i: usize| i * coarse.size[axis] / self.size[axis];
        joined.values.par_chunks_mut(width * channels).enumerate().for_each(|(row, out)| {
            let (z, y) = (row / height, row % height);
            let (fine_line, coarse_line) = (self.line(z, y), coarse.line(source(0, z), source(1, y)));
            for (x, out) in out.chunks_exact_mut(channels).enumerate() {
                let (skip, upsampled) = out.split_at_mut(self.channels);
                skip.copy_from_slice(&fine_line[x * self.channels..][..self.channels]);
                upsampled.copy_from_slice(&coarse_line[source(2, x) * coarse.channels..][..coarse.channels]);
            }
        });
        joined
    }

    /// A linear layer at each voxel (a 1x1x1 convolution).
    pub(crate) fn pointwise(&self, layer: &Linear) -> Self {
        let mut output = Self::zeros(self.size, layer.outputs());
        let chunks = self.values.par_chunks(TILE * self.channels);
        output
            .values
            .par_chunks_mut(TILE * layer.outputs())
            .zip(chunks)
            .for_each(|(out, input)| layer.forward(input, out));
        output
    }

    fn line(&self, z: usize, y: usize) -> &[f32] {
        let [_, height, width] = self.size;
        &self.values[(z * height + y) * width * self.channels..][..width * self.channels]
    }
}

/// GroupNorm, 3x3x3 convolution without bias, ReLU ("gcr").
#[derive(Debug)]
pub(crate) struct SingleConv {
    groups: usize,
    norm_weight: Vec<f32>,
    norm_bias: Vec<f32>,
    conv: PackedConv3d,
}

impl SingleConv {
    const NORM_EPSILON: f64 = 1e-5;

    pub(crate) fn load(scope: &Scope, inputs: usize, outputs: usize, groups: usize) -> Result<Self> {
        let weight = scope.tensor("conv.weight", &[outputs, inputs, 3, 3, 3])?;
        let groups = if inputs < groups { 1 } else { groups };
        if !inputs.is_multiple_of(groups) {
            let found = format!("{inputs} channels at a normalisation");
            return Err(crate::weights::error("group_norm_groups", "a divisor of every layer's channels", found));
        }
        Ok(Self {
            groups,
            norm_weight: scope.tensor("groupnorm.weight", &[inputs])?,
            norm_bias: scope.tensor("groupnorm.bias", &[inputs])?,
            conv: PackedConv3d::new(inputs, outputs, &weight),
        })
    }

    /// Consumes its input, whose memory is free before the output is made.
    pub(crate) fn forward(&self, input: Tensor) -> Tensor {
        let size = input.size;
        let (weight, bias) = (&self.norm_weight, &self.norm_bias);
        let statistics = kernels::group_statistics(&input.values, self.groups, weight, bias, Self::NORM_EPSILON);
        let mut padded = Tensor::zeros(size.map(|n| n + 2), self.conv.inputs);
        kernels::normalize_into_padded(&input.values, size, &statistics, &mut padded.values);
        drop(input);
        let mut output = Tensor::zeros(size, self.conv.outputs);
        kernels::conv3d(SimdLevel::current(), &self.conv, size, &padded.values, &mut output.values);
        output
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pooling_and_upsampling_of_odd_sizes() {
        let fine = Tensor { size: [1, 2, 5], channels: 1, values: (0..10).map(|v| v as f32).collect() };
        assert_eq!(
            Tensor { size: [2, 2, 5], values: [fine.values.clone(), fine.values.clone()].concat(), ..fine }
                .max_pool()
                .values,
            [6.0, 8.0]
        );
        let fine = Tensor { size: [1, 1, 5], channels: 1, values: vec![0.0; 5] };
        let coarse = Tensor { size: [1, 1, 2], channels: 1, values: vec![1.0, 2.0] };
        // floor(i * 2 / 5) = 0 0 0 1 1.
        assert_eq!(fine.concat_upsampled(&coarse).values, [0.0, 1.0, 0.0, 1.0, 0.0, 1.0, 0.0, 2.0, 0.0, 2.0]);
    }
}

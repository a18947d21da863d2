//! 3-D U-Net: max-pooling in the encoder, nearest-neighbour upsampling to the size of the skip in the decoder.

use crate::Result;
use crate::control::Counter;
use crate::lattice::VolumeFrame;
use crate::network::config::ModelConfig;
use crate::network::layers::{Linear, SingleConv, Tensor};
use crate::network::weights::Scope;
use snake_kernels::{Buffer, BufferPool};

type DoubleConv = [SingleConv; 2];

/// The U-Net of the encoder.
#[derive(Debug)]
pub(crate) struct UNet3d {
    /// The encoder at full resolution.
    top: DoubleConv,
    /// The encoders at lower resolutions, each after a max-pooling.
    deeper: Vec<DoubleConv>,
    decoders: Vec<DoubleConv>,
    final_conv: Linear,
    pub(crate) pool: BufferPool,
}

impl UNet3d {
    pub(crate) fn load(scope: &Scope, config: &ModelConfig, frame: VolumeFrame) -> Result<Self> {
        let channels: Vec<usize> = (0..config.unet_levels).map(|level| config.unet_base_channels << level).collect();
        let double = |name: String, level: usize, sources: &[(usize, bool)], middle, outputs| -> Result<DoubleConv> {
            let voxels = frame.resolution.iter().map(|n| n >> level).product();
            let conv = |number: u8, sources: &[(usize, bool)], outputs| {
                let scope = scope.at(&format!("{name}.basic_module.SingleConv{number}"));
                SingleConv::load(&scope, sources, outputs, config.group_norm_groups, voxels)
            };
            Ok([conv(1, sources, middle)?, conv(2, &[(middle, false)], outputs)?])
        };
        let encoder = |level: usize| {
            let inputs = if level == 0 { config.c_dim } else { channels[level - 1] };
            let outputs = channels[level];
            double(format!("encoders.{level}"), level, &[(inputs, false)], inputs.max(outputs / 2), outputs)
        };
        let doubles = |level: usize| frame.resolution.iter().all(|n| (n >> level).is_multiple_of(2));
        let decoder = |k: usize| {
            let level = config.unet_levels - 2 - k;
            let outputs = channels[level];
            // If the coarser size is exactly half, the convolution upsamples while it reads.
            let sources: &[_] =
                if doubles(level) { &[(outputs, false), (2 * outputs, true)] } else { &[(3 * outputs, false)] };
            double(format!("decoders.{k}"), level, sources, outputs, outputs)
        };
        Ok(Self {
            top: encoder(0)?,
            deeper: (1..config.unet_levels).map(encoder).collect::<Result<_>>()?,
            decoders: (0..config.unet_levels - 1).map(decoder).collect::<Result<_>>()?,
            pool: BufferPool::default(),
            final_conv: {
                let scope = scope.at("final_conv");
                let weight = scope.tensor("weight", &[config.c_dim, channels[0], 1, 1, 1])?;
                Linear::new(channels[0], config.c_dim, &weight, &scope.tensor("bias", &[config.c_dim])?)
            },
        })
    }

    /// The progress units of [`UNet3d::forward`]: the output voxels of each pair of convolutions.
    pub(crate) fn work(&self, size: [usize; 3]) -> usize {
        let levels = (0..=self.deeper.len()).chain(0..self.decoders.len());
        levels.map(|level| size.iter().map(|n| n >> level).product::<usize>()).sum()
    }

    /// Maps a volume `(D, H, W, c_dim)` to a volume of the same shape.
    pub(crate) fn forward(&self, volume: Tensor, counter: &Counter) -> Result<Buffer> {
        let made = self.level(&self.top, &self.deeper, &self.decoders, volume, counter)?;
        Ok(made.pointwise(&self.final_conv, &self.pool))
    }

    /// One level of the U-Net and all coarser ones. `decoders` runs from the coarsest level to this one.
    fn level(
        &self,
        encoder: &DoubleConv,
        deeper: &[DoubleConv],
        decoders: &[DoubleConv],
        input: Tensor,
        counter: &Counter,
    ) -> Result<Tensor> {
        let skip = self.convolve(encoder, [input], counter)?;
        let ([encoder, deeper @ ..], [decoders @ .., decoder]) = (deeper, decoders) else { return Ok(skip) };
        let coarse = self.level(encoder, deeper, decoders, skip.max_pool(&self.pool), counter)?;
        if skip.size == coarse.size.map(|n| 2 * n) {
            self.convolve(decoder, [skip, coarse], counter)
        } else {
            self.convolve(decoder, [skip.concat_upsampled(&coarse, &self.pool)], counter)
        }
    }

    fn convolve<const N: usize>(
        &self,
        [first, second]: &DoubleConv,
        inputs: [Tensor; N],
        counter: &Counter,
    ) -> Result<Tensor> {
        let stop = || counter.is_stopped();
        let middle = first.forward(inputs.each_ref(), &self.pool, &stop);
        drop(inputs);
        counter.check()?;
        let made = second.forward([&middle], &self.pool, &stop);
        counter.check()?;
        counter.add(made.voxels());
        Ok(made)
    }
}

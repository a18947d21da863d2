//! 3-D U-Net: max-pool on the way down, nearest upsampling to the skip's size on the way up.

use crate::Result;
use crate::model::ModelConfig;
use crate::nn::{Linear, SingleConv, Tensor};
use crate::weights::Scope;

type DoubleConv = [SingleConv; 2];

/// The U-Net of the encoder.
#[derive(Debug)]
pub(crate) struct UNet3d {
    /// The encoder at full resolution.
    top: DoubleConv,
    /// The encoders below it, each after a pooling.
    deeper: Vec<DoubleConv>,
    decoders: Vec<DoubleConv>,
    final_conv: Linear,
}

impl UNet3d {
    pub(crate) fn load(scope: &Scope, config: &ModelConfig) -> Result<Self> {
        let channels: Vec<usize> = (0..config.unet_levels).map(|level| config.unet_base_channels << level).collect();
        let double = |name: String, inputs, middle, outputs| -> Result<DoubleConv> {
            let conv = |number: u8, inputs, outputs| {
                let scope = scope.at(&format!("{name}.basic_module.SingleConv{number}"));
                SingleConv::load(&scope, inputs, outputs, config.group_norm_groups)
            };
            Ok([conv(1, inputs, middle)?, conv(2, middle, outputs)?])
        };
        let encoder = |level: usize| {
            let inputs = if level == 0 { config.c_dim } else { channels[level - 1] };
            let outputs = channels[level];
            double(format!("encoders.{level}"), inputs, inputs.max(outputs / 2), outputs)
        };
        let decoder = |k: usize| {
            let outputs = channels[config.unet_levels - 2 - k];
            double(format!("decoders.{k}"), 3 * outputs, outputs, outputs)
        };
        Ok(Self {
            top: encoder(0)?,
            deeper: (1..config.unet_levels).map(encoder).collect::<Result<_>>()?,
            decoders: (0..config.unet_levels - 1).map(decoder).collect::<Result<_>>()?,
            final_conv: {
                let scope = scope.at("final_conv");
                let weight = scope.tensor("weight", &[config.c_dim, channels[0], 1, 1, 1])?;
                Linear::new(channels[0], config.c_dim, &weight, &scope.tensor("bias", &[config.c_dim])?)
            },
        })
    }

    /// `(D, H, W, c_dim)` to the same size and width.
    pub(crate) fn forward(&self, volume: Tensor) -> Tensor {
        let run = |[first, second]: &DoubleConv, input| second.forward(first.forward(input));
        let mut skips = Vec::with_capacity(self.decoders.len());
        let mut current = run(&self.top, volume);
        for encoder in &self.deeper {
            let pooled = current.max_pool();
            skips.push(current);
            current = run(encoder, pooled);
        }
        for (decoder, skip) in self.decoders.iter().zip(skips.into_iter().rev()) {
            let joined = skip.concat_upsampled(&current);
            drop((skip, current));
            current = run(decoder, joined);
        }
        current.pointwise(&self.final_conv)
    }
}

//! Thinned and noisy copies of a cloud, as in the paper's pictures.

use anyhow::{Context, Result};
use clap::Args;
use snake_core::Length;
use snake_eval::views::Condition;
use snake_io::Cloud;

use crate::setup::none_if_zero;

/// Options that disturb a cloud before anything is done with it.
#[derive(Args)]
pub struct DisturbArguments {
    /// Keep one point in N, chosen at random.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    downsample: u32,
    /// Add Gaussian noise with this standard deviation to each coordinate: in cloud units, in multiples of the cloud's
    /// resolution (`3r`), or in per cent of its radius (`6%`) [default: 0].
    #[arg(long, value_name = "LENGTH")]
    noise: Option<Length>,
}

impl DisturbArguments {
    /// Disturbs a cloud. Lengths refer to the cloud as it was read.
    pub fn apply(&self, cloud: Cloud, seed: u64) -> Result<Cloud> {
        let noise = self.noise.and_then(none_if_zero).map(|length| length.in_units("noise", &cloud.points)).transpose();
        let condition =
            Condition { downsample: self.downsample as usize, noise: noise.context("--noise")?.unwrap_or(0.0) };
        if condition == (Condition { downsample: 1, noise: 0.0 }) {
            return Ok(cloud);
        }
        Ok(Cloud { points: condition.apply(&cloud.points, seed)?, ..cloud })
    }
}

//! The checks before every call: the options of a network, and limits of memory and time. Without the limits, a small
//! weight file could use all memory or run for hours even if each option is within its range.

use super::{ModelConfig, Network, weights};
use crate::options::{DetectOptions, EncodeOptions, Options};
use crate::{Error, Result};

impl Network {
    /// Refuses options that are out of range, that this network does not support, or that need too much memory or time.
    pub(crate) fn check(&self, options: &Options) -> Result<()> {
        self.check_encode(&options.encode)?;
        self.check_detect(&options.detect, options.encode.rotations)
    }

    /// [`Network::check`] for options of encoding.
    pub(crate) fn check_encode(&self, options: &EncodeOptions) -> Result<()> {
        options.check()?;
        self.config.volume.check(options)?;
        check_rotations(options.rotations, &self.config)
    }

    /// [`Network::check`] for options of detection in a field of `rotations` copies.
    pub(crate) fn check_detect(&self, options: &DetectOptions, rotations: usize) -> Result<()> {
        options.check_ranges()?;
        check_queries(options.query_resolution, options.refine_steps, rotations)?;
        match options.min_confidence {
            Some(min) if self.confidence.is_none() => {
                let allowed =
                    "none with this model, whose file has no map of confidences; snake_training.confidence fits one";
                Err(Error::Option { name: "min_confidence", value: min.to_string(), allowed })
            }
            _ => Ok(()),
        }
    }
}

/// Maximum number of values of one feature volume: 256 MiB. The U-Net needs about five volumes at a time.
const MAX_VOLUME_VALUES: usize = 1 << 26;

/// Maximum number of values of the feature volumes of all rotations: 1 GiB.
const MAX_ROTATIONS_VALUES: usize = 1 << 28;

/// Maximum number of values of a scene's volume: 1 GiB. The U-Net needs about three volumes at a time.
const MAX_SCENE_VALUES: usize = 1 << 28;

/// Maximum number of evaluations of the decoders: a minute on four cores for the built-in networks.
const MAX_EVALUATIONS: usize = 1 << 28;

/// Number of channels that the kernels compute at once. A voxel with fewer channels costs as much.
const MIN_CHANNELS: usize = 16;

/// Number of values of a feature volume, or of the widest volume of this resolution in the U-Net. It is 0 for a scene
/// model, whose volume is known only with the cloud.
fn volume_values(config: &ModelConfig) -> usize {
    config.volume.num_voxels() * widest(config)
}

fn widest(config: &ModelConfig) -> usize {
    config.c_dim.max(config.unet_base_channels).max(MIN_CHANNELS)
}

/// Refuses a network whose feature volume would be too large.
pub(super) fn check_volume(config: &ModelConfig) -> Result<()> {
    let values = volume_values(config);
    if values <= MAX_VOLUME_VALUES {
        return Ok(());
    }
    let channels = widest(config);
    let shape = config.volume;
    let actual = format!("{shape} of {channels} channels (at least {MIN_CHANNELS} are counted), {values} values");
    Err(weights::error("resolution", &format!("a volume of at most {MAX_VOLUME_VALUES} values"), actual))
}

/// The maximum number of blocks of a scene's volume with this number of channels.
pub(crate) fn max_blocks(channels: usize) -> usize {
    MAX_SCENE_VALUES / (snake_kernels::BLOCK_VOXELS * channels.max(MIN_CHANNELS))
}

/// Refuses more rotations than fit into the memory for feature volumes.
fn check_rotations(rotations: usize, config: &ModelConfig) -> Result<()> {
    let values = volume_values(config);
    if rotations.saturating_mul(values) <= MAX_ROTATIONS_VALUES {
        return Ok(());
    }
    let value = format!("{rotations}, with volumes of {values} values");
    Err(Error::Option { name: "rotations", value, allowed: "at most 268435456 values in all volumes together" })
}

/// Refuses more queries, steps and rotations than can be evaluated in a minute or two.
fn check_queries(query_resolution: usize, refine_steps: usize, rotations: usize) -> Result<()> {
    let factors = [query_resolution, query_resolution, query_resolution, refine_steps.saturating_add(1), rotations];
    if factors.into_iter().fold(1, usize::saturating_mul) <= MAX_EVALUATIONS {
        return Ok(());
    }
    let value = format!("{query_resolution}, with {refine_steps} refine_steps and {rotations} rotations");
    let allowed = "query_resolution³ × (refine_steps + 1) × rotations of at most 268435456";
    Err(Error::Option { name: "query_resolution", value, allowed })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Builtin, Model, VolumeFrame, VolumeShape};

    fn with_resolution(resolution: usize) -> (VolumeFrame, ModelConfig) {
        let config = *Model::builtin(Builtin::Compact).config();
        let frame = VolumeFrame { resolution: [resolution; 3], ..config.frame().unwrap() };
        (frame, ModelConfig { volume: VolumeShape::Cube(frame), ..config })
    }

    #[test]
    fn the_limits_in_messages_are_those_that_are_checked() {
        let (mut frame, mut config) = with_resolution(128);
        check_volume(&config).unwrap();
        check_rotations(4, &config).unwrap();
        let error = check_rotations(5, &config).unwrap_err().to_string();
        assert!(error.contains(&MAX_ROTATIONS_VALUES.to_string()) && error.contains("is 5, with"), "{error}");
        frame.resolution[0] += 1;
        config.volume = VolumeShape::Cube(frame);
        let error = check_volume(&config).unwrap_err().to_string();
        assert!(error.contains("129 x 128 x 128") && error.contains(&MAX_VOLUME_VALUES.to_string()), "{error}");
        check_queries(256, 15, 1).unwrap();
        check_queries(64, 15, 64).unwrap();
        // The largest query grid of the paper.
        check_queries(100, 10, 16).unwrap();
        for (resolution, steps, rotations) in [(256, 16, 1), (64, 16, 64), (usize::MAX, 0, 1), (1, usize::MAX, 2)] {
            let error = check_queries(resolution, steps, rotations).unwrap_err().to_string();
            assert!(error.contains(&MAX_EVALUATIONS.to_string()), "{error}");
        }
    }
}

//! A network: configuration, layers and metadata. Models and fields share it.

pub(crate) mod budget;
pub(crate) mod confidence;
pub(crate) mod config;
pub(crate) mod decoder;
pub(crate) mod encoder;
pub(crate) mod layers;
pub(crate) mod scene;
pub(crate) mod volume;
pub(crate) mod weights;

pub use self::config::{ModelConfig, PointEncoder, Scatter, VolumeShape};
pub use self::volume::{Volume, VolumeFrame};
pub use self::weights::read_weight_file;

use std::collections::BTreeMap;

use crate::detect::options::{DetectOptions, Options};
use crate::network::confidence::ConfidenceMap;
use crate::network::decoder::Decoder;
use crate::network::encoder::Encoder;
use crate::network::scene::SceneEncoder;
use crate::network::weights::{Scope, Weights};
use crate::{Error, Result};

/// The encoder of a network, by the shape of its volume.
#[derive(Debug)]
pub(crate) enum NetworkEncoder {
    Cube(Box<Encoder>),
    Scene(Box<SceneEncoder>),
}

impl NetworkEncoder {
    fn load(scope: &Scope, config: &ModelConfig) -> Result<Self> {
        Ok(match config.volume {
            VolumeShape::Cube(frame) => Self::Cube(Box::new(Encoder::load(scope, config, frame)?)),
            VolumeShape::Scene { scatter_mass } => {
                Self::Scene(Box::new(SceneEncoder::load(scope, config, scatter_mass)?))
            }
        })
    }

    /// The encoder of a cube, for tests of its stages.
    #[cfg(test)]
    pub(crate) fn cube(&self) -> &Encoder {
        let Self::Cube(encoder) = self else { panic!("this is a scene model") };
        encoder
    }
}

/// Encoder and decoders.
#[derive(Debug)]
pub(crate) struct Network {
    pub(crate) config: ModelConfig,
    pub(crate) metadata: BTreeMap<String, String>,
    pub(crate) recommended: Options,
    pub(crate) num_parameters: usize,
    /// From scores to the probability that another view finds a keypoint again.
    pub(crate) confidence: Option<ConfidenceMap>,
    /// The BLAKE3 digest of the weight file.
    pub(crate) digest: String,
    pub(crate) encoder: NetworkEncoder,
    pub(crate) occupancy: Decoder,
    pub(crate) saliency: Decoder,
}

impl Network {
    /// Loads a network from the bytes of a weight file. A tensor that the network does not use is an error.
    pub(crate) fn from_bytes(bytes: &[u8]) -> Result<Self> {
        let file = Weights::open(bytes)?;
        let config = ModelConfig::from_weights(&file)?;
        if let VolumeShape::Cube(frame) = &config.volume {
            budget::check_volume(frame, &config)?;
        }
        let network = Self {
            config,
            metadata: file.metadata.clone().into_iter().collect(),
            recommended: file.recommended_options()?,
            confidence: ConfidenceMap::from_weights(&file)?,
            encoder: NetworkEncoder::load(&file.at("encoder"), &config)?,
            occupancy: Decoder::occupancy(&file.at("decoder_occup"), &config)?,
            saliency: Decoder::saliency(&file.at("decoder_keypoint"), &config)?,
            num_parameters: file.num_parameters(),
            digest: blake3::hash(bytes).to_string(),
        };
        network.check(&network.recommended)?;
        file.finish()?;
        Ok(network)
    }

    /// Refuses options that this network cannot serve.
    pub(crate) fn check(&self, options: &Options) -> Result<()> {
        options.check(&self.config)?;
        self.check_confidence(&options.detect)
    }

    /// The probability that another view finds a keypoint of this score again.
    pub(crate) fn confidence(&self, score: f32) -> Option<f32> {
        self.confidence.as_ref().map(|map| map.at(score))
    }

    /// Refuses a least confidence without a map.
    pub(crate) fn check_confidence(&self, options: &DetectOptions) -> Result<()> {
        match options.min_confidence {
            Some(least) if self.confidence.is_none() => {
                let allowed =
                    "none with this model, whose file has no map of confidences; snake_training.confidence fits one";
                Err(Error::Option { name: "min_confidence", value: least.to_string(), allowed })
            }
            _ => Ok(()),
        }
    }
}

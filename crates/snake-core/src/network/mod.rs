//! A network: configuration, layers and metadata. Models and fields share it.

pub(crate) mod check;
pub(crate) mod confidence;
pub(crate) mod config;
pub(crate) mod decoder;
pub(crate) mod encoder;
pub(crate) mod layers;
pub(crate) mod volume;
pub(crate) mod weights;

pub use self::config::{ModelConfig, Scatter};
pub use self::volume::Volume;
pub use self::weights::read_weight_file;

use std::collections::BTreeMap;

use crate::Result;
use crate::network::confidence::ConfidenceMap;
use crate::network::decoder::Decoder;
use crate::network::encoder::Encoder;
use crate::network::weights::Weights;
use crate::options::Options;

/// Encoder, decoders and metadata of a model.
#[derive(Debug)]
pub(crate) struct Network {
    pub(crate) config: ModelConfig,
    pub(crate) metadata: BTreeMap<String, String>,
    pub(crate) recommended: Options,
    pub(crate) num_parameters: usize,
    /// Maps scores to the probability that another view finds a keypoint again.
    pub(crate) confidence: Option<ConfidenceMap>,
    /// The BLAKE3 digest of the weight file.
    pub(crate) digest: String,
    pub(crate) encoder: Encoder,
    pub(crate) occupancy: Decoder,
    pub(crate) saliency: Decoder,
}

impl Network {
    /// Loads a network from the bytes of a weight file. A tensor that the network does not use is an error.
    pub(crate) fn from_bytes(bytes: &[u8]) -> Result<Self> {
        let file = Weights::open(bytes)?;
        let config = ModelConfig::from_weights(&file)?;
        check::check_volume(&config)?;
        let network = Self {
            config,
            metadata: file.metadata.clone().into_iter().collect(),
            recommended: file.recommended_options()?,
            confidence: ConfidenceMap::from_weights(&file)?,
            encoder: Encoder::load(&file.at("encoder"), &config)?,
            occupancy: Decoder::occupancy(&file.at("decoder_occup"), &config)?,
            saliency: Decoder::saliency(&file.at("decoder_keypoint"), &config)?,
            num_parameters: file.num_parameters(),
            digest: blake3::hash(bytes).to_string(),
        };
        network.check(&network.recommended)?;
        file.finish()?;
        Ok(network)
    }

    /// The probability that another view finds a keypoint again; `None` without a map. See [`ConfidenceMap::at`] for the arguments.
    pub(crate) fn confidence(&self, score: f32, deviations: [f32; 3], voxel_size: f32, reach: f32) -> Option<f32> {
        self.confidence.as_ref().map(|map| map.at(score, deviations, voxel_size, reach))
    }
}

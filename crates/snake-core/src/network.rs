//! A network: configuration, layers and metadata. Models and fields share it.

use std::collections::BTreeMap;

use crate::Result;
use crate::config::ModelConfig;
use crate::decoder::Decoder;
use crate::encoder::Encoder;
use crate::options::Options;
use crate::weights::{self, Weights};

/// Encoder and decoders.
#[derive(Debug)]
pub(crate) struct Network {
    pub(crate) config: ModelConfig,
    pub(crate) metadata: BTreeMap<String, String>,
    pub(crate) recommended: Options,
    pub(crate) num_parameters: usize,
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
        let network = Self {
            config,
            metadata: file.metadata.clone().into_iter().collect(),
            recommended: match file.metadata.get("recommended_options") {
                Some(json) => serde_json::from_str(json)
                    .map_err(|e| weights::error("recommended_options", "options of snake-rs as JSON", e.to_string()))?,
                None => Options::default(),
            },
            encoder: Encoder::load(&file.at("encoder"), &config)?,
            occupancy: Decoder::occupancy(&file.at("decoder_occup"), &config)?,
            saliency: Decoder::saliency(&file.at("decoder_keypoint"), &config)?,
            num_parameters: file.num_parameters(),
            digest: blake3::hash(bytes).to_string(),
        };
        network.recommended.check(&config)?;
        file.finish()?;
        Ok(network)
    }
}

//! The models that come with the crate.

use crate::network::Network;
use crate::network::weights::Weights;
use crate::options::Options;
use crate::{Error, Model, Result};

const COMPACT: &[u8] = include_bytes!("../models/compact.safetensors");
const SCENES: &[u8] = include_bytes!("../models/scenes.safetensors");

/// A model that comes with the crate (see `models/README.md`), with the feature `builtin-models`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Builtin {
    /// For objects, in any unit.
    #[default]
    Compact,
    /// For rooms, sweeps and streets, in any unit. Its volume follows the cloud.
    Scenes,
}

impl Builtin {
    /// All of them.
    pub const ALL: [Self; 2] = [Self::Compact, Self::Scenes];

    /// Its name for [`Model::named`].
    pub fn name(self) -> &'static str {
        match self {
            Self::Compact => "compact",
            Self::Scenes => "scenes",
        }
    }

    /// The options of [`Model::recommended`], without loading the weights.
    pub fn recommended(self) -> Options {
        Weights::open(self.bytes())
            .and_then(|file| file.recommended_options())
            .expect("a test reads every embedded file")
    }

    fn bytes(self) -> &'static [u8] {
        match self {
            Self::Compact => COMPACT,
            Self::Scenes => SCENES,
        }
    }
}

impl Model {
    /// The names that [`Model::named`] knows: the built-in models, and `standard`.
    pub const NAMES: [&'static str; 3] = ["compact", "standard", "scenes"];

    /// A model that comes with the crate.
    pub fn builtin(which: Builtin) -> Self {
        Self::from_bytes(which.bytes()).expect("a test reads every embedded file")
    }

    /// A built-in model by its name: `compact`, `scenes` or `standard`. The last one is `compact` with four rotated
    /// copies: its keypoints repeat better, and detection takes three times as long.
    ///
    /// # Errors
    /// [`Error::Option`] for an unknown name.
    pub fn named(name: &str) -> Result<Self> {
        match name {
            "compact" => Ok(Self::builtin(Builtin::Compact)),
            "scenes" => Ok(Self::builtin(Builtin::Scenes)),
            "standard" => {
                let mut network = Network::from_bytes(COMPACT)?;
                network.recommended.encode.rotations = 4;
                Ok(Self::from_network(network))
            }
            _ => Err(Error::Option { name: "model", value: name.into(), allowed: "compact, standard or scenes" }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_embedded_model_loads_with_its_recommended_options() {
        let [compact, standard, scenes] = Model::NAMES.map(|name| Model::named(name).unwrap());
        assert_eq!(compact.metadata(), standard.metadata());
        assert_eq!((compact.recommended().encode.rotations, standard.recommended().encode.rotations), (1, 4));
        assert!(scenes.config().frame().is_none());
        assert_eq!(Builtin::Compact.recommended(), *compact.recommended());
        assert_eq!(Builtin::Scenes.recommended(), *scenes.recommended());
        assert_eq!(Model::builtin(Builtin::Scenes).metadata(), scenes.metadata());
        assert_eq!(Model::builtin(Builtin::default()).metadata(), compact.metadata());
        assert!(Model::named("large").is_err());
    }
}

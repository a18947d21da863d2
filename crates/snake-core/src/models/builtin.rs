//! The models that come with the crate, and which of them suits a cloud.

use std::sync::Arc;

use super::Model;
use super::signs::{NUM_SIGNS, scene_signs};
use crate::detect::options::Options;
use crate::network::Network;
use crate::network::scene::sweep::is_sweep;
use crate::network::weights::Weights;
use crate::{Error, Result};
use snake_geometry::{FinitePoints, Point};

const COMPACT: &[u8] = include_bytes!("../../models/compact.safetensors");
const SCENES: &[u8] = include_bytes!("../../models/scenes.safetensors");

/// The weight of each of [`scene_signs`], and that of one.
const WEIGHTS: [f64; NUM_SIGNS + 1] = [-187.6, -9.776, 2.844, -7.656, 0.5591, 5.274, 6.212, -38.05, -8.389];

/// A wire or a curve is no scene: the surroundings of its cells are less broad than this.
const CURVE: f64 = 0.2;

/// Whether a cloud `(N, 3)` of finite points looks like a scene and not like one object.
pub(super) fn looks_like_scene(points: &[Point]) -> bool {
    scene_signs(points).is_some_and(|signs| {
        let [weights @ .., constant] = &WEIGHTS;
        let [_, broad, ..] = signs;
        broad > CURVE && signs.iter().zip(weights).map(|(sign, weight)| sign * weight).sum::<f64>() + constant > 0.0
    })
}

/// A model that comes with the crate (see `models/README.md`), with the feature `builtin-models`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Builtin {
    /// For objects, of any unit.
    #[default]
    Compact,
    /// For rooms, sweeps and streets, of any unit. Its volume follows the cloud.
    Scenes,
}

impl Builtin {
    /// The model for a cloud `(N, 3)` in any unit: [`Builtin::Scenes`] if it looks like the sweep of a sensor in its midst, or
    /// like a room, a street or terrain by its [`scene_signs`](crate::scene_signs); else [`Builtin::Compact`].
    pub fn for_cloud(points: &[Point]) -> Self {
        match FinitePoints::of("points", points) {
            Ok(used) if is_sweep(&used.points) || looks_like_scene(&used.points) => Self::Scenes,
            _ => Self::Compact,
        }
    }

    /// What [`Model::recommended`] of this model is, without loading its weights.
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

    /// A built-in model by its name: `compact`, `scenes`, or `standard`, which is `compact` with four rotated copies:
    /// keypoints repeat better, and detection takes three times as long.
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
                Ok(Self { network: Arc::new(network) })
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

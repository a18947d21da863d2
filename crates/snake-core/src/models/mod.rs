//! A network: its configuration and weights.

mod scale_hint;
mod signs;

pub use self::scale_hint::scale_hint;
use self::signs::looks_like_scene;
pub use self::signs::scene_signs;

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use crate::call::clock::Instant;
use crate::call::control::Control;
use crate::detect::Detection;
#[cfg(feature = "builtin-models")]
use crate::detect::options::Preset;
use crate::detect::options::{EncodeOptions, Options};
use crate::field::Field;
use crate::network::Network;
use crate::network::config::ModelConfig;
use crate::network::scene::is_sweep;
#[cfg(feature = "builtin-models")]
use crate::network::weights::Weights;
use crate::{Error, Result};
use snake_geometry::{FinitePoints, Point};

#[cfg(feature = "builtin-models")]
const COMPACT: &[u8] = include_bytes!("../../models/compact.safetensors");
#[cfg(feature = "builtin-models")]
const SCENES: &[u8] = include_bytes!("../../models/scenes.safetensors");

/// A model that comes with the crate (see `models/README.md`), with the feature `builtin-models`.
#[cfg(feature = "builtin-models")]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Builtin {
    /// For objects, of any unit.
    #[default]
    Compact,
    /// For rooms, sweeps and streets, of any unit. Its volume follows the cloud.
    Scenes,
}

#[cfg(feature = "builtin-models")]
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

/// A network with its weights; cloning it is cheap.
///
/// ```
/// use snake_core::{Builtin, Model};
/// let model = Model::builtin(Builtin::Compact);
/// assert_eq!(model.config().frame().map(|frame| frame.resolution), Some([32, 32, 32]));
/// # Ok::<(), snake_core::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Model {
    network: Arc<Network>,
}

#[cfg(feature = "builtin-models")]
impl Model {
    /// The names that [`Model::named`] knows: the built-in models, and `standard`.
    pub const NAMES: [&'static str; 3] = ["compact", "standard", "scenes"];

    /// A model that comes with the crate.
    pub fn builtin(which: Builtin) -> Self {
        Self::from_bytes(which.bytes()).expect("a test reads every embedded file")
    }

    /// A built-in model by its name: `compact`, `scenes`, or `standard`, which is `compact` with the recommended options of
    /// [`Preset::Standard`].
    ///
    /// # Errors
    /// [`Error::Option`] for an unknown name.
    pub fn named(name: &str) -> Result<Self> {
        match name {
            "compact" => Ok(Self::builtin(Builtin::Compact)),
            "scenes" => Ok(Self::builtin(Builtin::Scenes)),
            "standard" => {
                let mut network = Network::from_bytes(COMPACT)?;
                network.recommended = Preset::Standard.options();
                Ok(Self { network: Arc::new(network) })
            }
            _ => Err(Error::Option { name: "model", value: name.into(), allowed: "compact, standard or scenes" }),
        }
    }
}

impl Model {
    /// Reads a weight file (safetensors; float32 or float16).
    ///
    /// # Errors
    /// [`Error::Io`] when the file cannot be read; [`Error::Weights`] as for [`Model::from_bytes`].
    pub fn load(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let bytes = std::fs::read(path).map_err(|source| Error::Io { path: path.into(), source })?;
        Self::from_bytes(&bytes)
    }

    /// Loads a network from the bytes of a weight file.
    ///
    /// # Errors
    /// [`Error::Weights`] when a tensor or a metadata key is missing, unknown, of another shape or type, or not finite.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self> {
        Ok(Self { network: Arc::new(Network::from_bytes(bytes)?) })
    }

    /// The network's shape.
    pub fn config(&self) -> &ModelConfig {
        &self.network.config
    }

    /// All metadata of the weight file.
    pub fn metadata(&self) -> &BTreeMap<String, String> {
        &self.network.metadata
    }

    /// Number of weights.
    pub fn num_parameters(&self) -> usize {
        self.network.num_parameters
    }

    /// The recommended options of these weights: from the metadata key `recommended_options`, else the defaults.
    pub fn recommended(&self) -> &Options {
        &self.network.recommended
    }

    /// Encodes a cloud `(N, 3)` once. The field then answers any number of queries.
    ///
    /// # Errors
    /// [`Error::Input`] for a cloud without finite points or of an extent outside 1e-15 to 1e15;
    /// [`Error::Weights`] when the weights are so large that the features overflow.
    pub fn encode(&self, points: &[Point], options: &EncodeOptions) -> Result<Field> {
        self.encode_with(points, options, &Control::default())
    }

    /// [`Model::encode`] with progress, cancellation and limits.
    ///
    /// # Errors
    /// The errors of [`Model::encode`]; [`Error::Cancelled`], [`Error::DeadlineExceeded`] and [`Error::LimitExceeded`].
    pub fn encode_with(&self, points: &[Point], options: &EncodeOptions, control: &Control) -> Result<Field> {
        Field::new(self.network.clone(), points, options, control)
    }

    /// Keypoints of a cloud `(N, 3)` in one call: [`Model::encode`], then [`Field::detect`].
    ///
    /// ```
    /// use snake_core::{Builtin, Model, Options};
    /// # let points: Vec<[f32; 3]> = (0..500).map(|i| { let a = i as f32 * 0.1; [a.cos(), a.sin(), (a * 0.3).sin()] }).collect();
    /// let model = Model::builtin(Builtin::Compact);
    /// let detection = model.detect(&points, model.recommended())?;
    /// for keypoint in &detection.keypoints {
    ///     println!("{:?} {:.3}", keypoint.position, keypoint.saliency);
    /// }
    /// # Ok::<(), snake_core::Error>(())
    /// ```
    ///
    /// # Errors
    /// The errors of [`Model::encode`] and [`Field::detect`].
    pub fn detect(&self, points: &[Point], options: &Options) -> Result<Detection> {
        self.detect_with(points, options, &Control::default())
    }

    /// [`Model::detect`] with progress, cancellation and limits.
    ///
    /// # Errors
    /// The errors of [`Model::detect`]; [`Error::Cancelled`], [`Error::DeadlineExceeded`] and [`Error::LimitExceeded`].
    pub fn detect_with(&self, points: &[Point], options: &Options, control: &Control) -> Result<Detection> {
        self.network.check(options)?;
        control.get_limits().check_evaluations(&options.detect.evaluations(options.encode.rotations))?;
        let start = Instant::now();
        let field = self.encode_with(points, &options.encode, control)?;
        let encode = start.elapsed().as_secs_f64();
        let mut detection = field.detect_with(&options.detect, control)?;
        detection.timing.encode = encode;
        Ok(detection)
    }

    pub(crate) fn network(&self) -> &Arc<Network> {
        &self.network
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_embedded_model_loads_with_its_recommended_options() {
        let [compact, standard, scenes] = Model::NAMES.map(|name| Model::named(name).unwrap());
        assert_eq!(compact.metadata(), standard.metadata());
        assert_eq!(*standard.recommended(), Preset::Standard.options());
        assert_eq!((compact.recommended().encode.rotations, standard.recommended().encode.rotations), (1, 4));
        assert!(scenes.config().frame().is_none());
        assert_eq!(Builtin::Compact.recommended(), *compact.recommended());
        assert_eq!(Builtin::Scenes.recommended(), *scenes.recommended());
        assert_eq!(Model::builtin(Builtin::Scenes).metadata(), scenes.metadata());
        assert_eq!(Model::builtin(Builtin::default()).metadata(), compact.metadata());
        assert!(Model::named("large").is_err());
    }
}

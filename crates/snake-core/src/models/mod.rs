//! A network: its configuration and weights.

#[cfg(feature = "builtin-models")]
mod builtin;
mod scale_hint;
mod signs;

#[cfg(feature = "builtin-models")]
pub use self::builtin::Builtin;
pub use self::scale_hint::scale_hint;
pub use self::signs::scene_signs;

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

#[cfg(doc)]
use crate::Error;
use crate::Result;
use crate::call::clock::Instant;
use crate::call::control::Control;
use crate::detect::Detection;
use crate::detect::options::{EncodeOptions, Options};
use crate::field::Field;
use crate::network::Network;
use crate::network::config::ModelConfig;
use crate::network::weights::read_weight_file;
use snake_geometry::Point;

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

impl Model {
    /// Reads a weight file (safetensors; float32 or float16).
    ///
    /// # Errors
    /// [`Error::Io`] when the file cannot be read; [`Error::Weights`] as for [`Model::from_bytes`].
    pub fn load(path: impl AsRef<Path>) -> Result<Self> {
        Self::from_bytes(&read_weight_file(path.as_ref())?)
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
        options.check(&self.network.config)?;
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
        let field = Field::new(self.network.clone(), points, &options.encode, control)?;
        let encode = start.elapsed().as_secs_f64();
        let mut detection = field.detect_in(&options.detect, Vec::new(), control)?;
        detection.timing.encode = encode;
        Ok(detection)
    }

    pub(crate) fn network(&self) -> &Arc<Network> {
        &self.network
    }
}

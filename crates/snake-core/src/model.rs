//! A model: a network with its weights.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

#[cfg(doc)]
use crate::Error;
use crate::Result;
use crate::cloud::UsedCloud;
use crate::control::Control;
use crate::control::clock::Instant;
use crate::detect::{Detection, TileDetector};
use crate::field::{Field, FieldMemory};
use crate::network::{ModelConfig, Network, read_weight_file};
use crate::options::{EncodeOptions, Options};
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

    /// The BLAKE3 digest of the weight file.
    pub fn digest(&self) -> &str {
        &self.network.digest
    }

    /// Number of weights.
    pub fn num_parameters(&self) -> usize {
        self.network.num_parameters
    }

    /// The options recommended for these weights: the metadata key `recommended_options`, or the defaults without it.
    pub fn recommended(&self) -> &Options {
        &self.network.recommended
    }

    /// Encodes a cloud `(N, 3)` once. The field then answers any number of queries.
    ///
    /// # Errors
    /// [`Error::Input`] for a cloud without finite points or with an extent outside 1e-15 to 1e15;
    /// [`Error::Weights`] when the weights are so large that the features overflow.
    pub fn encode(&self, points: &[Point], options: &EncodeOptions) -> Result<Field> {
        self.encode_with(points, options, &Control::default())
    }

    /// [`Model::encode`] with progress, cancellation and a deadline.
    ///
    /// # Errors
    /// The errors of [`Model::encode`]; [`Error::Cancelled`] and [`Error::DeadlineExceeded`].
    pub fn encode_with(&self, points: &[Point], options: &EncodeOptions, control: &Control) -> Result<Field> {
        self.network.check_encode(options)?;
        self.field(UsedCloud::new(points)?, options, control)
    }

    /// [`Model::encode_with`] for a cloud whose used points have been determined already.
    ///
    /// # Errors
    /// The errors of [`Model::encode_with`].
    pub fn encode_cloud(&self, cloud: &UsedCloud, options: &EncodeOptions, control: &Control) -> Result<Field> {
        self.network.check_encode(options)?;
        self.field(cloud.clone(), options, control)
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

    /// [`Model::detect`] with progress, cancellation and a deadline.
    ///
    /// # Errors
    /// The errors of [`Model::detect`]; [`Error::Cancelled`] and [`Error::DeadlineExceeded`].
    pub fn detect_with(&self, points: &[Point], options: &Options, control: &Control) -> Result<Detection> {
        self.network.check(options)?;
        self.detect_used(UsedCloud::new(points)?, options, control)
    }

    /// [`Model::detect_with`] for a cloud whose used points have been determined already.
    ///
    /// # Errors
    /// The errors of [`Model::detect_with`].
    pub fn detect_cloud(&self, cloud: &UsedCloud, options: &Options, control: &Control) -> Result<Detection> {
        self.network.check(options)?;
        self.detect_used(cloud.clone(), options, control)
    }

    /// The keypoints of a cloud. The options must be valid.
    fn detect_used(&self, cloud: UsedCloud, options: &Options, control: &Control) -> Result<Detection> {
        let start = Instant::now();
        let field = self.field(cloud, &options.encode, control)?;
        let encode = start.elapsed().as_secs_f64();
        let mut detection = field.detect_in(&options.detect, control)?;
        detection.timing.encode = encode;
        Ok(detection)
    }

    fn field(&self, cloud: UsedCloud, options: &EncodeOptions, control: &Control) -> Result<Field> {
        Field::new(self.network.clone(), cloud, options, &mut FieldMemory::default(), control)
    }

    #[cfg(feature = "builtin-models")]
    pub(crate) fn from_network(network: Network) -> Self {
        Self { network: Arc::new(network) }
    }

    pub(crate) fn network(&self) -> &Arc<Network> {
        &self.network
    }
}

impl TileDetector {
    /// A tile detector. Without a voxel size, call [`TileDetector::choose_voxel_size`] before [`TileDetector::place`].
    ///
    /// # Errors
    /// [`Error::Option`] when the model is not a scene model, or when an option is out of its range or needs the whole cloud: a
    /// length in `%`, a voxel size in `r`, `max_points`, `refine_steps`, `snap` or `prefer` corners.
    pub fn new(model: &Model, options: &Options) -> Result<Self> {
        Self::for_network(model.network.clone(), options)
    }
}

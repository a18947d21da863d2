//! A network: its configuration and weights.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use crate::decoder::Decoder;
use crate::detect::{Detection, Preset, detect};
use crate::encoder::Encoder;
use crate::field::{EncodeOptions, Field};
use crate::points::Point;
use crate::progress::Progress;
use crate::volume::VolumeFrame;
use crate::weights::{self, Weights};
use crate::windows::detect_in_windows;
use crate::{Error, Result, budget};

const COMPACT: &[u8] = include_bytes!("../models/compact.safetensors");
const STANDARD: &[u8] = include_bytes!("../models/standard.safetensors");
const ROOMS: &[u8] = include_bytes!("../models/rooms.safetensors");

/// The shape of a network, read from the weight file's metadata.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ModelConfig {
    /// Resolution and bounds of the feature volume.
    pub frame: VolumeFrame,
    /// Channels of the volume.
    pub c_dim: usize,
    /// Width of the point encoder.
    pub hidden_dim: usize,
    /// Width of the decoders.
    pub decoder_hidden_dim: usize,
    /// Residual blocks in the point encoder and in each decoder.
    pub resnet_blocks: usize,
    /// Levels of the U-Net.
    pub unet_levels: usize,
    /// Channels of its first level; each level below doubles them.
    pub unet_base_channels: usize,
    /// Groups of its normalisations (1 where a layer has fewer channels).
    pub group_norm_groups: usize,
}

impl ModelConfig {
    fn from_weights(file: &Weights) -> Result<Self> {
        let whole = |key: &str, most: usize| match file.number::<usize>(key)? {
            value if (1..=most).contains(&value) => Ok(value),
            value => Err(weights::error(key, &format!("1 to {most}"), value.to_string())),
        };
        let text = file.text("resolution")?;
        let sizes = text.trim_matches(['[', ']']).split(',').map(|v| v.trim().parse::<usize>().ok());
        let resolution: Option<Vec<usize>> = sizes.collect();
        let [x, y, z] = resolution.as_deref().unwrap_or_default() else {
            return Err(weights::error("resolution", "[x, y, z]", text.into()));
        };
        let config = Self {
            frame: VolumeFrame {
                resolution: [*x, *y, *z],
                padding: file.number("padding")?,
                z_bounds: [file.number("z_min")?, file.number("z_max")?],
            },
            c_dim: whole("c_dim", 1024)?,
            hidden_dim: whole("hidden_dim", 1024)?,
            decoder_hidden_dim: whole("decoder_hidden_dim", 1024)?,
            resnet_blocks: whole("resnet_blocks", 64)?,
            unet_levels: whole("unet_levels", 8)?,
            unet_base_channels: whole("unet_base_channels", 1024)?,
            group_norm_groups: whole("group_norm_groups", 1024)?,
        };
        let smallest = 2.max(1 << (config.unet_levels - 1));
        let VolumeFrame { resolution, padding, z_bounds: [z_min, z_max] } = config.frame;
        if resolution.iter().any(|size| !(smallest..=512).contains(size)) {
            return Err(weights::error(
                "resolution",
                &format!("{smallest} to 512 voxels along each axis"),
                text.into(),
            ));
        }
        budget::check_volume(&config)?;
        let z_extent = z_max - z_min;
        if !((0.0..=10.0).contains(&padding) && z_extent > 0.0 && z_extent < 1e3) {
            let found = format!("padding {padding}, z from {z_min} to {z_max}");
            return Err(weights::error("padding", "0 to 10, and z_min below z_max", found));
        }
        Ok(config)
    }
}

/// Encoder and decoders.
#[derive(Debug)]
pub(crate) struct Network {
    config: ModelConfig,
    metadata: BTreeMap<String, String>,
    recommended: Preset,
    num_parameters: usize,
    pub(crate) encoder: Encoder,
    pub(crate) occupancy: Decoder,
    pub(crate) saliency: Decoder,
}

/// A network with its weights; cloning it is cheap.
///
/// ```
/// let model = snake_core::Model::builtin()?;
/// assert_eq!(model.config().frame.resolution, [32, 32, 32]);
/// # Ok::<(), snake_core::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Model {
    network: Arc<Network>,
    progress: Option<Progress>,
}

impl Model {
    /// The names that [`Model::named`] knows: the models that come with the crate (see `models/README.md`).
    pub const NAMES: [&'static str; 3] = ["compact", "standard", "rooms"];

    /// A model that comes with the crate: `compact`, for objects; `standard`, for objects too, whose keypoints repeat better
    /// and take longer; or `rooms`, for clouds of rooms in metres, which it recommends to see through windows.
    ///
    /// # Errors
    /// [`Error::Option`] for an unknown name.
    pub fn named(name: &str) -> Result<Self> {
        match name {
            "compact" => Self::from_bytes(COMPACT),
            "standard" => Self::from_bytes(STANDARD),
            "rooms" => Self::from_bytes(ROOMS),
            _ => Err(Error::Option { name: "model", value: name.into(), allowed: "compact, standard or rooms" }),
        }
    }

    /// The model `compact`.
    ///
    /// # Errors
    /// None in a released build: the embedded file is checked by the tests.
    pub fn builtin() -> Result<Self> {
        Self::named("compact")
    }

    /// Reads a weight file (safetensors; float32 or float16).
    ///
    /// # Errors
    /// [`Error::Io`] when the file cannot be read; [`Error::Weights`] as for [`Model::from_bytes`].
    pub fn load(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let bytes = std::fs::read(path).map_err(|source| Error::Io { path: path.into(), source })?;
        Self::from_bytes(&bytes)
    }

    /// A network from the bytes of a weight file.
    ///
    /// # Errors
    /// [`Error::Weights`] when a tensor or a metadata key is missing, unknown, of another shape or type, or not finite.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self> {
        let file = Weights::open(bytes)?;
        let config = ModelConfig::from_weights(&file)?;
        let network = Network {
            config,
            metadata: file.metadata.clone().into_iter().collect(),
            recommended: match file.metadata.get("recommended_options") {
                Some(json) => serde_json::from_str(json)
                    .map_err(|e| weights::error("recommended_options", "options of snake-rs as JSON", e.to_string()))?,
                None => Preset::default(),
            },
            encoder: Encoder::load(&file.at("encoder"), &config)?,
            occupancy: Decoder::occupancy(&file.at("decoder_occup"), &config)?,
            saliency: Decoder::saliency(&file.at("decoder_keypoint"), &config)?,
            num_parameters: file.num_parameters(),
        };
        network.recommended.check(&config)?;
        file.finish()?;
        Ok(Self { network: Arc::new(network), progress: None })
    }

    /// The same model, and its fields, with a place where long calls say how far they are.
    pub fn with_progress(self, progress: &Progress) -> Self {
        Self { progress: Some(progress.clone()), ..self }
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

    /// The options that suit these weights: from the metadata key `recommended_options`, else the defaults.
    pub fn recommended(&self) -> &Preset {
        &self.network.recommended
    }

    /// Encodes a cloud once; the field then answers any number of queries.
    ///
    /// # Errors
    /// [`Error::Input`] for a cloud without finite points or of an extent outside 1e-15 to 1e15;
    /// [`Error::Weights`] when the weights are so large that the features overflow.
    pub fn encode(&self, points: &[Point], options: &EncodeOptions) -> Result<Field> {
        Field::new(self.clone(), points, options)
    }

    /// Keypoints of a cloud in one call: [`Model::encode`], then [`detect`]; or in windows, if the options say so.
    ///
    /// ```
    /// use snake_core::{Model, Preset};
    /// # let points: Vec<[f32; 3]> = (0..500).map(|i| { let a = i as f32 * 0.1; [a.cos(), a.sin(), (a * 0.3).sin()] }).collect();
    /// let model = Model::builtin()?;
    /// let detection = model.detect(&points, model.recommended())?;
    /// for keypoint in &detection.keypoints {
    ///     println!("{:?} {:.3}", keypoint.position, keypoint.saliency);
    /// }
    /// # Ok::<(), snake_core::Error>(())
    /// ```
    ///
    /// # Errors
    /// Those of [`Model::encode`] and [`detect`].
    pub fn detect(&self, points: &[Point], options: &Preset) -> Result<Detection> {
        options.check(self.config())?;
        if let Some(radius) = options.windows.window_radius {
            return detect_in_windows(self, points, radius, options);
        }
        let start = Instant::now();
        let field = self.encode(points, &options.encode)?;
        let encode = start.elapsed().as_secs_f64();
        let mut detection = detect(&field, &options.detect)?;
        detection.timing.encode = encode;
        Ok(detection)
    }

    /// The same model for calls within a call that counts them.
    pub(crate) fn without_progress(&self) -> Self {
        Self { network: self.network.clone(), progress: None }
    }

    pub(crate) fn progress(&self) -> Option<&Progress> {
        self.progress.as_ref()
    }

    pub(crate) fn network(&self) -> &Network {
        &self.network
    }
}

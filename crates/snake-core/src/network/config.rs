//! The configuration of a network.

use crate::Result;
use crate::lattice::{VolumeFrame, VolumeShape};
use crate::network::weights::{self, Weights};

/// How the encoder scatters the features of points to voxels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Scatter {
    /// A voxel has the mean feature of its points, as in the authors' network.
    #[default]
    Hard,
    /// A feature is added to the eight nearest voxels with trilinear weights. A voxel's sum is divided by its total weight,
    /// but at least by a limit: the mean total weight of the cloud's voxels, or the `scatter_mass` of a scene model.
    Soft,
}

impl Scatter {
    /// The name in a weight file's metadata: `hard` or `soft`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Hard => "hard",
            Self::Soft => "soft",
        }
    }
}

/// The configuration of a network, from the weight file's metadata.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ModelConfig {
    /// Extent of the feature volume.
    pub volume: VolumeShape,
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
    /// Channels of the first level; each coarser level doubles them.
    pub unet_base_channels: usize,
    /// Groups of each group normalisation; 1 for layers with fewer channels, 0 for a scene model, which has none.
    pub group_norm_groups: usize,
    /// How features are scattered to voxels; hard if the file does not say.
    pub scatter: Scatter,
}

impl ModelConfig {
    /// The frame of the feature volume; `None` for a scene model, whose volume follows the cloud.
    pub fn frame(&self) -> Option<VolumeFrame> {
        self.volume.frame()
    }

    pub(crate) fn from_weights(file: &Weights) -> Result<Self> {
        let whole = |key: &str, most: usize| match file.number::<usize>(key)? {
            value if (1..=most).contains(&value) => Ok(value),
            value => Err(weights::error(key, &format!("1 to {most}"), value.to_string())),
        };
        let volume = match file.metadata.get("coordinates").map(String::as_str) {
            None | Some("cloud") => VolumeShape::Cube(cube_frame(file)?),
            Some("voxel") => VolumeShape::Scene { scatter_mass: file.number("scatter_mass")? },
            Some(other) => return Err(weights::error("coordinates", "cloud or voxel", other.into())),
        };
        if let Some(other) = file.metadata.get("point_encoder").filter(|name| *name != "pointnet") {
            return Err(weights::error("point_encoder", "pointnet", other.into()));
        }
        let config = Self {
            volume,
            c_dim: whole("c_dim", 1024)?,
            hidden_dim: whole("hidden_dim", 1024)?,
            decoder_hidden_dim: whole("decoder_hidden_dim", 1024)?,
            resnet_blocks: whole("resnet_blocks", 64)?,
            unet_levels: whole("unet_levels", 8)?,
            unet_base_channels: whole("unet_base_channels", 1024)?,
            group_norm_groups: match volume {
                VolumeShape::Cube(_) => whole("group_norm_groups", 1024)?,
                VolumeShape::Scene { .. } => 0,
            },
            scatter: match file.metadata.get("scatter").map(String::as_str) {
                None | Some("hard") => Scatter::Hard,
                Some("soft") => Scatter::Soft,
                Some(other) => return Err(weights::error("scatter", "hard or soft", other.into())),
            },
        };
        match volume {
            VolumeShape::Cube(frame) => check_cube(&frame, &config)?,
            VolumeShape::Scene { scatter_mass } => check_scene(scatter_mass, &config)?,
        }
        Ok(config)
    }
}

/// The frame of a volume to which every cloud is scaled.
fn cube_frame(file: &Weights) -> Result<VolumeFrame> {
    let text = file.text("resolution")?;
    let sizes = text.trim_matches(['[', ']']).split(',').map(|v| v.trim().parse::<usize>().ok());
    let resolution: Option<Vec<usize>> = sizes.collect();
    let [x, y, z] = resolution.as_deref().unwrap_or_default() else {
        return Err(weights::error("resolution", "[x, y, z]", text.into()));
    };
    Ok(VolumeFrame {
        resolution: [*x, *y, *z],
        padding: file.number("padding")?,
        z_bounds: [file.number("z_min")?, file.number("z_max")?],
    })
}

fn check_cube(frame: &VolumeFrame, config: &ModelConfig) -> Result<()> {
    let smallest = 2.max(1 << (config.unet_levels - 1));
    let &VolumeFrame { resolution, padding, z_bounds: [z_min, z_max] } = frame;
    if resolution.iter().any(|size| !(smallest..=512).contains(size)) {
        let expected = format!("{smallest} to 512 voxels along each axis");
        return Err(weights::error("resolution", &expected, format!("{resolution:?}")));
    }
    let z_extent = z_max - z_min;
    if !((0.0..=10.0).contains(&padding) && z_extent > 0.0 && z_extent < 1e3) {
        let actual = format!("padding {padding}, z from {z_min} to {z_max}");
        return Err(weights::error("padding", "0 to 10, and z_min below z_max", actual));
    }
    Ok(())
}

fn check_scene(scatter_mass: f32, config: &ModelConfig) -> Result<()> {
    if !(scatter_mass > 0.0 && scatter_mass < 1e6) {
        return Err(weights::error("scatter_mass", "a positive number below 1e6", scatter_mass.to_string()));
    }
    if config.scatter != Scatter::Soft {
        return Err(weights::error("coordinates", "with voxel: scatter soft", config.scatter.name().into()));
    }
    Ok(())
}

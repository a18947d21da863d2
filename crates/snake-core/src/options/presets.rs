//! Named sets of options: those of the paper.

use super::{DetectOptions, EncodeOptions, Options};
use crate::{Error, Result};
use snake_geometry::{Length, NormalizationMethod};

/// A named set of options.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Preset {
    /// The paper's settings for ModelNet40.
    ModelNet40,
    /// The paper's settings for KeypointNet.
    KeypointNet,
    /// The paper's settings for SMPL.
    Smpl,
    /// The paper's settings for Redwood.
    Redwood,
    /// The paper's settings for 3DMatch.
    ThreeDMatch,
}

impl Preset {
    /// All presets, as the paper's table of hyper-parameters has them.
    pub const ALL: [Self; 5] = [Self::ModelNet40, Self::KeypointNet, Self::Smpl, Self::Redwood, Self::ThreeDMatch];

    /// Its name for [`Preset::named`].
    pub fn name(self) -> &'static str {
        match self {
            Self::ModelNet40 => "modelnet40",
            Self::KeypointNet => "keypointnet",
            Self::Smpl => "smpl",
            Self::Redwood => "redwood",
            Self::ThreeDMatch => "3dmatch",
        }
    }

    /// The preset of that name.
    ///
    /// # Errors
    /// [`Error::Option`] for an unknown name.
    pub fn named(name: &str) -> Result<Self> {
        Self::ALL.into_iter().find(|preset| preset.name() == name).ok_or_else(|| {
            let allowed = "modelnet40, keypointnet, smpl, redwood or 3dmatch";
            Error::Option { name: "preset", value: name.into(), allowed }
        })
    }

    /// Its options, from appendix B of the paper, or from the released code if the paper does not give them.
    pub fn options(self) -> Options {
        let common = DetectOptions::default();
        let radius = |units| Some(Length::Units(units));
        let (normalization, max_points) = match self {
            Self::ModelNet40 => (NormalizationMethod::UnitSphere, Some(5000)),
            Self::KeypointNet | Self::Smpl => (NormalizationMethod::UnitCube, Some(2048)),
            Self::Redwood => (NormalizationMethod::UnitCube, Some(10_240)),
            Self::ThreeDMatch => (NormalizationMethod::UnitCube, None),
        };
        let detect = match self {
            Self::ModelNet40 => common,
            Self::KeypointNet => DetectOptions { nms_radius: radius(0.1), ..common },
            Self::Smpl => DetectOptions { nms_radius: radius(0.1), snap: true, ..common },
            // The step size of the released configuration. That of the paper, 1e-3, gives different keypoints.
            Self::Redwood => DetectOptions {
                query_resolution: 100,
                refine_step_size: 1e-4,
                nms_radius: radius(0.04),
                max_keypoints: 512,
                ..common
            },
            Self::ThreeDMatch => DetectOptions {
                saliency_threshold: 0.4,
                nms_radius: radius(0.04),
                max_keypoints: 2500,
                snap: true,
                ..common
            },
        };
        let encode = EncodeOptions { normalization, max_points, ..Default::default() };
        Options { encode, detect }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn presets_have_the_step_sizes_of_the_released_configurations() {
        for preset in Preset::ALL {
            let expected = if preset == Preset::Redwood { 1e-4 } else { 1e-3 };
            assert_eq!(preset.options().detect.refine_step_size, expected, "{}", preset.name());
        }
    }
}

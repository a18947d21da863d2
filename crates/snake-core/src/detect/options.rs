//! Options of encoding, detection and meshes, with their ranges.

use serde::{Deserialize, Serialize};
use snake_kernels::Scratch;

use crate::network::budget;
use crate::network::config::ModelConfig;
use crate::{Error, Result, setters};
use snake_geometry::{Length, NormalizationMethod, Point, sample};

/// Options of [`Model::encode`](crate::Model::encode).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct EncodeOptions {
    /// How the cloud is mapped into the network's frame, from the statistics of all its points.
    pub normalization: NormalizationMethod,
    /// Maximum number of finite points to encode, drawn at random without replacement. `None`: all of them.
    pub max_points: Option<usize>,
    /// Seed of the draw.
    pub seed: u64,
    /// Number of rotated copies of the cloud to encode, 1 to 64; their fields are averaged as log-odds. The network is
    /// only roughly equivariant, and its errors in the copies are nearly independent. Keypoints therefore repeat far
    /// better, and the cost grows with the number of copies. Above 1 only with [`NormalizationMethod::UnitSphere`] or
    /// [`NormalizationMethod::PrincipalAxes`], because a rotated cube leaves the volume.
    pub rotations: usize,
    /// Size of a voxel, for scene models, which use no normalisation. `None`: it is chosen from the cloud.
    pub voxel_size: Option<Length>,
}

setters!(EncodeOptions {
    normalization: NormalizationMethod => with_normalization,
    max_points: Option<usize> => with_max_points,
    seed: u64 => with_seed,
    rotations: usize => with_rotations,
    voxel_size: Option<Length> => with_voxel_size,
});

impl Default for EncodeOptions {
    fn default() -> Self {
        Self {
            normalization: NormalizationMethod::UnitSphere,
            max_points: None,
            seed: 0,
            rotations: 1,
            voxel_size: None,
        }
    }
}

impl EncodeOptions {
    /// Checks the ranges, and the memory of the feature volumes of a network.
    pub(crate) fn check(&self, config: &ModelConfig) -> Result<()> {
        let inside = self.rotations == 1 || self.normalization.allows_rotations();
        if !(1..=64).contains(&self.rotations) || !inside {
            let allowed = "1 to 64, above 1 only with unit-sphere or principal-axes normalization";
            return Err(Error::Option { name: "rotations", value: self.rotations.to_string(), allowed });
        }
        if self.max_points == Some(0) {
            return Err(Error::Option { name: "max_points", value: "0".into(), allowed: "1 or more" });
        }
        if config.frame().is_none() && self.rotations > 1 {
            let allowed = "1 for a scene model";
            return Err(Error::Option { name: "rotations", value: self.rotations.to_string(), allowed });
        }
        match self.voxel_size {
            Some(size) if config.frame().is_some() => {
                let allowed = "none with this model, whose volume is scaled to the cloud; use a scene model";
                Err(Error::Option { name: "voxel_size", value: size.to_string(), allowed })
            }
            Some(size) if matches!(size, Length::Voxels(_)) => {
                let allowed = "a length in cloud units, or as in `3r` resolutions";
                Err(Error::Option { name: "voxel_size", value: size.to_string(), allowed })
            }
            _ => budget::check_rotations(self.rotations, config),
        }
    }

    /// The points that are encoded if they are not all: `max_points` of them.
    pub(crate) fn sample(&self, points: &[Point]) -> Option<Scratch<Point>> {
        let number = self.max_points.filter(|&most| most < points.len())?;
        Some(sample(points, number, self.seed))
    }
}

/// The method that moves queries up the saliency field.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum RefineMethod {
    /// Adam on one minus the mean saliency of all queries, as in the released code. Because of its ε, steps where the
    /// saliency is nearly constant depend slightly on the number of queries.
    #[default]
    Adam,
    /// Algorithm 1 as printed, with each query's own gradient; the gradient of the mean would be far too small.
    GradientDescent,
}

/// The position and score of a refined query. A score is the saliency where the occupancy is above the surface
/// threshold, else 0.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Selection {
    /// The best score of the trajectory, from the start to the position after the last step, and its position.
    #[default]
    BestPosition,
    /// As in the released code: the position after the last step, with the best score before each of the steps.
    ReferenceFinalPosition,
}

/// Options of [`Field::detect`](crate::Field::detect); the defaults are the paper's for ModelNet40.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct DetectOptions {
    /// Queries along each axis of the query grid over the network's cube ±0.5: 1 to 256. The number of queries times
    /// `refine_steps + 1` times [`EncodeOptions::rotations`] is at most 2^28.
    pub query_resolution: usize,
    /// Maximum distance of a query from a voxel with input points, in voxels along each axis. Farther queries are dropped
    /// without evaluation: there are many of them, and hardly ever a surface. 0: all queries are evaluated.
    pub query_band: usize,
    /// Queries are refined if their occupancy is above this (1 − thr_o).
    pub occupancy_threshold: f32,
    /// Refinement steps (J).
    pub refine_steps: usize,
    /// Step size (λ), in network units.
    pub refine_step_size: f32,
    /// The method that moves queries up the saliency field.
    pub refine_method: RefineMethod,
    /// The position and score of a refined query.
    pub selection: Selection,
    /// A position lies on the surface if its occupancy is above this. The default is the released code's.
    pub surface_threshold: f32,
    /// Keypoints have a score above this (thr_s).
    pub saliency_threshold: f32,
    /// Least [`Keypoint::confidence`](crate::Keypoint::confidence) of a keypoint, 0 to 1; `None`: no limit. It needs a model whose file
    /// has a map of confidences.
    pub min_confidence: Option<f32>,
    /// Radius of mode seeking: before suppression, three steps of mean shift move keypoints to the weighted mean of the
    /// candidates within this radius, then 0.85 and 0.7 of it, which is more precise than the best single query. `None` or 0:
    /// off, as in the paper.
    #[serde(deserialize_with = "none_if_zero")]
    pub mode_radius: Option<Length>,
    /// Minimum distance of keypoints. `None`: no suppression. In JSON 0 is also `None`.
    #[serde(deserialize_with = "none_if_zero")]
    pub nms_radius: Option<Length>,
    /// Maximum number of keypoints; the best are kept. In JSON null is no limit.
    #[serde(deserialize_with = "most_if_null")]
    pub max_keypoints: usize,
    /// Move each keypoint to its nearest input point. Several keypoints can then coincide, as in the paper.
    pub snap: bool,
}

setters!(DetectOptions {
    query_resolution: usize => with_query_resolution,
    query_band: usize => with_query_band,
    occupancy_threshold: f32 => with_occupancy_threshold,
    refine_steps: usize => with_refine_steps,
    refine_step_size: f32 => with_refine_step_size,
    refine_method: RefineMethod => with_refine_method,
    selection: Selection => with_selection,
    surface_threshold: f32 => with_surface_threshold,
    saliency_threshold: f32 => with_saliency_threshold,
    min_confidence: Option<f32> => with_min_confidence,
    mode_radius: Option<Length> => with_mode_radius,
    nms_radius: Option<Length> => with_nms_radius,
    max_keypoints: usize => with_max_keypoints,
    snap: bool => with_snap,
});

impl Default for DetectOptions {
    fn default() -> Self {
        Self {
            query_resolution: 64,
            query_band: 0,
            occupancy_threshold: 0.5,
            refine_steps: 10,
            refine_step_size: 1e-3,
            refine_method: RefineMethod::Adam,
            selection: Selection::BestPosition,
            surface_threshold: 0.8,
            saliency_threshold: 0.7,
            min_confidence: None,
            mode_radius: None,
            nms_radius: Some(Length::Units(0.01)),
            max_keypoints: 64,
            snap: false,
        }
    }
}

impl DetectOptions {
    /// Checks the ranges, and the number of evaluations of a field with these rotations.
    pub(crate) fn check(&self, rotations: usize) -> Result<()> {
        let within = |name, value: f32, range: std::ops::RangeInclusive<f32>, allowed| {
            if range.contains(&value) { Ok(()) } else { Err(Error::Option { name, value: value.to_string(), allowed }) }
        };
        within("query_resolution", self.query_resolution as f32, 1.0..=256.0, "1 to 256")?;
        within("query_band", self.query_band as f32, 0.0..=1024.0, "0 to 1024 (voxels)")?;
        within("refine_steps", self.refine_steps as f32, 0.0..=10_000.0, "0 to 10000")?;
        within("refine_step_size", self.refine_step_size, 0.0..=1.0, "0 to 1 (network units)")?;
        within("occupancy_threshold", self.occupancy_threshold, 0.0..=1.0, "0 to 1")?;
        within("surface_threshold", self.surface_threshold, 0.0..=1.0, "0 to 1")?;
        within("saliency_threshold", self.saliency_threshold, 0.0..=1.0, "0 to 1")?;
        within("min_confidence", self.min_confidence.unwrap_or(0.0), 0.0..=1.0, "0 to 1")?;
        for (name, length) in [("nms_radius", self.nms_radius), ("mode_radius", self.mode_radius)] {
            let Some(length) = length else { continue };
            let value = length.number();
            if !(value >= 0.0 && value as f32 <= f32::MAX) {
                let allowed = "0 or more (cloud units, or as in `3r` resolutions)";
                return Err(Error::Option { name, value: length.to_string(), allowed });
            }
        }
        budget::check_queries(self.query_resolution, self.refine_steps, rotations)
    }

    /// The factors of the number of evaluations of the decoders, at most, for a field of so many rotations.
    pub(crate) fn evaluations(&self, rotations: usize) -> [usize; 5] {
        let Self { query_resolution: queries, refine_steps, .. } = *self;
        [queries, queries, queries, refine_steps.saturating_add(1), rotations]
    }

    /// The radii of suppression and of mode seeking in cloud units, of a cloud in voxels of this size.
    pub(crate) fn radii(&self, points: &[Point], voxel_size: f32) -> Result<Radii> {
        let units = |name, length: Length| match length {
            Length::Units(radius) => Ok(radius as f32),
            Length::Voxels(number) => Ok(number as f32 * voxel_size),
            multiple => multiple.in_units(name, points).map(|radius| radius as f32),
        };
        Ok(Radii {
            nms: self.nms_radius.map_or(Ok(0.0), |length| units("nms_radius", length))?,
            mode: self
                .mode_radius
                .map(|length| units("mode_radius", length))
                .transpose()?
                .filter(|radius| *radius > 0.0),
        })
    }
}

/// Lengths of [`DetectOptions`] in cloud units.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Radii {
    /// 0 for no suppression.
    pub(crate) nms: f32,
    pub(crate) mode: Option<f32>,
}

/// A length, or `None` for 0 and null.
fn none_if_zero<'de, D: serde::Deserializer<'de>>(deserializer: D) -> std::result::Result<Option<Length>, D::Error> {
    let length = Option::<Length>::deserialize(deserializer)?;
    Ok(length.filter(|length| *length != Length::Units(0.0)))
}

/// A number, or the largest for null.
fn most_if_null<'de, D: serde::Deserializer<'de>>(deserializer: D) -> std::result::Result<usize, D::Error> {
    Ok(Option::<usize>::deserialize(deserializer)?.unwrap_or(usize::MAX))
}

/// All options of [`Model::detect`](crate::Model::detect).
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct Options {
    /// Options of encoding.
    pub encode: EncodeOptions,
    /// Options of detection.
    pub detect: DetectOptions,
}

setters!(Options {
    encode: EncodeOptions => with_encode,
    detect: DetectOptions => with_detect,
});

impl Options {
    /// Refuses options out of their ranges, and options that need too much memory or time with this network.
    pub(crate) fn check(&self, config: &ModelConfig) -> Result<()> {
        self.encode.check(config)?;
        self.detect.check(self.encode.rotations)
    }
}

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
    /// For [`Builtin::Compact`](crate::Builtin::Compact): four rotated copies. Keypoints repeat better, and detection
    /// takes three times as long.
    Standard,
}

impl Preset {
    /// All presets, those of the paper's table of hyper-parameters first.
    pub const ALL: [Self; 6] =
        [Self::ModelNet40, Self::KeypointNet, Self::Smpl, Self::Redwood, Self::ThreeDMatch, Self::Standard];

    /// Its name for [`Preset::named`].
    pub fn name(self) -> &'static str {
        match self {
            Self::ModelNet40 => "modelnet40",
            Self::KeypointNet => "keypointnet",
            Self::Smpl => "smpl",
            Self::Redwood => "redwood",
            Self::ThreeDMatch => "3dmatch",
            Self::Standard => "standard",
        }
    }

    /// The preset of that name.
    ///
    /// # Errors
    /// [`Error::Option`] for an unknown name.
    pub fn named(name: &str) -> Result<Self> {
        Self::ALL.into_iter().find(|preset| preset.name() == name).ok_or_else(|| {
            let allowed = "modelnet40, keypointnet, smpl, redwood, 3dmatch or standard";
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
            Self::Standard => (NormalizationMethod::PrincipalAxes, None),
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
            Self::Standard => DetectOptions {
                query_band: 1,
                refine_steps: 0,
                saliency_threshold: 0.07,
                mode_radius: Some(Length::Percent(6.0)),
                nms_radius: Some(Length::Percent(10.0)),
                ..common
            },
        };
        let rotations = if self == Self::Standard { 4 } else { 1 };
        let encode = EncodeOptions { normalization, max_points, rotations, ..Default::default() };
        Options { encode, detect }
    }
}

/// Options of [`Field::mesh`](crate::Field::mesh).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct MeshOptions {
    /// Samples of the occupancy along each axis of the feature volume, ends included: 8 to 512.
    pub resolution: usize,
    /// Occupancy at the surface: 0.001 to 0.999. The default is the released code's.
    pub level: f32,
    /// Keep only surfaces that can be reached from outside. SNAKE reconstructs thin shells with an outer and an inner
    /// surface; this removes the inner one unless the shell has a hole.
    pub outer: bool,
}

setters!(MeshOptions {
    resolution: usize => with_resolution,
    level: f32 => with_level,
    outer: bool => with_outer,
});

impl Default for MeshOptions {
    fn default() -> Self {
        Self { resolution: 128, level: 0.4, outer: false }
    }
}

impl MeshOptions {
    /// Refuses options that [`Field::mesh`](crate::Field::mesh) would refuse, before any work is done.
    ///
    /// # Errors
    /// [`Error::Option`] when an option is out of its range.
    pub fn check(&self) -> Result<()> {
        if !(8..=512).contains(&self.resolution) {
            let value = self.resolution.to_string();
            return Err(Error::Option { name: "resolution", value, allowed: "8 to 512 (samples along each axis)" });
        }
        if !(0.001..=0.999).contains(&self.level) {
            let value = self.level.to_string();
            return Err(Error::Option { name: "level", value, allowed: "0.001 to 0.999 (a probability)" });
        }
        Ok(())
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

    #[test]
    fn a_mode_radius_is_a_length_and_0_is_off() {
        let with = |mode_radius| DetectOptions { mode_radius, ..Default::default() }.check(1);
        for right in [None, Some(Length::Units(0.06)), Some(Length::Resolutions(2.0)), Some(Length::Percent(8.0))] {
            assert!(with(right).is_ok(), "{right:?}");
        }
        for wrong in [-1.0, f64::NAN, 1e60] {
            assert!(with(Some(Length::Units(wrong))).unwrap_err().to_string().contains("mode_radius"), "{wrong}");
        }
        let off = DetectOptions { mode_radius: Some(Length::Units(0.0)), ..Default::default() };
        assert!(off.check(1).is_ok() && off.radii(&[], 1.0).unwrap().mode.is_none());
    }

    #[test]
    fn a_radius_of_0_is_none() {
        let read = |json: &str| serde_json::from_str::<Options>(json).unwrap();
        for off in ["0", "0.0", "null"] {
            assert_eq!(read(&format!("{{\"detect\":{{\"nms_radius\":{off}}}}}")).detect.nms_radius, None, "{off}");
            assert_eq!(read(&format!("{{\"detect\":{{\"mode_radius\":{off}}}}}")).detect.mode_radius, None, "{off}");
        }
        assert_eq!(read(r#"{"detect":{"nms_radius":"3r"}}"#).detect.nms_radius, Some(Length::Resolutions(3.0)));
        assert!(serde_json::from_str::<Options>(r#"{"window":{}}"#).is_err());
    }

    #[test]
    fn options_are_read_as_they_are_written() {
        for preset in Preset::ALL {
            let options = preset.options();
            assert_eq!(Preset::named(preset.name()).unwrap(), preset);
            assert_eq!(serde_json::from_str::<Options>(&serde_json::to_string(&options).unwrap()).unwrap(), options);
        }
        let mut options = Options::default();
        options.detect.mode_radius = Some(Length::Resolutions(40.0));
        options.detect.nms_radius = None;
        assert_eq!(serde_json::from_str::<Options>(&serde_json::to_string(&options).unwrap()).unwrap(), options);
        let error = Preset::named("scannet").unwrap_err().to_string();
        assert!(Preset::ALL.iter().all(|preset| error.contains(preset.name())), "{error}");
    }
}

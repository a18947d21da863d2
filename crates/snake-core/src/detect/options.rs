//! Options of encoding, detection and meshes, with their ranges.

use serde::{Deserialize, Serialize};
use snake_kernels::Scratch;

use crate::network::budget;
use crate::network::config::ModelConfig;
use crate::{Error, Result};
use snake_geometry::{Length, NormalizationMethod, OptionGroup, Point, Ranged, options, sample, setters};

options! {
    /// Options of [`Model::encode`](crate::Model::encode).
    pub struct EncodeOptions {
        /// Method that maps the cloud into the network's frame, from the statistics of all its points.
        normalization, with_normalization: NormalizationMethod = NormalizationMethod::UnitSphere;
        /// Largest number of points to encode, drawn at random without replacement from the finite ones.
        max_points, with_max_points: Option<usize> = None, none "all points", from 1 or more;
        /// Seed of the draw of `max_points`.
        seed, with_seed: u64 = 0;
        /// Number of rotated copies of the cloud whose fields are averaged. Keypoints repeat far better, and the time grows
        /// in proportion.
        ///
        /// The mean is that of the log-odds. The network is only roughly equivariant, and its errors in the copies are nearly
        /// independent. A rotated cube leaves the volume.
        rotations, with_rotations: usize = 1,
            from 1 to 64 ", above 1 only with unit-sphere or principal-axes normalization", flag "NUMBER";
        /// Size of a voxel, for scene models: in cloud units, or in multiples of the cloud's resolution (`2r`). Details
        /// smaller than a voxel are not seen.
        #[serde(deserialize_with = "none_if_zero")]
        voxel_size, with_voxel_size: Option<Length> = None, none "chosen from the cloud", flag "LENGTH";
    }
}

impl EncodeOptions {
    /// Checks the ranges, and the memory of the feature volumes of a network.
    pub(crate) fn check(&self, config: &ModelConfig) -> Result<()> {
        self.check_ranges()?;
        if self.rotations > 1 && !self.normalization.allows_rotations() {
            let allowed = Self::range("rotations");
            return Err(Error::Option { name: "rotations", value: self.rotations.to_string(), allowed });
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

options! {
    /// Options of [`Field::detect`](crate::Field::detect); the defaults are the paper's for ModelNet40.
    pub struct DetectOptions {
        /// Number of queries along each axis of the query grid.
        ///
        /// The grid covers the network's cube ±0.5. The number of queries times `refine_steps + 1` times
        /// [`EncodeOptions::rotations`] is at most 2^28.
        query_resolution, with_query_resolution: usize = 64, from 1 to 256;
        /// Largest distance of a query from a voxel with input points, in voxels along each axis; 0: all queries are
        /// evaluated. Farther queries are dropped without evaluation: there are many of them, and hardly ever a surface.
        query_band, with_query_band: usize = 0, from 0 to 1024 " (voxels)";
        /// Occupancy above which a query is refined.
        ///
        /// 1 − thr_o of the paper.
        occupancy_threshold, with_occupancy_threshold: f32 = 0.5, from 0 to 1;
        /// Number of refinement steps.
        ///
        /// J of the paper.
        refine_steps, with_refine_steps: usize = 10, from 0 to 10000;
        /// Step size of refinement.
        ///
        /// λ of the paper.
        refine_step_size, with_refine_step_size: f32 = 1e-3, from 0 to 1 " (network units)";
        /// Method that moves queries up the saliency field.
        refine_method, with_refine_method: RefineMethod = RefineMethod::Adam;
        /// Position and score of a refined query: the best of its trajectory, or those of the released code.
        selection, with_selection: Selection = Selection::BestPosition;
        /// Occupancy above which a position lies on the surface.
        ///
        /// The default is the released code's.
        surface_threshold, with_surface_threshold: f32 = 0.8, from 0 to 1;
        /// Saliency above which a position is a keypoint.
        ///
        /// thr_s of the paper.
        saliency_threshold, with_saliency_threshold: f32 = 0.7, from 0 to 1, flag "SALIENCY";
        /// Least confidence of a keypoint: the probability that another view finds it again, for models whose file has a map
        /// from saliency to it.
        ///
        /// It is [`Keypoint::confidence`](crate::Keypoint::confidence).
        #[serde(deserialize_with = "none_if_zero")]
        min_confidence, with_min_confidence: Option<f32> = None, none "no limit", from 0 to 1, flag "PROBABILITY";
        /// Radius within which keypoints move to the mean of the candidates before suppression, which is more precise than the
        /// best single query.
        ///
        /// Three steps of mean shift move them to the weighted mean within this radius, then 0.85 and 0.7 of it.
        #[serde(deserialize_with = "none_if_zero")]
        mode_radius, with_mode_radius: Option<Length> = None, none "keypoints stay, as in the paper",
            from 0 or more " (cloud units, or as in `3r` resolutions)";
        /// Least distance of keypoints: in cloud units, in multiples of the cloud's resolution, the mean distance between
        /// nearest points (`3r`), in per cent of the cloud's radius (`10%`), or in voxels (`4v`). Of those that are closer the
        /// best is kept.
        #[serde(deserialize_with = "none_if_zero")]
        nms_radius, with_nms_radius: Option<Length> = Some(Length::Units(0.01)), none "no suppression",
            from 0 or more " (cloud units, or as in `3r` resolutions)", flag "LENGTH";
        /// Largest number of keypoints; those with the highest saliency are kept.
        ///
        /// `usize::MAX` is no limit.
        #[serde(deserialize_with = "most_if_null")]
        max_keypoints, with_max_keypoints: usize = 64, none "no limit", flag "NUMBER";
        /// Whether each keypoint moves to its nearest input point. Several keypoints can then coincide, as in the paper.
        snap, with_snap: bool = false;
    }
}

impl DetectOptions {
    /// Checks the ranges, and the number of evaluations of a field with these rotations.
    pub(crate) fn check(&self, rotations: usize) -> Result<()> {
        self.check_ranges()?;
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

/// An option, or `None` for 0 and null.
fn none_if_zero<'de, T, D>(deserializer: D) -> std::result::Result<Option<T>, D::Error>
where
    T: Deserialize<'de> + Ranged,
    D: serde::Deserializer<'de>,
{
    Ok(Option::<T>::deserialize(deserializer)?.filter(|value| value.outside(0.0, 0.0).is_some()))
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

options! {
    /// Options of [`Field::mesh`](crate::Field::mesh).
    pub struct MeshOptions {
        /// Number of samples of the occupancy along each axis of the feature volume, ends included.
        resolution, with_resolution: usize = 128, from 8 to 512 " (samples along each axis)", flag "NUMBER";
        /// Occupancy at the surface. A higher level gives thinner shells.
        ///
        /// The default is the released code's.
        level, with_level: f32 = 0.4, from 0.001 to 0.999 " (a probability)", flag "PROBABILITY";
        /// Whether only surfaces are kept that can be reached from outside. A thin shell has an outer and an inner surface; this
        /// removes the inner one unless the shell has a hole.
        outer, with_outer: bool = false, flag "OUTER";
    }
}

impl MeshOptions {
    /// Refuses options that [`Field::mesh`](crate::Field::mesh) would refuse, before any work is done.
    ///
    /// # Errors
    /// [`Error::Option`] when an option is out of its range.
    pub fn check(&self) -> Result<()> {
        Ok(self.check_ranges()?)
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

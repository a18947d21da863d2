//! Keypoint detection (SNAKE Algorithm 1).

use std::time::Instant;

use serde::{Deserialize, Serialize};

use crate::field::{EncodeOptions, Field};
use crate::length::Length;
use crate::nms::{nearest_points, suppress};
use crate::points::{FinitePoints, Normalization, NormalizationMethod, Point};
use crate::progress::Counter;
use crate::query_grid::{QueryGrid, above_occupancy};
use crate::refine::{Refined, refine};
use crate::windows::WindowOptions;
use crate::{Error, ModelConfig, Result, budget};

/// One keypoint, in the frame and units of the input cloud.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Keypoint {
    /// Position in cloud units.
    pub position: Point,
    /// Saliency in [0, 1]; the score that keypoints are ranked by.
    pub saliency: f32,
    /// Occupancy in [0, 1] at the position.
    pub occupancy: f32,
    /// Index of the nearest input point, in the cloud as it was given.
    pub nearest_index: usize,
}

/// How queries climb.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum RefineMethod {
    /// Adam on one minus the mean saliency of all the cloud's queries: what the released code does. Its ε makes steps
    /// on nearly flat ground depend a little on the number of queries.
    #[default]
    Adam,
    /// Algorithm 1 as printed, with each query's own gradient (that of the mean would not move anything).
    GradientDescent,
}

/// Which position and score a refined query gets. A score is the saliency where the occupancy is above the surface
/// threshold, else 0.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Selection {
    /// The best score on the way, the position after the last step counted too, and the position that had it.
    #[default]
    BestPosition,
    /// What the released code returns: the position after the last step, with the best score measured before any step.
    ReferenceFinalPosition,
}

/// Options of [`detect`]; the defaults are the paper's for ModelNet40.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DetectOptions {
    /// Queries along each axis of the starting grid, which spans the network's cube ±0.5; 1 to 256, so that its cube times
    /// `refine_steps + 1` times [`EncodeOptions::rotations`] is at most 2^28.
    pub query_resolution: usize,
    /// Queries more than this many voxels of the volume, along any axis, from every voxel with input points are dropped
    /// unasked: far from the points there is hardly ever a surface, and there are many such queries. 0: all are asked.
    pub query_band: usize,
    /// Queries whose occupancy is not above this are dropped before refinement (1 − thr_o).
    pub occupancy_threshold: f32,
    /// Refinement steps (J).
    pub refine_steps: usize,
    /// Step size (λ), in network units.
    pub refine_step_size: f32,
    /// How queries climb.
    pub refine_method: RefineMethod,
    /// Which position and score they get.
    pub selection: Selection,
    /// A position scores 0 unless its occupancy is above this; the released code's 0.8.
    pub surface_threshold: f32,
    /// Keypoints have a score above this (thr_s).
    pub saliency_threshold: f32,
    /// Keypoints are farther apart than this; 0 turns suppression off.
    pub nms_radius: Length,
    /// At most this many keypoints, the best.
    pub max_keypoints: usize,
    /// Move each keypoint to its nearest input point. Two may then fall on the same point, as in the paper.
    pub snap: bool,
}

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
            nms_radius: Length::Units(0.01),
            max_keypoints: 64,
            snap: false,
        }
    }
}

impl DetectOptions {
    /// Also whether there are too many queries and steps for fields of so many copies.
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
        let (Length::Units(nms_radius) | Length::Resolutions(nms_radius)) = self.nms_radius;
        within("nms_radius", nms_radius as f32, 0.0..=f32::MAX, "0 or more (cloud units, or as in `3r` resolutions)")?;
        budget::check_queries(self.query_resolution, self.refine_steps, rotations)
    }

    /// The suppression radius in cloud units.
    pub(crate) fn nms_radius(&self, points: &[Point]) -> Result<f32> {
        match self.nms_radius {
            Length::Units(radius) => Ok(radius as f32),
            multiple => Ok(multiple.in_units("nms_radius", points)? as f32),
        }
    }
}

/// Encoding and detection options that belong together.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Preset {
    /// How the cloud is encoded.
    pub encode: EncodeOptions,
    /// How keypoints are found.
    pub detect: DetectOptions,
    /// Whether in the whole cloud at once.
    pub windows: WindowOptions,
}

impl Preset {
    /// The names that [`Preset::named`] knows: the rows of the paper's table of hyper-parameters.
    pub const NAMES: [&'static str; 5] = ["modelnet40", "keypointnet", "smpl", "redwood", "3dmatch"];

    /// Refuses what is out of its range, and what would ask for too much of the machine with that network.
    pub(crate) fn check(&self, config: &ModelConfig) -> Result<()> {
        self.windows.check()?;
        let normalization = match self.windows.window_radius {
            // A ball can be turned as the sphere can.
            Some(_) => NormalizationMethod::UnitSphere,
            None => self.encode.normalization,
        };
        EncodeOptions { normalization, ..self.encode }.check(config)?;
        self.detect.check(self.encode.rotations)
    }

    /// The test settings of one of the paper's data sets (appendix B, and the released code where the paper is silent).
    ///
    /// # Errors
    /// [`Error::Option`] for an unknown name.
    pub fn named(name: &str) -> Result<Self> {
        let (normalization, max_points) = match name {
            "modelnet40" => (NormalizationMethod::UnitSphere, Some(5000)),
            "keypointnet" | "smpl" => (NormalizationMethod::UnitCube, Some(2048)),
            "redwood" => (NormalizationMethod::UnitCube, Some(10_240)),
            "3dmatch" => (NormalizationMethod::UnitCube, None),
            _ => {
                let allowed = "modelnet40, keypointnet, smpl, redwood or 3dmatch";
                return Err(Error::Option { name: "preset", value: name.into(), allowed });
            }
        };
        let common = DetectOptions::default();
        let detect = match name {
            "keypointnet" => DetectOptions { nms_radius: Length::Units(0.1), ..common },
            "smpl" => DetectOptions { nms_radius: Length::Units(0.1), snap: true, ..common },
            "redwood" => {
                DetectOptions { query_resolution: 100, nms_radius: Length::Units(0.04), max_keypoints: 512, ..common }
            }
            "3dmatch" => DetectOptions {
                saliency_threshold: 0.4,
                nms_radius: Length::Units(0.04),
                max_keypoints: 2500,
                snap: true,
                ..common
            },
            _ => common,
        };
        Ok(Self {
            encode: EncodeOptions { normalization, max_points, ..Default::default() },
            detect,
            ..Default::default()
        })
    }
}

/// Keypoints and how they came about.
#[derive(Debug, Clone, PartialEq)]
pub struct Detection {
    /// By falling saliency.
    pub keypoints: Vec<Keypoint>,
    /// How many points of the cloud were skipped because they are not finite.
    pub num_skipped: usize,
    /// How many of the points were encoded.
    pub num_encoded: usize,
    /// The normalisation in use; `None` in windows, each of which has its own.
    pub normalization: Option<Normalization>,
    /// How many queries each step left.
    pub counts: Counts,
    /// How long each step took.
    pub timing: Timing,
}

/// How many queries each step of [`detect`] left.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct Counts {
    /// How many windows the cloud was seen through.
    pub windows: usize,
    /// On the starting grid, of all windows together.
    pub queries: usize,
    /// Of those, above the occupancy threshold.
    pub occupied: usize,
    /// Of those, above the saliency threshold after refinement.
    pub above_threshold: usize,
    /// Of those, left by suppression.
    pub keypoints: usize,
}

impl Counts {
    fn add(&mut self, other: &Self) {
        self.windows += other.windows;
        self.queries += other.queries;
        self.occupied += other.occupied;
        self.above_threshold += other.above_threshold;
    }
}

/// Seconds that each step of detection took.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Timing {
    /// Encoding; 0 of [`detect`], which is given a field.
    pub encode: f64,
    /// Occupancy of the starting grid.
    pub occupancy: f64,
    /// Refinement.
    pub refine: f64,
    /// Threshold, suppression, nearest points.
    pub nms: f64,
}

impl Timing {
    fn add(&mut self, other: &Self) {
        self.encode += other.encode;
        self.occupancy += other.occupancy;
        self.refine += other.refine;
        self.nms += other.nms;
    }

    /// Divides the seconds of threads that worked side by side so that their sum is the time that passed.
    pub(crate) fn scale_to(&mut self, seconds: f64) {
        let sum = self.encode + self.occupancy + self.refine;
        if sum > 0.0 {
            for stage in [&mut self.encode, &mut self.occupancy, &mut self.refine] {
                *stage *= seconds / sum;
            }
        }
    }
}

/// Finds the keypoints of an encoded cloud (SNAKE Algorithm 1). A field without surface has none.
///
/// ```
/// use snake_core::{DetectOptions, EncodeOptions, Length, Model, detect};
/// # let points: Vec<[f32; 3]> = (0..500).map(|i| { let a = i as f32 * 0.1; [a.cos(), a.sin(), (a * 0.3).sin()] }).collect();
/// let field = Model::builtin()?.encode(&points, &EncodeOptions::default())?;
/// let detection = detect(&field, &DetectOptions { max_keypoints: 16, nms_radius: 0.1.into(), ..Default::default() })?;
/// assert!(detection.keypoints.len() <= 16);
/// # Ok::<(), snake_core::Error>(())
/// ```
///
/// # Errors
/// [`Error::Option`] when an option is out of its range.
pub fn detect(field: &Field, options: &DetectOptions) -> Result<Detection> {
    options.check(field.num_copies())?;
    let nms_radius = options.nms_radius(field.points())?;
    let candidates = Candidates::of(field, options, |_| true);
    let occupancy = |_: &[usize], positions: &[Point]| field.occupancy(positions);
    Counter::begin(field.model().progress(), "suppression", 0);
    let mut detection = finish(candidates, field.finite_points(), nms_radius, options, occupancy)?;
    detection.num_skipped = field.num_skipped();
    detection.num_encoded = field.num_encoded();
    detection.normalization = Some(field.normalization());
    Ok(detection)
}

/// Refined queries above the saliency threshold, of a whole cloud or of its windows.
#[derive(Default)]
pub(crate) struct Candidates {
    /// In the cloud's frame and units.
    pub(crate) positions: Vec<Point>,
    pub(crate) scores: Vec<f32>,
    pub(crate) counts: Counts,
    pub(crate) timing: Timing,
}

impl Candidates {
    /// The candidates of a field, from the starting queries that `owns` accepts by their positions in the cloud's frame.
    pub(crate) fn of(field: &Field, options: &DetectOptions, owns: impl Fn(&Point) -> bool) -> Self {
        let start = Instant::now();
        let queries = QueryGrid::new(field, options);
        let mut occupied = above_occupancy(field, &queries, options.occupancy_threshold);
        occupied.retain(|&query| owns(&field.normalization().to_cloud(query)));
        let occupancy_done = Instant::now();
        let refined = refine(field, &occupied, options);
        let mut candidates = above_saliency(field, &refined, options.saliency_threshold);
        candidates.timing.occupancy = (occupancy_done - start).as_secs_f64();
        candidates.timing.refine = occupancy_done.elapsed().as_secs_f64();
        candidates.counts = Counts {
            windows: 1,
            queries: options.query_resolution.pow(3),
            occupied: occupied.len(),
            above_threshold: candidates.positions.len(),
            keypoints: 0,
        };
        candidates
    }

    /// Adds the candidates of another window.
    pub(crate) fn append(&mut self, other: Self) {
        self.positions.extend(other.positions);
        self.scores.extend(other.scores);
        self.counts.add(&other.counts);
        self.timing.add(&other.timing);
    }
}

/// The refined queries whose score is above the saliency threshold, in the cloud's frame. Huge steps can carry a query to
/// where its coordinates overflow: it is dropped.
fn above_saliency(field: &Field, refined: &[Refined], threshold: f32) -> Candidates {
    let in_cloud = refined.iter().map(|query| (field.normalization().to_cloud(query.position), query.score));
    let kept = in_cloud.filter(|(position, score)| *score > threshold && position.iter().all(|v| v.is_finite()));
    let (positions, scores) = kept.unzip();
    Candidates { positions, scores, ..Default::default() }
}

/// Suppression, nearest input points, snapping and occupancy: the end of every detection.
///
/// `occupancy` gives the occupancy of kept candidates, by their indices and by their final positions. What only a field
/// knows is left for the caller to fill in.
pub(crate) fn finish(
    candidates: Candidates,
    points: &FinitePoints,
    nms_radius: f32,
    options: &DetectOptions,
    occupancy: impl FnOnce(&[usize], &[Point]) -> Result<Vec<f32>>,
) -> Result<Detection> {
    let start = Instant::now();
    let Candidates { positions, scores, mut counts, mut timing } = candidates;
    let kept = suppress(&positions, &scores, nms_radius, options.max_keypoints)?;
    let mut positions: Vec<Point> = kept.iter().map(|&index| positions[index]).collect();
    let nearest = nearest_points(&points.points, &positions)?;
    if options.snap {
        positions = nearest.iter().map(|&index| points.points[index]).collect();
    }
    let occupancy = occupancy(&kept, &positions)?;
    let keypoint = |(rank, &candidate): (usize, &usize)| Keypoint {
        position: positions[rank],
        saliency: scores[candidate],
        occupancy: occupancy[rank],
        nearest_index: points.original_index(nearest[rank]),
    };
    let keypoints: Vec<Keypoint> = kept.iter().enumerate().map(keypoint).collect();
    counts.keypoints = keypoints.len();
    timing.nms = start.elapsed().as_secs_f64();
    Ok(Detection { keypoints, num_skipped: 0, num_encoded: 0, normalization: None, counts, timing })
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::Model;

    /// A cylinder's points and its field by the built-in model.
    pub(crate) fn cylinder() -> (Vec<Point>, Field) {
        let points: Vec<Point> = (0..2000)
            .map(|i| {
                let angle = i as f32 * 0.1;
                [angle.cos(), angle.sin(), (i % 40) as f32 * 0.02]
            })
            .collect();
        let field = Model::builtin().unwrap().encode(&points, &EncodeOptions::default()).unwrap();
        (points, field)
    }

    #[test]
    fn a_suppression_radius_may_be_a_multiple_of_the_resolution() {
        let (points, field) = cylinder();
        let found = |nms_radius| {
            let options =
                DetectOptions { nms_radius, saliency_threshold: 0.0, max_keypoints: 1000, ..Default::default() };
            detect(&field, &options).map(|detection| detection.keypoints)
        };
        let multiple = Length::Resolutions(5.0);
        let radius = multiple.in_units("nms_radius", &points).unwrap();
        assert_eq!(found(multiple).unwrap(), found(Length::Units(radius)).unwrap());
        assert!(found(multiple).unwrap().len() < found(Length::Units(0.0)).unwrap().len());
        for wrong in [Length::Resolutions(0.0), Length::Resolutions(-1.0), Length::Units(-1.0), Length::Units(1e60)] {
            assert!(found(wrong).unwrap_err().to_string().contains("nms_radius"), "{wrong}");
        }
    }

    #[test]
    fn points_that_are_not_finite_are_skipped_and_indices_are_those_of_the_whole_cloud() {
        let (clean, _) = cylinder();
        // Each third point is missing.
        let mut whole = Vec::new();
        for pair in clean.chunks(2) {
            whole.extend(pair);
            whole.push([pair[0][0], f32::NAN, f32::INFINITY]);
        }
        let model = Model::builtin().unwrap();
        for max_points in [None, Some(700)] {
            let mut preset = *model.recommended();
            preset.encode.max_points = max_points;
            let (of_whole, of_clean) = (model.detect(&whole, &preset).unwrap(), model.detect(&clean, &preset).unwrap());
            assert_eq!((of_whole.num_skipped, of_clean.num_skipped), (1000, 0));
            assert!(of_whole.keypoints.len() > 5);
            let mapped = of_clean
                .keypoints
                .iter()
                .map(|k| Keypoint { nearest_index: k.nearest_index / 2 * 3 + k.nearest_index % 2, ..*k });
            assert_eq!(of_whole.keypoints, mapped.collect::<Vec<_>>());
        }
        let error = model.detect(&[[f32::NAN; 3]; 9], model.recommended()).unwrap_err().to_string();
        assert_eq!(error, "points: none of the 9 points is finite");
    }
}

//! Keypoint detection (SNAKE Algorithm 1).

pub(crate) mod cell_means;
mod cluster_hint;
pub(crate) mod modes;
mod named_options;
pub(crate) mod options;
pub(crate) mod query_grid;
pub(crate) mod refine;
mod rims;
pub(crate) mod tiles;

pub use self::cluster_hint::cluster_hint;
#[doc(hidden)]
pub use self::named_options::in_words;
pub use self::named_options::option_names;
pub use self::named_options::with_named_values;
pub use self::options::{DetectOptions, EncodeOptions, MeshOptions, Options, Preset, RefineMethod, Selection};
pub use self::tiles::{Candidate, TileCandidates, TileDetector, TileSettings, by_rank};

use serde::{Deserialize, Serialize};

use crate::Result;
use crate::call::clock::Instant;
use crate::call::control::Control;
use crate::call::span::span;
use crate::detect::cell_means::cell_means;
use crate::detect::modes::seek_modes;
use crate::detect::options::Radii;
use crate::detect::query_grid::{Occupied, QueryGrid, above_occupancy, above_occupancy_of};
use crate::detect::refine::{Refined, refine};
use crate::detect::rims::lower_rims;
use crate::field::{Field, Quantity};
use snake_geometry::{FinitePoints, Keypoint, Normalization, Point, nearest_points_into, suppress};
use snake_kernels::{Element, Scratch};

/// The result of a detection: keypoints, counts and run times.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Detection {
    /// The keypoints, by falling saliency.
    pub keypoints: Vec<Keypoint>,
    /// Number of points of the cloud that were skipped because they are not finite, or are outliers.
    pub num_skipped: usize,
    /// Number of points that were encoded.
    pub num_encoded: usize,
    /// The normalisation of the cloud; `None` before the first detection.
    pub normalization: Option<Normalization>,
    /// The size of a voxel of the volume in cloud units; `None` before the first detection.
    #[serde(default)]
    pub voxel_size: Option<f32>,
    /// Number of queries after each step.
    pub counts: Counts,
    /// Run time of each step; `timing_seconds` in JSON.
    #[serde(rename = "timing_seconds")]
    pub timing: Timing,
}

/// Number of queries after each step of [`Field::detect`](crate::Field::detect).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Counts {
    /// Queries of the query grid.
    pub queries: usize,
    /// Queries above the occupancy threshold.
    pub occupied: usize,
    /// Queries above the saliency threshold after refinement.
    pub above_threshold: usize,
    /// Keypoints after suppression.
    pub keypoints: usize,
}

impl Counts {
    /// Adds the counts of another tile.
    pub fn add(&mut self, other: &Self) {
        self.queries += other.queries;
        self.occupied += other.occupied;
        self.above_threshold += other.above_threshold;
    }
}

/// Run time of each step of detection, in seconds.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Timing {
    /// Encoding; 0 for [`Field::detect`](crate::Field::detect), which starts from a field.
    pub encode: f64,
    /// Occupancy of the query grid.
    pub occupancy: f64,
    /// Refinement.
    pub refine: f64,
    /// Threshold, suppression, nearest points.
    pub nms: f64,
}

impl Field {
    /// Detects the keypoints of the encoded cloud (SNAKE Algorithm 1). A field without surface has none.
    ///
    /// ```
    /// use snake_core::{Builtin, Model};
    /// # let points: Vec<[f32; 3]> = (0..500).map(|i| { let a = i as f32 * 0.1; [a.cos(), a.sin(), (a * 0.3).sin()] }).collect();
    /// let model = Model::builtin(Builtin::Compact);
    /// let field = model.encode(&points, &model.recommended().encode)?;
    /// let options = model.recommended().detect.with_max_keypoints(16).with_nms_radius(Some(0.1.into()));
    /// assert!((1..=16).contains(&field.detect(&options)?.keypoints.len()));
    /// # Ok::<(), snake_core::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Option`](crate::Error::Option) when an option is out of its range.
    pub fn detect(&self, options: &DetectOptions) -> Result<Detection> {
        self.detect_with(options, &Control::default())
    }

    /// [`Field::detect`] with progress, cancellation and limits.
    ///
    /// # Errors
    /// The errors of [`Field::detect`]; [`Error::Cancelled`](crate::Error::Cancelled),
    /// [`Error::DeadlineExceeded`](crate::Error::DeadlineExceeded) and [`Error::LimitExceeded`](crate::Error::LimitExceeded).
    pub fn detect_with(&self, options: &DetectOptions, control: &Control) -> Result<Detection> {
        options.check(self.num_rotations())?;
        self.network().check_confidence(options)?;
        control.get_limits().check_evaluations(&options.evaluations(self.num_rotations()))?;
        self.detect_in(options, Vec::new(), control)
    }

    /// [`Field::detect_with`] with memory for the keypoints. The options are valid for the network, and within the limits.
    pub(crate) fn detect_in(
        &self,
        options: &DetectOptions,
        memory: Vec<Keypoint>,
        control: &Control,
    ) -> Result<Detection> {
        let radii = options.radii(self.points(), self.voxel_size())?;
        let candidates = Candidates::of(self, options, control)?;
        control.begin("suppression", 0).check()?;
        let occupancy = |_: &[usize], positions: &[Point]| {
            let mut occupancy = Scratch::zeros(positions.len());
            self.values_into(Quantity::Occupancy, positions, &mut occupancy)?;
            Ok(occupancy)
        };
        let mut detection = finish(candidates, self.finite_points(), radii, options, occupancy, memory)?;
        for keypoint in &mut detection.keypoints {
            keypoint.confidence = self.network().confidence(keypoint.saliency);
        }
        if let Some(least) = options.min_confidence {
            detection.keypoints.retain(|keypoint| keypoint.confidence >= Some(least));
            detection.counts.keypoints = detection.keypoints.len();
        }
        detection.num_skipped = self.num_skipped();
        detection.num_encoded = self.num_encoded();
        detection.normalization = Some(self.normalization());
        detection.voxel_size = Some(self.voxel_size());
        Ok(detection)
    }
}

/// Refined queries above the saliency threshold.
#[derive(Default)]
pub(crate) struct Candidates {
    /// In the cloud's frame and units.
    pub(crate) positions: Scratch<Point>,
    pub(crate) scores: Scratch<f32>,
    pub(crate) counts: Counts,
    pub(crate) timing: Timing,
}

impl Candidates {
    /// The candidates of a field.
    pub(crate) fn of(field: &Field, options: &DetectOptions, control: &Control) -> Result<Self> {
        let start = Instant::now();
        let Some(frame) = field.volume().frame() else {
            let cells = cell_means(field);
            return Self::of_cells(field, &cells, |_| true, options, start, control);
        };
        let queries = QueryGrid::new(field, &frame, options);
        let occupied = above_occupancy(field, &queries, options.occupancy_threshold, control)?;
        Self::refined(field, &occupied, None, options, start, control)
            .map(|found| found.among(options.query_resolution.pow(3)))
    }

    /// The candidates of a scene that has these [`cell_means`]; those of the cells that `owns` accepts, in the cloud's frame.
    pub(crate) fn of_cells(
        field: &Field,
        cells: &[Point],
        owns: impl Fn(&Point) -> bool,
        options: &DetectOptions,
        start: Instant,
        control: &Control,
    ) -> Result<Self> {
        let is_own = |query: &Point| owns(&field.normalization().to_cloud(*query));
        let queries = Scratch::collect(cells.len(), cells.iter().copied().filter(is_own));
        let occupied = above_occupancy_of(field, &queries, options.occupancy_threshold, control)?;
        Self::refined(field, &occupied, Some(cells), options, start, control).map(|found| found.among(queries.len()))
    }

    /// The candidates that come of occupied queries, and of a scene the cells whose rims are lowered.
    fn refined(
        field: &Field,
        occupied: &Occupied,
        cells: Option<&[Point]>,
        options: &DetectOptions,
        start: Instant,
        control: &Control,
    ) -> Result<Self> {
        let occupancy_done = Instant::now();
        let mut refined = refine(field, occupied, options, control)?;
        if let Some(cells) = cells {
            lower_rims(&mut refined, cells)?;
        }
        let mut candidates = above_saliency(field, &refined, options.saliency_threshold);
        candidates.timing.occupancy = (occupancy_done - start).as_secs_f64();
        candidates.timing.refine = occupancy_done.elapsed().as_secs_f64();
        candidates.counts.occupied = occupied.positions.len();
        candidates.counts.above_threshold = candidates.positions.len();
        Ok(candidates)
    }

    fn among(mut self, num_queries: usize) -> Self {
        self.counts.queries = num_queries;
        self
    }
}

/// The refined queries whose score is above the saliency threshold, in the cloud's frame. Queries whose coordinates
/// overflow, as with very large steps, are dropped.
fn above_saliency(field: &Field, refined: &[Refined], threshold: f32) -> Candidates {
    let in_cloud = refined
        .iter()
        .map(|query| Refined { position: field.normalization().to_cloud(query.position), score: query.score });
    let kept = in_cloud.filter(|query| query.score > threshold && query.position.iter().all(|v| v.is_finite()));
    Candidates {
        positions: Scratch::collect(refined.len(), kept.clone().map(|query| query.position)),
        scores: Scratch::collect(refined.len(), kept.map(|query| query.score)),
        ..Default::default()
    }
}

/// The last steps of every detection: suppression, nearest input points, snapping and occupancy.
///
/// `occupancy` returns the occupancy of the kept candidates, given their indices and their final positions. The keypoints
/// replace the content of `memory`. The caller fills in the numbers of points and the normalisation.
pub(crate) fn finish(
    candidates: Candidates,
    points: &FinitePoints,
    radii: Radii,
    options: &DetectOptions,
    occupancy: impl FnOnce(&[usize], &[Point]) -> Result<Scratch<f32>>,
    memory: Vec<Keypoint>,
) -> Result<Detection> {
    span!("suppress");
    let start = Instant::now();
    let Candidates { positions, scores, mut counts, mut timing } = candidates;
    let (kept, mut positions, scores) = match radii.mode {
        None => {
            let kept = suppress(&positions, &scores, radii.nms, options.max_keypoints)?;
            let (positions, scores) = (selected(&positions, &kept), selected(&scores, &kept));
            (kept, positions, scores)
        }
        Some(radius) => {
            let modes = seek_modes(&positions, &scores, radius, options.max_keypoints)?;
            let kept = suppress(&modes.positions, &modes.scores, radii.nms, options.max_keypoints)?;
            (selected(&modes.starts, &kept), selected(&modes.positions, &kept), selected(&modes.scores, &kept))
        }
    };
    let mut nearest = Scratch::zeros(positions.len());
    nearest_points_into(&points.points, &positions, &mut nearest)?;
    if options.snap {
        positions = selected(&points.points, &nearest);
    }
    let occupancy = occupancy(&kept, &positions)?;
    let keypoint = |rank: usize| Keypoint {
        position: positions[rank],
        saliency: scores[rank],
        occupancy: occupancy[rank],
        nearest_index: points.original_index(nearest[rank]),
        confidence: None,
    };
    let mut keypoints = memory;
    keypoints.clear();
    keypoints.reserve(kept.len().next_power_of_two());
    keypoints.extend((0..kept.len()).map(keypoint));
    counts.keypoints = keypoints.len();
    timing.nms = start.elapsed().as_secs_f64();
    Ok(Detection { keypoints, num_skipped: 0, num_encoded: 0, normalization: None, voxel_size: None, counts, timing })
}

/// The values at these indices.
fn selected<T: Element>(values: &[T], indices: &[usize]) -> Scratch<T> {
    Scratch::collect(indices.len(), indices.iter().map(|&index| values[index]))
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::{Builtin, EncodeOptions, Model};
    use snake_geometry::{
        Length, NormalizationMethod,
        rotations::{rotate, rotate_inverse, super_fibonacci},
    };

    /// A cylinder's points and its field by the built-in model.
    pub(crate) fn cylinder() -> (Vec<Point>, Field) {
        let points: Vec<Point> = (0..2000)
            .map(|i| {
                let angle = i as f32 * 0.1;
                [angle.cos(), angle.sin(), (i % 40) as f32 * 0.02]
            })
            .collect();
        let field = Model::builtin(Builtin::Compact).encode(&points, &EncodeOptions::default()).unwrap();
        (points, field)
    }

    #[test]
    fn detections_read_back_from_json() {
        let (points, _) = cylinder();
        let model = Model::builtin(Builtin::Compact);
        let found = model.detect(&points, model.recommended()).unwrap();
        let text = serde_json::to_string(&found).unwrap();
        assert_eq!(serde_json::from_str::<Detection>(&text).unwrap(), found);
        let value: serde_json::Value = serde_json::from_str(&text).unwrap();
        let keys: Vec<&String> = value["keypoints"][0].as_object().unwrap().keys().collect();
        assert_eq!(keys, ["confidence", "nearest_index", "occupancy", "saliency", "x", "y", "z"]);
        assert!(value["timing_seconds"]["encode"].as_f64().unwrap() > 0.0);
    }

    #[test]
    fn in_principal_axes_a_turned_cloud_has_turned_keypoints() {
        let points: Vec<Point> = (0..4000)
            .map(|i| {
                let (angle, height) = (i as f32 * 0.7, (i % 97) as f32 / 97.0);
                let radius = 0.15 + 0.2 * height * height;
                [radius * angle.cos() + 0.3 * height * height, 0.7 * radius * angle.sin(), 2.0 * height]
            })
            .collect();
        let model = Model::builtin(Builtin::Compact);
        let shares = [NormalizationMethod::UnitSphere, NormalizationMethod::PrincipalAxes].map(|normalization| {
            let mut options = *model.recommended();
            options.encode.normalization = normalization;
            let found = |points: &[Point]| model.detect(points, &options).unwrap().keypoints;
            let keypoints = found(&points);
            let rotation = &super_fibonacci(5).nth(3).unwrap();
            let turned = found(&points.iter().map(|&p| rotate(rotation, p)).collect::<Vec<_>>());
            let again = |keypoint: &&Keypoint| {
                let squared = |other: &Keypoint| {
                    let other = rotate_inverse(rotation, other.position);
                    (0..3).map(|axis| (keypoint.position[axis] - other[axis]).powi(2)).sum::<f32>()
                };
                turned.iter().map(squared).any(|squared| squared < 0.005 * 0.005)
            };
            assert!(keypoints.len() > 20);
            keypoints.iter().filter(again).count() as f32 / keypoints.len() as f32
        });
        assert!(shares[0] < 0.6 && shares[1] > 0.9, "{shares:?}");
    }

    #[test]
    fn modes_are_suppressed() {
        let (_, field) = cylinder();
        let found = |mode_radius, nms_radius: f64| {
            let options = DetectOptions {
                mode_radius,
                nms_radius: Some(nms_radius.into()),
                refine_steps: 0,
                saliency_threshold: 0.0,
                ..Default::default()
            };
            field.detect(&options).unwrap().keypoints
        };
        let modes = found(Some(Length::Units(0.1)), 0.1);
        assert!(modes.len() > 5 && modes != found(None, 0.1));
        assert!(modes.is_sorted_by(|a, b| a.saliency >= b.saliency));
        for (i, a) in modes.iter().enumerate() {
            for b in &modes[..i] {
                let squared: f32 = (0..3).map(|axis| (a.position[axis] - b.position[axis]).powi(2)).sum();
                assert!(squared > 0.1 * 0.1, "{a:?} {b:?}");
            }
        }
    }

    #[test]
    fn a_suppression_radius_may_be_a_multiple_of_the_resolution() {
        let (points, field) = cylinder();
        let found = |radius: Length| {
            let nms_radius = Some(radius);
            let options =
                DetectOptions { nms_radius, saliency_threshold: 0.0, max_keypoints: 1000, ..Default::default() };
            field.detect(&options).map(|detection| detection.keypoints)
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
        let model = Model::builtin(Builtin::Compact);
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

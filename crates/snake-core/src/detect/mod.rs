//! Keypoint detection (SNAKE Algorithm 1).

mod corners;
mod detection;
mod finish;
pub(crate) mod localize;
mod modes;
pub(crate) mod occupied;
pub(crate) mod refine;
mod surface;
#[cfg(test)]
pub(crate) mod tests;
mod tiles;

pub use self::detection::{Counts, Detection, Timing};
pub use self::tiles::{Candidate, PlacedDetector, TileCandidates, TileDetector, TileOutcome, TileSettings, by_rank};

use self::finish::finish;
use self::occupied::above_occupancy;
use self::refine::refine;
use crate::Result;
use crate::control::Control;
use crate::control::clock::Instant;
use crate::field::Field;
use crate::lattice::{Queries, Refined};
use crate::options::DetectOptions;
use snake_geometry::Point;

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

    /// [`Field::detect`] with progress, cancellation and a deadline.
    ///
    /// # Errors
    /// The errors of [`Field::detect`]; [`Error::Cancelled`](crate::Error::Cancelled) and
    /// [`Error::DeadlineExceeded`](crate::Error::DeadlineExceeded).
    pub fn detect_with(&self, options: &DetectOptions, control: &Control) -> Result<Detection> {
        self.network().check_detect(options, self.num_rotations())?;
        self.detect_in(options, control)
    }

    /// [`Field::detect_with`] with options that are valid for the network.
    pub(crate) fn detect_in(&self, options: &DetectOptions, control: &Control) -> Result<Detection> {
        let diagonal = self.lattice().is_scene().then(|| diagonal(self.points()));
        let radii = options.radii(self.points(), self.voxel_size(), diagonal)?;
        let queries = self.queries(options);
        let candidates = candidates(self, &queries, options, control)?;
        control.begin("suppression", 0).check()?;
        finish(self, candidates, radii, options)
    }
}

/// The diagonal of the bounding box of the points.
fn diagonal(points: &[Point]) -> f32 {
    let [low, high] = [f32::min, f32::max].map(|end: fn(f32, f32) -> f32| {
        points.iter().copied().reduce(|a, b| std::array::from_fn(|axis| end(a[axis], b[axis]))).unwrap_or_default()
    });
    (0..3).map(|axis| (high[axis] - low[axis]).powi(2)).sum::<f32>().sqrt()
}

/// Refines the occupied queries and keeps the salient ones as candidates. Detection in tiles starts here too.
fn candidates(field: &Field, queries: &Queries, options: &DetectOptions, control: &Control) -> Result<Candidates> {
    let start = Instant::now();
    let occupied = above_occupancy(field, queries, options.occupancy_threshold, control)?;
    let occupancy_seconds = start.elapsed().as_secs_f64();
    let refined = refine(field, &occupied, options, control)?;
    let mut candidates = above_saliency(field, &refined, options.saliency_threshold);
    candidates.timing.occupancy = occupancy_seconds;
    candidates.timing.refine = start.elapsed().as_secs_f64() - occupancy_seconds;
    candidates.counts.queries = queries.len();
    candidates.counts.occupied = occupied.positions.len();
    Ok(candidates)
}

/// Refined queries above the saliency threshold.
#[derive(Default)]
struct Candidates {
    /// In the cloud's frame and units.
    positions: Vec<Point>,
    scores: Vec<f32>,
    counts: Counts,
    timing: Timing,
}

/// The refined queries whose score is above the saliency threshold, in the cloud's frame. Queries whose coordinates
/// overflow, as with very large steps, are dropped.
fn above_saliency(field: &Field, refined: &[Refined], threshold: f32) -> Candidates {
    let in_cloud = refined
        .iter()
        .map(|query| Refined { position: field.normalization().to_cloud(query.position), score: query.score });
    let kept = in_cloud.filter(|query| query.score > threshold && query.position.iter().all(|v| v.is_finite()));
    let (positions, scores): (Vec<_>, Vec<_>) = kept.map(|query| (query.position, query.score)).unzip();
    let counts = Counts { above_threshold: positions.len(), ..Counts::default() };
    Candidates { positions, scores, counts, timing: Timing::default() }
}

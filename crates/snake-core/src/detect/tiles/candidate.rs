//! The candidates of a tile.

use super::Counts;
use snake_geometry::{Covariance, Point};

/// A voxel's query above the saliency threshold, after mode seeking and localization, that suppression has not removed yet.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Candidate {
    /// Position in cloud units, relative to the origin of the whole cloud.
    pub position: Point,
    /// The score, see [`Keypoint::saliency`](crate::Keypoint::saliency).
    pub saliency: f32,
    /// Occupancy in [0, 1] at the position.
    pub occupancy: f32,
    /// See [`Keypoint::confidence`](crate::Keypoint::confidence).
    pub confidence: Option<f32>,
    /// Covariance of the position.
    pub covariance: Covariance,
    /// What candidates are ranked by: the score, and after localization also what the points determine.
    pub rank: f32,
    /// Saliency in [0, 1] where it started; the score without mode seeking.
    pub start: f32,
    /// The voxel where it started, along x, y and z.
    pub cell: [i32; 3],
}

/// The candidates of a tile, by their cells' z, then y, then x.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TileCandidates {
    /// The candidates.
    pub candidates: Vec<Candidate>,
    /// Number of queries after each step. Keypoints are not counted.
    pub counts: Counts,
}

/// The rank of candidates, best first: by their ranks, the saliency where they started, and their cells' z, then y, then x.
pub fn by_rank(a: &Candidate, b: &Candidate) -> std::cmp::Ordering {
    let by_score = b.rank.total_cmp(&a.rank).then(b.start.total_cmp(&a.start));
    by_score.then(by_place(a).cmp(&by_place(b)))
}

/// The order of the voxels of a scene.
pub(super) fn by_place(candidate: &Candidate) -> [i32; 3] {
    let [x, y, z] = candidate.cell;
    [z, y, x]
}

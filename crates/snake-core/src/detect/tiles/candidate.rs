//! The candidates of a tile.

use super::Counts;
use snake_geometry::{Covariance, Point};

/// A query of a voxel above the saliency threshold, after mode seeking and localization and before suppression.
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
    /// The rank: the score, after localization weighted by how well the points determine the position.
    pub rank: f32,
    /// Saliency in [0, 1] at the start of mode seeking; the score without mode seeking.
    pub start: f32,
    /// The voxel of the start, along x, y and z.
    pub cell: [i32; 3],
}

/// The candidates of a tile, ordered by z, then y, then x of their cells.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TileCandidates {
    /// The candidates.
    pub candidates: Vec<Candidate>,
    /// Number of queries after each step. Keypoints are not counted.
    pub counts: Counts,
}

/// Orders candidates best first: by rank, then by saliency at the start, then by z, y and x of the cell.
pub fn by_rank(a: &Candidate, b: &Candidate) -> std::cmp::Ordering {
    let by_score = b.rank.total_cmp(&a.rank).then(b.start.total_cmp(&a.start));
    by_score.then(by_place(a).cmp(&by_place(b)))
}

/// The sort key that gives the order of a scene's voxels.
pub(super) fn by_place(candidate: &Candidate) -> [i32; 3] {
    let [x, y, z] = candidate.cell;
    [z, y, x]
}

//! From candidates to keypoints: modes, suppression, nearest points, confidence.

use super::modes::seek_modes;
use super::{Candidates, Detection};
use crate::Result;
use crate::control::clock::Instant;
use crate::control::span;
use crate::field::Field;
use crate::options::{DetectOptions, Radii};
use snake_geometry::{Keypoint, nearest_points, suppress};

/// The last steps of a detection.
pub(super) fn finish(
    field: &Field,
    candidates: Candidates,
    radii: Radii,
    options: &DetectOptions,
) -> Result<Detection> {
    span!("suppress");
    let start = Instant::now();
    let Candidates { positions, scores, mut counts, mut timing } = candidates;
    let (mut positions, scores) = match radii.mode {
        None => {
            let kept = suppress(&positions, &scores, radii.nms, options.max_keypoints)?;
            (selected(&positions, &kept), selected(&scores, &kept))
        }
        Some(radius) => {
            let modes = seek_modes(&positions, &scores, radius, options.max_keypoints)?;
            let kept = suppress(&modes.positions, &modes.scores, radii.nms, options.max_keypoints)?;
            (selected(&modes.positions, &kept), selected(&modes.scores, &kept))
        }
    };
    let points = field.finite_points();
    let nearest = nearest_points(&points.points, &positions)?;
    if options.snap {
        positions = selected(&points.points, &nearest);
    }
    let occupancy = field.occupancy(&positions)?;
    let keypoint = |rank: usize| Keypoint {
        position: positions[rank],
        saliency: scores[rank],
        occupancy: occupancy[rank],
        nearest_index: points.original_index(nearest[rank]),
        confidence: field.network().confidence(scores[rank]),
    };
    let is_kept = |keypoint: &Keypoint| options.min_confidence.is_none_or(|min| keypoint.confidence >= Some(min));
    let keypoints: Vec<Keypoint> = (0..positions.len()).map(keypoint).filter(is_kept).collect();
    counts.keypoints = keypoints.len();
    timing.nms = start.elapsed().as_secs_f64();
    Ok(Detection {
        keypoints,
        num_skipped: field.num_skipped(),
        num_encoded: field.num_encoded(),
        normalization: Some(field.normalization()),
        voxel_size: Some(field.voxel_size()),
        counts,
        timing,
    })
}

/// The values at these indices.
fn selected<T: Copy>(values: &[T], indices: &[usize]) -> Vec<T> {
    indices.iter().map(|&index| values[index]).collect()
}

//! From candidates to keypoints: modes, suppression, nearest points, confidence.

use super::modes::seek_modes;
use super::{Candidates, Detection, corners};
use crate::Result;
use crate::control::clock::Instant;
use crate::field::Field;
use crate::options::{DetectOptions, Preference, Radii};
use snake_geometry::{Keypoint, nearest_points, suppress};

/// The last steps of a detection.
pub(super) fn finish(
    field: &Field,
    candidates: Candidates,
    radii: Radii,
    options: &DetectOptions,
) -> Result<Detection> {
    let start = Instant::now();
    let Candidates { mut positions, mut scores, mut counts, mut timing } = candidates;
    if let Some(radius) = radii.mode {
        let modes = seek_modes(&positions, &scores, radius, options.max_keypoints)?;
        (positions, scores) = (modes.positions, modes.scores);
    }
    let points = field.finite_points();
    let kept = match options.prefer {
        Preference::Salient => suppress(&positions, &scores, radii.nms, options.max_keypoints)?,
        Preference::Corners => {
            let offsets = corners::offsets(&points.points, &positions, corners::RADIUS * field.voxel_size())?;
            let ranks: Vec<f32> = scores.iter().zip(offsets).map(|(score, offset)| score + offset).collect();
            suppress(&positions, &ranks, radii.nms, options.max_keypoints)?
        }
    };
    (positions, scores) = (selected(&positions, &kept), selected(&scores, &kept));
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

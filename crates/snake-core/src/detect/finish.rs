//! From candidates to keypoints: modes, places, suppression, nearest points, confidence.

use super::localize::{Place, localize};
use super::modes::{Modes, seek_modes};
use super::surface::on_surface;
use super::{Candidates, Detection, corners};
use crate::Result;
use crate::control::clock::Instant;
use crate::control::span;
use crate::field::Field;
use crate::options::{DetectOptions, Preference, Radii};
use snake_geometry::{Keypoint, Point, nearest_points, suppress};

/// The last steps of a detection.
pub(super) fn finish(
    field: &Field,
    candidates: Candidates,
    radii: Radii,
    options: &DetectOptions,
) -> Result<Detection> {
    span!("suppress");
    let start = Instant::now();
    let (positions, scores) = (&candidates.positions, &candidates.scores);
    let (mut places, scores) = match radii.mode {
        Some(radius) => {
            let Modes { positions: modes, scores: mode_scores } =
                seek_modes(positions, scores, [radius, radii.starts], options.max_keypoints)?;
            if field.lattice().is_scene() || options.prefer == Preference::Corners {
                kept(field, localize(field, &modes)?, mode_scores, radii.nms, options)?
            } else {
                // Those that meet on the surface are suppressed once more.
                let kept_modes = suppress(&modes, &mode_scores, radii.nms, options.max_keypoints)?;
                let (modes, mode_scores) = (selected(&modes, &kept_modes), selected(&mode_scores, &kept_modes));
                let on_surface = on_surface(field, (positions, scores), &modes)?;
                let determined = localize(field, &on_surface)?.into_iter().zip(on_surface);
                let places = determined.map(|(place, position)| Place { position, ..place }).collect();
                kept(field, places, mode_scores, radii.nms, options)?
            }
        }
        None => {
            let places = positions.iter().copied().map(Place::unknown).collect();
            kept(field, places, scores.clone(), radii.nms, options)?
        }
    };
    let points = field.finite_points();
    let positions: Vec<Point> = places.iter().map(|place| place.position).collect();
    let nearest = nearest_points(&points.points, &positions)?;
    if options.snap {
        places.iter_mut().zip(&nearest).for_each(|(place, &nearest)| place.position = points.points[nearest]);
    }
    let positions: Vec<Point> = places.iter().map(|place| place.position).collect();
    let occupancy = field.occupancy(&positions)?;
    let keypoint = |rank: usize| Keypoint {
        position: positions[rank],
        saliency: scores[rank],
        occupancy: occupancy[rank],
        nearest_index: points.original_index(nearest[rank]),
        confidence: field.network().confidence(scores[rank], &places[rank], field.voxel_size()),
        covariance: places[rank].covariance,
    };
    let is_kept = |keypoint: &Keypoint| options.min_confidence.is_none_or(|min| keypoint.confidence >= Some(min));
    let keypoints: Vec<Keypoint> = (0..positions.len()).map(keypoint).filter(is_kept).collect();
    let Candidates { mut counts, mut timing, .. } = candidates;
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

/// What suppression keeps, best first: by saliency, in scenes also by what the points determine, or corners first.
fn kept(
    field: &Field,
    places: Vec<Place>,
    scores: Vec<f32>,
    radius: f32,
    options: &DetectOptions,
) -> Result<(Vec<Place>, Vec<f32>)> {
    let positions: Vec<Point> = places.iter().map(|place| place.position).collect();
    let ranks: Vec<f32> = match options.prefer {
        Preference::Salient if field.lattice().is_scene() => {
            scores.iter().zip(&places).map(|(&score, place)| place.rank(score)).collect()
        }
        Preference::Salient => scores.clone(),
        Preference::Corners => corners::ranks(field, &places, &scores)?,
    };
    let kept = suppress(&positions, &ranks, radius, options.max_keypoints)?;
    Ok((selected(&places, &kept), selected(&scores, &kept)))
}

/// The values at these indices.
fn selected<T: Copy>(values: &[T], indices: &[usize]) -> Vec<T> {
    indices.iter().map(|&index| values[index]).collect()
}

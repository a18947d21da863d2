//! From candidates to keypoints: modes, places, suppression, nearest points, confidence.

use super::localize::{Place, Surroundings, localize};
use super::modes::{Modes, seek_modes};
use super::surface::on_surface;
use super::{Candidates, Detection, corners};
use crate::Result;
use crate::control::clock::Instant;
use crate::field::Field;
use crate::options::{DetectOptions, Preference, Radii};
use snake_geometry::{Keypoint, Point, nearest_points, suppress};

/// The last steps of a detection: turns candidates into keypoints.
pub(super) fn finish(
    field: &Field,
    candidates: Candidates,
    radii: Radii,
    options: &DetectOptions,
) -> Result<Detection> {
    let start = Instant::now();
    let Candidates { positions, scores, mut counts, mut timing } = candidates;
    let modes = match radii.mode {
        Some(radius) => seek_modes(&positions, &scores, [radius, radii.starts], options.max_keypoints)?,
        None => Modes { positions, scores },
    };
    let moves_to_planes = field.lattice().is_scene() || options.prefer == Preference::Corners;
    let moves_to_surface = radii.mode.is_some() && !moves_to_planes;
    let surroundings = radii.mode.map(|_| Surroundings::of(field, options.prefer)).transpose()?;
    let patches = surroundings.as_ref().map(Surroundings::patches).transpose()?;
    let (Modes { positions, scores }, surface_ranks) = match &patches {
        Some(patches) if !moves_to_planes => on_surface(field, patches, modes, radii.nms)?,
        _ => (modes, Vec::new()),
    };
    let places = match &patches {
        Some(patches) if moves_to_planes => localize(patches, &positions, &scores),
        _ => positions.into_iter().map(Place::unknown).collect::<Vec<_>>(),
    };
    let drops_rows = moves_to_planes && options.min_confidence.is_some();
    let stays = |(place, _): &(Place, f32)| !(drops_rows && place.is_one_of_many(field.voxel_size()));
    let (places, scores): (Vec<_>, Vec<_>) = places.into_iter().zip(scores).filter(stays).unzip();
    let ranks = match options.prefer {
        Preference::Corners => corners::ranks(field, &places, &scores)?,
        Preference::Salient if moves_to_surface => surface_ranks,
        Preference::Salient => scores.iter().zip(&places).map(|(&score, place)| place.rank(score)).collect(),
    };
    let positions: Vec<Point> = places.iter().map(|place| place.position).collect();
    let mut kept = suppress(&positions, &ranks, radii.nms, options.max_keypoints)?;
    if options.prefer == Preference::Corners {
        kept.retain(|&index| ranks[index] - scores[index] > corners::EDGE);
    }
    if moves_to_surface {
        kept.sort_by(|&a, &b| scores[b].total_cmp(&scores[a]));
    }
    let (mut places, scores) = (selected(&places, &kept), selected(&scores, &kept));
    if let (Some(patches), true) = (&patches, moves_to_surface) {
        let determined = localize(patches, &selected(&positions, &kept), &scores);
        places.iter_mut().zip(determined).for_each(|(place, at)| *place = Place { position: place.position, ..at });
    }
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
        confidence: field.network().confidence(scores[rank], places[rank].deviations, field.voxel_size(), radii.reach),
        covariance: places[rank].covariance,
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

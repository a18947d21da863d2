//! Parts of the scene that contradict sensors at one place and moved as a whole, such as posts that
//! stand still beside traffic that keeps pace with the sensor.

use super::constants::{DETAIL, FEW_PLACES, MIN_AGREEING, MIN_SHIFT};
use std::collections::HashMap;

use nalgebra::IsometryMatrix3;

use super::open_motions::axis_name;
use crate::cloud::depth_image::{DepthImage, FINE, Sight};
use crate::cloud::near_grid::NearGrid;
use crate::rigid::moved;
use crate::steps::pair::Pair;
use snake_core::Result;
use snake_geometry::Vector;

/// Places moved together if one slide brings this share of them onto each other. Unit: share of the
/// places. Posts beside a motorway, beside vehicles that drift, have 0.2 to 0.6.
const TOGETHER: f64 = 0.2;
/// Number of slides that are tried, at most. Half and twice change no outcome; things that moved alone come first.
const SLIDES_TOGETHER: usize = 40;
/// Places that moved together are a part of the scene, not one object, if they spread by at least this. Unit:
/// share of the cloud's spread. Posts beside a motorway have 0.315 to 0.63, one car 0.05, furniture up to 0.3.
const MIN_TOGETHER_SPREAD: f64 = 0.31;

/// A note on the most frequent slide that brings what a transform leaves apart onto each other, if this is a
/// good share of it and spread over the scene. Both clouds were seen from one place.
pub(super) fn together_note(pair: &Pair, transform: &IsometryMatrix3<f64>) -> Result<Option<String>> {
    let distance = pair.criteria().inlier_distance;
    let source = apart(pair, 0, transform)?;
    let target = apart(pair, 1, &transform.inverse())?;
    let source: Vec<Vector> = source.iter().map(|point| moved(transform, point)).collect();
    let grid = NearGrid::new(&target, 2.0 * DETAIL * distance);
    let min_spread = MIN_TOGETHER_SPREAD * spread(&pair.clouds()[1].voxels.voxels.points);
    let note = |slide: Vector| {
        let hits: Vec<Vector> =
            source.iter().map(|point| point + slide).filter(|point| grid.nearest(point).is_some()).collect();
        let share = hits.len() as f64 / source.len().min(target.len()) as f64;
        let [x, y, z] = (hits.iter().sum::<Vector>() / hits.len().max(1) as f64).into();
        (share >= TOGETHER && spread(&hits) >= min_spread).then(|| {
            format!(
                "ambiguous: {:.0} % of what contradicts the transform moved by {:.3} along {} as a whole, about ({x:.2}, {y:.2}, \
                 {z:.2}) of the target: either that part of the scene moved, or the sensor did",
                100.0 * share,
                slide.norm(),
                axis_name(&slide.normalize())
            )
        })
    };
    Ok(frequent_slides(&source, &target, distance).into_iter().find_map(note))
}

/// Places of a cloud that a transform does not bring onto the other cloud, although that cloud has
/// a surface near them or does not hide them.
fn apart(pair: &Pair, from: usize, transform: &IsometryMatrix3<f64>) -> Result<Vec<Vector>> {
    let (distance, fine) = (pair.criteria().inlier_distance, pair.fine()?);
    let Some(viewpoint) = pair.viewpoints()[1 - from] else { return Ok(Vec::new()) };
    let other = fine[1 - from];
    let image = DepthImage::new(other.points(), viewpoint.place(), distance, FINE);
    let places = fine[from].thinned(DETAIL * distance, usize::MAX).into_iter().filter(|place| {
        let place = place.moved(transform);
        match other.lies_on(&place, distance) {
            Some(is_on) => !is_on,
            None => matches!(image.sight(&place.point), Sight::Free | Sight::Unknown),
        }
    });
    let all: Vec<Vector> = places.map(|place| place.point).collect();
    Ok(all.iter().step_by(all.len().div_ceil(FEW_PLACES).max(1)).copied().collect())
}

/// The most frequent slides from places of one cloud to places of another, each the mean of a cell.
/// Slides that are too short for a rival are left out, and so are slides of few pairs.
fn frequent_slides(source: &[Vector], target: &[Vector], distance: f64) -> Vec<Vector> {
    let mut cells: HashMap<[i64; 3], (usize, Vector)> = HashMap::new();
    for from in source {
        for to in target {
            let slide = to - from;
            if slide.norm() > MIN_SHIFT * distance {
                let cell = slide.map(|v| (v / (2.0 * DETAIL * distance)).round() as i64);
                let (count, sum) = cells.entry(cell.into()).or_insert((0, Vector::zeros()));
                *count += 1;
                *sum += slide;
            }
        }
    }
    let mut slides: Vec<_> = cells.into_iter().filter(|(_, (count, _))| *count >= MIN_AGREEING).collect();
    slides.sort_by_key(|(cell, (count, _))| (usize::MAX - count, *cell));
    slides.truncate(SLIDES_TOGETHER);
    slides.into_iter().map(|(_, (count, sum))| sum / count as f64).collect()
}

/// The root mean square distance of points from their mean.
fn spread(points: &[Vector]) -> f64 {
    let count = points.len().max(1) as f64;
    let mean = points.iter().sum::<Vector>() / count;
    (points.iter().map(|point| (point - mean).norm_squared()).sum::<f64>() / count).sqrt()
}

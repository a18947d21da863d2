//! Keypoints of an object move onto its surface: as the points show it, or the field.

use nalgebra::Matrix3;
use rayon::prelude::*;

use super::localize::anchors;
use crate::Result;
use crate::field::Field;
use snake_geometry::{Point, RadiusCells, Vector, eigen, vector};

/// The radius in voxels within which the most salient place is looked for.
const SEARCH: f32 = 2.0;
/// The radius in voxels of the mean around it.
const MEAN: f32 = 2.0;
/// A point shows the surface if so many points, with itself, ...
const SHOWN_BY: usize = 5;
/// ... lie within this many voxels, and ...
const SHOWN_WITHIN: f64 = 0.7;
/// ... so many nearest points are this flat: the standard deviation across them is this share of the smaller one along them.
const FLAT: (usize, f64) = (16, 0.6);
/// Points that are asked, at most. Half of them decide.
const ASKED: usize = 300;
/// Of more points than this, ...
const MANY: usize = 8192;
/// ... one for each cell of this many voxels is a place.
const APART: f32 = 0.2;

/// Where a keypoint can lie.
struct Places<'a> {
    positions: &'a [Point],
    saliency: &'a [f32],
    /// The weight of each place in a mean.
    weights: Vec<f32>,
}

/// The positions of keypoints on the surface. From the most salient place nearby, each moves twice to the mean of the places
/// around it, weighted by a power of their saliency.
///
/// The places are the points themselves where they show the surface. Where they are sparse or have noise, the field knows the surface
/// better: the places are the candidates, which also count by the odds of their occupancy.
pub(super) fn on_surface(field: &Field, candidates: (&[Point], &[f32]), keypoints: &[Point]) -> Result<Vec<Point>> {
    if keypoints.is_empty() {
        return Ok(Vec::new());
    }
    let voxel = field.voxel_size();
    if is_shown(field.points(), voxel)? {
        let points = match field.points() {
            points if points.len() > MANY => &anchors(points, APART * voxel),
            points => points,
        };
        let near = near(points, keypoints, 2.0 * SEARCH * voxel)?;
        let saliency = field.saliency(&near)?;
        let weights = saliency.iter().map(|saliency| saliency.powi(4)).collect();
        return moved(&Places { positions: &near, saliency: &saliency, weights }, keypoints, voxel);
    }
    let (positions, saliency) = candidates;
    let odds = field.occupancy(positions)?.into_iter().map(|occupancy| occupancy / (1.0 - occupancy).max(1e-3));
    let weights = odds.zip(saliency).map(|(odds, saliency)| odds * saliency.powi(8)).collect();
    moved(&Places { positions, saliency, weights }, keypoints, voxel)
}

/// Whether points are dense and clean enough to show the surface.
fn is_shown(points: &[Point], voxel: f32) -> Result<bool> {
    let cells = RadiusCells::new(points, SEARCH * voxel)?;
    let shows = |point: &Point| {
        let mut near = Vec::new();
        cells.within(point, SEARCH * voxel, |index| {
            let offset = vector(points[index]) - vector(*point);
            near.push((offset.norm(), index, offset));
        });
        near.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let is_dense = near.get(SHOWN_BY - 1).is_some_and(|(distance, ..)| *distance < SHOWN_WITHIN * f64::from(voxel));
        let (number, flatness) = FLAT;
        near.truncate(number);
        let count = near.len() as f64;
        let mean = near.iter().map(|(_, _, offset)| offset).sum::<Vector>() / count;
        let scatter: Matrix3<f64> =
            near.iter().map(|(_, _, offset)| (offset - mean) * (offset - mean).transpose()).sum();
        let ([across, width, _], _) = eigen(scatter / count);
        is_dense && across < flatness * flatness * width
    };
    let asked: Vec<&Point> = points.iter().step_by(points.len().div_ceil(ASKED).max(1)).collect();
    let number = asked.par_iter().filter(|point| shows(point)).count();
    Ok(2 * number > asked.len())
}

/// The points near some keypoints, in their order.
fn near(points: &[Point], keypoints: &[Point], radius: f32) -> Result<Vec<Point>> {
    let cells = RadiusCells::new(keypoints, radius)?;
    let is_near = |point: &&Point| {
        let mut is_near = false;
        cells.within(point, radius, |_| is_near = true);
        is_near
    };
    Ok(points.iter().filter(is_near).copied().collect())
}

fn moved(places: &Places, keypoints: &[Point], voxel: f32) -> Result<Vec<Point>> {
    let cells = RadiusCells::new(places.positions, SEARCH * voxel)?;
    let on_surface = |keypoint: &Point| {
        let mut best: Option<usize> = None;
        cells.within(keypoint, SEARCH * voxel, |index| {
            let is_better = |other: usize| {
                let [a, b] = [index, other].map(|place| places.saliency[place]);
                a > b || a == b && index < other
            };
            if best.is_none_or(is_better) {
                best = Some(index);
            }
        });
        let Some(best) = best else { return *keypoint };
        let start = places.positions[best];
        (0..2).fold(start, |at, _| super::modes::weighted_mean(&cells, &places.weights, at, MEAN * voxel))
    };
    Ok(keypoints.par_iter().map(on_surface).collect())
}

//! Whether the clouds fit better with the source larger or smaller.

use nalgebra::{IsometryMatrix3, Matrix6, Rotation3, Translation3, Vector6};

use crate::cloud::planes::{PlanePair, twist};
use crate::cloud::surface::Surface;
use crate::rigid::moved;
use snake_geometry::{Vector, some_in_parallel};

/// Number of the source's voxels that tell its scale, at most. Set for time.
const SCALE_POINTS: usize = 1500;
/// Number of steps to the factor, at most. Set by hand.
const SCALE_STEPS: usize = 12;
/// A factor that differs from 1 by less after one step is not pursued. Unit: ratio. Set for time.
const SCALE_GATE: f64 = 0.003;
/// Smallest number of pairs of voxels that determine the scale. Set by hand.
const MIN_SCALE_PAIRS: usize = 100;
/// Planes determine the scale if this much of their squared distance under a change of scale remains after the
/// best rigid motion. Three walls of a room fit at any scale. Unit: squared extents of the pairs. Set by hand.
const MIN_SCALE_SHARE: f64 = 0.02;
/// A smaller difference from 1 is not noted. Unit: ratio. The smallest that matters.
const MIN_SCALE: f64 = 0.01;
/// A factor differs from 1 if the difference exceeds this many of its standard deviations. Set by hand.
const SCALE_DEVIATIONS: f64 = 5.0;
/// The factor is found when a step changes it by less. Unit: ratio. Set by hand.
const SCALE_TOLERANCE: f64 = 1e-4;
/// Largest share of the mean squared distance that remains with the factor. Set on training scenes
/// and objects of true scale.
const SCALE_GAIN: f64 = 0.6;
/// Largest change of the factor by one half of the overlap. Unit: share of the change. Set on
/// training scenes and objects of true scale.
const SCALE_DISAGREEMENT: f64 = 0.2;

/// A scale factor for the source, followed by a rigid transform.
#[derive(Debug, Clone, Copy)]
struct Similarity {
    factor: f64,
    transform: IsometryMatrix3<f64>,
}

/// The least-squares change of a similarity.
struct Step {
    factor: f64,
    rigid: IsometryMatrix3<f64>,
    /// Standard deviation of the factor.
    deviation: f64,
}

/// A note with the factor by which the source must be enlarged to fit better, if it differs from 1 beyond doubt. Each
/// half of the overlap must confirm it: a bent scan also fits better at another scale, but in some places only.
pub(super) fn scale_note(surfaces: &[Surface; 2], transform: &IsometryMatrix3<f64>) -> Option<String> {
    let before = Similarity { factor: 1.0, transform: *transform }.pairs(surfaces);
    if (step(&before)?.factor - 1.0).abs() < SCALE_GATE {
        return None;
    }
    let (similarity, deviation) = similarity(surfaces, transform)?;
    let after = similarity.pairs(surfaces);
    let change = similarity.factor - 1.0;
    let is_better = mean_squared(&after) < SCALE_GAIN * mean_squared(&before);
    let is_certain = change.abs() > MIN_SCALE.max(SCALE_DEVIATIONS * deviation);
    let agrees = |half: &Vec<PlanePair>| {
        step(half).is_some_and(|own| (own.factor - 1.0).abs() < SCALE_DISAGREEMENT * change.abs())
    };
    (is_certain && is_better && halves(&after).iter().all(agrees)).then(|| {
        let advice = "check the calibration and the units, or set `estimate_scale`";
        format!("the clouds fit better with the source {:.3} times as large: {advice}", similarity.factor)
    })
}

/// The factor by which the source must be enlarged to fit best; `None` if the clouds do not determine it.
pub(crate) fn best_scale(surfaces: &[Surface; 2], transform: &IsometryMatrix3<f64>) -> Option<f64> {
    similarity(surfaces, transform).map(|(similarity, _)| similarity.factor)
}

/// The similarity near a rigid transform that fits best, with the standard deviation of its factor.
fn similarity(surfaces: &[Surface; 2], transform: &IsometryMatrix3<f64>) -> Option<(Similarity, f64)> {
    let mut similarity = Similarity { factor: 1.0, transform: *transform };
    let mut last = step(&similarity.pairs(surfaces))?;
    for _ in 0..SCALE_STEPS {
        if (last.factor - 1.0).abs() < SCALE_TOLERANCE {
            break;
        }
        similarity = similarity.after(&last);
        last = step(&similarity.pairs(surfaces))?;
    }
    Some((similarity, last.deviation))
}

/// The mean squared distance to the planes.
fn mean_squared(pairs: &[PlanePair]) -> f64 {
    pairs.iter().map(|pair| pair.distance * pair.distance).sum::<f64>() / pairs.len().max(1) as f64
}

/// The pairs on either side of their mean, along each axis.
fn halves(pairs: &[PlanePair]) -> Vec<Vec<PlanePair>> {
    let center = pairs.iter().map(|pair| pair.point).sum::<Vector>() / pairs.len().max(1) as f64;
    let sides = (0..3).flat_map(|axis| [1.0, -1.0].map(|sign| (axis, sign)));
    let half = |(axis, sign): (usize, f64)| {
        pairs.iter().filter(|pair| sign * (pair.point - center)[axis] > 0.0).copied().collect()
    };
    sides.map(half).collect()
}

impl Similarity {
    /// This similarity, then a step in the target's frame.
    fn after(&self, step: &Step) -> Self {
        let Step { factor, rigid, .. } = step;
        let translation = rigid.translation.vector + rigid.rotation * (*factor * self.transform.translation.vector);
        let rotation = rigid.rotation * self.transform.rotation;
        let transform = IsometryMatrix3::from_parts(Translation3::from(translation), rotation);
        Self { factor: factor * self.factor, transform }
    }

    /// Points of the source and the planes of the target next to them, where their normals agree.
    fn pairs(&self, [source, target]: &[Surface; 2]) -> Vec<PlanePair> {
        let step = source.points.len().div_ceil(SCALE_POINTS);
        let pair = |index: usize| {
            let point = moved(&self.transform, &(self.factor * source.points[index]));
            let (nearest, _) = target.grid.nearest(&point)?;
            let rotated = self.transform.rotation * source.normals[index];
            let normal = target.common_normal(&rotated, &target.normals[nearest])?;
            Some(PlanePair { point, normal, distance: normal.dot(&(target.points[nearest] - point)) })
        };
        some_in_parallel((0..source.points.len()).step_by(step), pair)
    }
}

/// The step onto the planes by a small rigid motion and a change of scale about the mean; `None` if
/// the planes do not determine it.
fn step(pairs: &[PlanePair]) -> Option<Step> {
    let count = pairs.len() as f64;
    let center = pairs.iter().map(|pair| pair.point).sum::<Vector>() / count.max(1.0);
    let extent = (pairs.iter().map(|pair| (pair.point - center).norm_squared()).sum::<f64>() / count).sqrt();
    let (mut information, mut coupling, mut residuals) = (Matrix6::zeros(), Vector6::zeros(), Vector6::zeros());
    let (mut scales, mut along, mut squared) = (0.0, 0.0, 0.0);
    for PlanePair { point, normal, distance } in pairs {
        let offset = (point - center) / extent;
        let row = twist(&offset, normal);
        let scale = normal.dot(&offset);
        information += row * row.transpose();
        coupling += row * scale;
        residuals += row * *distance;
        (scales, along, squared) = (scales + scale * scale, along + scale * distance, squared + distance * distance);
    }
    let inverse = information.try_inverse()?;
    // The part of a change of scale that no rigid motion can make.
    let own = scales - coupling.dot(&(inverse * coupling));
    if pairs.len() < MIN_SCALE_PAIRS || own < MIN_SCALE_SHARE * count {
        return None;
    }
    let change = (along - coupling.dot(&(inverse * residuals))) / own;
    let motion = inverse * (residuals - coupling * change);
    let after = squared - motion.dot(&residuals) - change * along;
    let rotation = Rotation3::new(motion.fixed_rows::<3>(0) / extent);
    let factor = 1.0 + change / extent;
    // The source is enlarged about its origin, the pairs about their mean.
    let translation = center - rotation * (factor * center) + motion.fixed_rows::<3>(3);
    let rigid = IsometryMatrix3::from_parts(Translation3::from(translation), rotation);
    let deviation = (after.max(0.0) / count / own).sqrt() / extent;
    Some(Step { factor, rigid, deviation })
}

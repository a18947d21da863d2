//! Mode seeking: keypoints move to where salient candidates are densest.

use crate::Result;
use snake_geometry::{Point, RadiusCells, by_falling_score, in_parallel, keep_in_order};

/// The steps of the mean shift. Each step takes the mean of the candidates within a share of the radius, weighted
/// by a power of their saliency. With a power of 8, a candidate a tenth less salient weighs about half as much. A
/// mean over a wide neighbourhood lies inside a corner, so later steps are narrower and end nearer to the peak.
const STEPS: [(f32, i32); 3] = [(1.0, 8), (0.85, 12), (0.7, 16)];

/// The best candidate of a mode is searched within this share of the radius around it.
const SCORE_SHARE: f32 = 0.5;

/// Only candidates within this many radii of its start affect a mode: three steps, then the search for the best one.
pub(crate) const SHIFT: f32 = 3.1;

/// Number of candidates that are moved per keypoint, because several of them end at the same mode. For fewer
/// than 64 keypoints, as many are moved as for 64, because the most salient candidates lie close together.
const STARTS: usize = 32;

/// Candidates after they moved to modes, ordered by falling saliency at their starts.
pub(crate) struct Modes {
    /// Their new positions.
    pub(crate) positions: Vec<Point>,
    /// The mean of the saliency at the start of a candidate and the highest saliency near its end. The end distinguishes
    /// modes on a peak from those that stopped on a ridge; the start distinguishes modes on the same peak.
    pub(crate) scores: Vec<f32>,
}

/// Moves the most salient candidates, at least `apart` from each other, to modes by mean shift (Comaniciu
/// and Meer 2002). Each of three steps moves a candidate to the mean of the candidates within `radius`,
/// weighted by a power of their saliency. From step to step the radius falls and the power rises.
///
/// A mean over a neighbourhood is more precise than the position of a single query. Modes can coincide, so they are
/// suppressed afterwards.
///
/// # Errors
/// [`crate::Error::Input`] for more candidates than [`u32::MAX`].
pub(crate) fn seek_modes(
    positions: &[Point],
    scores: &[f32],
    [radius, apart]: [f32; 2],
    max_keypoints: usize,
) -> Result<Modes> {
    let starts = starts(&RadiusCells::new(positions, apart)?, scores, max_keypoints);
    let (positions, scores) = modes_of(positions, scores, radius, &starts)?;
    Ok(Modes { positions, scores })
}

/// The indices of the candidates that are moved, by falling saliency.
fn starts(cells: &RadiusCells, scores: &[f32], max_keypoints: usize) -> Vec<usize> {
    let max_number = STARTS.saturating_mul(max_keypoints.max(64));
    keep_in_order(cells, &by_falling_score(scores), cells.radius(), max_number)
}

/// The modes of some candidates with their scores, see [`seek_modes`].
pub(crate) fn modes_of(
    positions: &[Point],
    scores: &[f32],
    radius: f32,
    starts: &[usize],
) -> Result<(Vec<Point>, Vec<f32>)> {
    Ok(shift(&RadiusCells::new(positions, radius)?, scores, starts))
}

fn shift(cells: &RadiusCells, scores: &[f32], starts: &[usize]) -> (Vec<Point>, Vec<f32>) {
    let radius = cells.radius();
    let weights = STEPS.map(|(_, power)| scores.iter().map(|score| score.powi(power)).collect::<Vec<_>>());
    let modes = in_parallel(starts.iter(), |&start| {
        let mut mode = cells.points()[start];
        for ((share, _), weights) in STEPS.iter().zip(&weights) {
            mode = weighted_mean(cells, weights, mode, share * radius);
        }
        let mut best = scores[start];
        cells.within(&mode, SCORE_SHARE * radius, |index| best = best.max(scores[index]));
        (mode, 0.5 * (scores[start] + best))
    });
    modes.into_iter().unzip()
}

/// The weighted mean of the points within `radius` of a position; the position itself if all weights are zero.
pub(super) fn weighted_mean(cells: &RadiusCells, weights: &[f32], at: Point, radius: f32) -> Point {
    let (mut total, mut sum) = (0.0_f64, [0.0_f64; 3]);
    cells.within(&at, radius, |index| {
        let weight = f64::from(weights[index]);
        total += weight;
        sum.iter_mut().zip(cells.points()[index]).for_each(|(sum, value)| *sum += weight * f64::from(value));
    });
    if total > 0.0 { sum.map(|value| (value / total) as f32) } else { at }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The mean shift with sums over all candidates: the position and the score of a mode.
    fn plain(positions: &[Point], scores: &[f32], start: usize, radius: f32) -> (Point, f32) {
        let is_near = |p: &Point, at: &Point, radius: f32| {
            (0..3).map(|axis| (p[axis] - at[axis]).powi(2)).sum::<f32>() <= radius.powi(2)
        };
        let mode = [(1.0, 8), (0.85, 12), (0.7, 16)].into_iter().fold(positions[start], |at, (share, power)| {
            let weight = |p: &Point, s: f32| f64::from(s).powi(power) * f64::from(is_near(p, &at, share * radius));
            let weights: Vec<f64> = positions.iter().zip(scores).map(|(p, &s)| weight(p, s)).collect();
            let total: f64 = weights.iter().sum();
            std::array::from_fn(|axis| {
                (positions.iter().zip(&weights).map(|(p, w)| w * f64::from(p[axis])).sum::<f64>() / total) as f32
            })
        });
        let there = positions.iter().zip(scores).filter(|(p, _)| is_near(p, &mode, 0.5 * radius)).map(|(_, &s)| s);
        (mode, 0.5 * (scores[start] + there.fold(scores[start], f32::max)))
    }

    fn candidates() -> (Vec<Point>, Vec<f32>) {
        let at = |i: u32, k: u32| (i * k % 997) as f32 / 997.0;
        let positions: Vec<Point> = (0_u32..800).map(|i| [at(i, 131), at(i, 577), at(i, 883)]).collect();
        let scores = (0_u32..800).map(|i| 0.2 + 0.8 * at(i, 311)).collect();
        (positions, scores)
    }

    #[test]
    fn modes_are_those_of_the_plain_mean_shift() {
        let (positions, scores) = candidates();
        let modes = seek_modes(&positions, &scores, [0.3, 0.15], 100).unwrap();
        let starts = starts(&RadiusCells::new(&positions, 0.15).unwrap(), &scores, 100);
        assert!(starts.len() > 10 && starts.is_sorted_by(|&a, &b| scores[a] >= scores[b]));
        assert_eq!(starts.len(), modes.positions.len());
        for (i, &start) in starts.iter().enumerate() {
            let (expected, score) = plain(&positions, &scores, start, 0.3);
            let mode = modes.positions[i];
            assert!((0..3).all(|axis| (mode[axis] - expected[axis]).abs() < 1e-5), "{mode:?} {expected:?}");
            assert_eq!(modes.scores[i], score, "{mode:?}");
        }
    }

    #[test]
    fn modes_of_no_candidates_one_candidate_and_scores_of_zero() {
        let modes = |positions: &[Point], scores: &[f32]| {
            let Modes { positions, scores } = seek_modes(positions, scores, [0.1, 0.05], 9).unwrap();
            (positions, scores)
        };
        assert_eq!(modes(&[], &[]), (vec![], vec![]));
        assert_eq!(modes(&[[1.0, 2.0, 3.0]], &[0.5]), (vec![[1.0, 2.0, 3.0]], vec![0.5]));
        assert_eq!(modes(&[[1.0, 2.0, 3.0]], &[0.0]), (vec![[1.0, 2.0, 3.0]], vec![0.0]));
    }
}

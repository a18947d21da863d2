//! Mode seeking: keypoints move to where salient candidates are densest.

use rayon::prelude::*;

use crate::Result;
use crate::nms::{by_falling_score, keep_in_order};
use crate::points::Point;
use crate::radius_cells::RadiusCells;
use snake_kernels::Scratch;

/// The steps of the mean shift: the share of the radius within which candidates count, and the power of their saliency that
/// weighs them. With a power of 8, a candidate a tenth less salient weighs half as much. A mean over a wide neighbourhood lies
/// inside of a corner; later steps come nearer to the peak.
const STEPS: [(f32, i32); 3] = [(1.0, 8), (0.85, 12), (0.7, 16)];

/// Number of candidates that are moved per keypoint, because several of them end at the same mode. For fewer than 64
/// keypoints the number is that of 64, because the most salient candidates lie close together.
const STARTS: usize = 16;

/// Moves the most salient candidates, at least half of `radius` apart, to modes by mean shift (Comaniciu and Meer 2002):
/// three times to the mean of the candidates within `radius`, weighted by a power of their saliency. From step to step the
/// radius falls and the power rises. Returns the indices of these candidates and their new positions.
///
/// A mean over a neighbourhood is more precise than the position of a single query. Modes can coincide, so they are
/// suppressed afterwards.
///
/// # Errors
/// [`crate::Error::Input`] when a position is not finite.
pub(crate) fn seek_modes(
    positions: &[Point],
    scores: &[f32],
    radius: f32,
    max_keypoints: usize,
) -> Result<(Scratch<usize>, Scratch<Point>)> {
    let cells = RadiusCells::new(positions, radius)?;
    let most = STARTS.saturating_mul(max_keypoints.max(64));
    let starts = keep_in_order(&cells, &by_falling_score(scores), radius / 2.0, most);
    let weights = STEPS.map(|(_, power)| Scratch::collect(scores.len(), scores.iter().map(|score| score.powi(power))));
    let mut modes = Scratch::collect(starts.len(), starts.iter().map(|&start| positions[start]));
    modes.par_iter_mut().for_each(|mode| {
        for ((share, _), weights) in STEPS.iter().zip(&weights) {
            *mode = weighted_mean(&cells, weights, *mode, share * radius);
        }
    });
    Ok((starts, modes))
}

/// The mean of the candidates within `radius` of a position; the position itself if there is none.
fn weighted_mean(cells: &RadiusCells, weights: &[f32], at: Point, radius: f32) -> Point {
    let mut near = Scratch::empty(256);
    cells.within(&at, radius, |index| near.extend_from_slice(&[index]));
    near.sort_unstable(); // the order of the sum decides its last bits
    let (mut total, mut sum) = (0.0_f64, [0.0_f64; 3]);
    for &index in &near[..] {
        let weight = f64::from(weights[index]);
        total += weight;
        sum.iter_mut().zip(cells.points()[index]).for_each(|(sum, value)| *sum += weight * f64::from(value));
    }
    if total > 0.0 { sum.map(|value| (value / total) as f32) } else { at }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The mean shift with sums over all candidates.
    fn plain(positions: &[Point], scores: &[f32], at: Point, radius: f32) -> Point {
        [(1.0, 8), (0.85, 12), (0.7, 16)].into_iter().fold(at, |at, (share, power)| {
            let weight = |p: &Point, s: f32| {
                let squared: f32 = (0..3).map(|axis| (p[axis] - at[axis]).powi(2)).sum();
                if squared <= (share * radius).powi(2) { f64::from(s).powi(power) } else { 0.0 }
            };
            let weights: Vec<f64> = positions.iter().zip(scores).map(|(p, &s)| weight(p, s)).collect();
            let total: f64 = weights.iter().sum();
            std::array::from_fn(|axis| {
                (positions.iter().zip(&weights).map(|(p, w)| w * f64::from(p[axis])).sum::<f64>() / total) as f32
            })
        })
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
        let (starts, modes) = seek_modes(&positions, &scores, 0.3, 100).unwrap();
        assert!(starts.len() > 10 && starts.is_sorted_by(|&a, &b| scores[a] >= scores[b]));
        for (&start, mode) in starts.iter().zip(modes.iter()) {
            let expected = plain(&positions, &scores, positions[start], 0.3);
            assert!((0..3).all(|axis| (mode[axis] - expected[axis]).abs() < 1e-5), "{mode:?} {expected:?}");
        }
    }

    #[test]
    fn a_bump_is_found_between_grid_points() {
        let center = [0.031, -0.012, 0.007];
        let grid = |i: u32| (i as f32 - 8.0) * 0.03;
        let positions: Vec<Point> = (0..4096).map(|i| [grid(i % 16), grid(i / 16 % 16), grid(i / 256)]).collect();
        let squared = |p: &Point| (0..3).map(|axis| (p[axis] - center[axis]).powi(2)).sum::<f32>();
        let scores: Vec<f32> = positions.iter().map(|p| (-squared(p) / (2.0 * 0.05_f32.powi(2))).exp()).collect();
        let (_, modes) = seek_modes(&positions, &scores, 0.06, 100).unwrap();
        assert!(squared(&modes[0]).sqrt() < 0.005, "{:?}", modes[0]);
    }

    #[test]
    fn modes_of_no_candidates_one_candidate_and_scores_of_zero() {
        let modes = |positions: &[Point], scores: &[f32]| {
            let (starts, modes) = seek_modes(positions, scores, 0.1, 9).unwrap();
            (starts.to_vec(), modes.to_vec())
        };
        assert_eq!(modes(&[], &[]), (vec![], vec![]));
        assert_eq!(modes(&[[1.0, 2.0, 3.0]], &[0.5]), (vec![0], vec![[1.0, 2.0, 3.0]]));
        assert_eq!(modes(&[[1.0, 2.0, 3.0]], &[0.0]), (vec![0], vec![[1.0, 2.0, 3.0]]));
    }
}

//! Mode seeking: keypoints move to where salient candidates are densest.

use rayon::prelude::*;

use crate::Result;
use crate::kd_tree::KdTree;
use crate::nms::suppress_in;
use crate::points::Point;

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
) -> Result<(Vec<usize>, Vec<Point>)> {
    if positions.is_empty() {
        return Ok((Vec::new(), Vec::new()));
    }
    let tree = KdTree::new(positions)?;
    let starts = suppress_in(&tree, positions, scores, radius / 2.0, STARTS.saturating_mul(max_keypoints.max(64)));
    let weights = STEPS.map(|(_, power)| scores.iter().map(|score| score.powi(power)).collect::<Vec<f32>>());
    let mode = |near: &mut Vec<usize>, &start: &usize| {
        let step = |at, ((share, _), weights): (_, &Vec<f32>)| {
            weighted_mean(&tree, positions, weights, at, share * radius, near)
        };
        STEPS.into_iter().zip(&weights).fold(positions[start], step)
    };
    let modes = starts.par_iter().map_init(Vec::new, mode).collect();
    Ok((starts, modes))
}

/// The mean of the candidates within `radius` of a position; the position itself if there is none. `near` is memory for
/// their indices.
fn weighted_mean(
    tree: &KdTree<f32>,
    positions: &[Point],
    weights: &[f32],
    at: Point,
    radius: f32,
    near: &mut Vec<usize>,
) -> Point {
    near.clear();
    tree.within(&at, radius * radius, |index, _| near.push(index));
    near.sort_unstable(); // the order of the sum decides its last bits
    let (mut total, mut sum) = (0.0_f64, [0.0_f64; 3]);
    for &index in &*near {
        let weight = f64::from(weights[index]);
        total += weight;
        sum.iter_mut().zip(positions[index]).for_each(|(sum, value)| *sum += weight * f64::from(value));
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
        for (&start, mode) in starts.iter().zip(&modes) {
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
        assert_eq!(seek_modes(&[], &[], 0.1, 9).unwrap(), (vec![], vec![]));
        assert_eq!(seek_modes(&[[1.0, 2.0, 3.0]], &[0.5], 0.1, 9).unwrap(), (vec![0], vec![[1.0, 2.0, 3.0]]));
        assert_eq!(seek_modes(&[[1.0, 2.0, 3.0]], &[0.0], 0.1, 9).unwrap(), (vec![0], vec![[1.0, 2.0, 3.0]]));
    }
}

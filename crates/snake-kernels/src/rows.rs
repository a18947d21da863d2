//! Sums, maxima and ReLUs of feature rows. Each is a plain loop, so all levels give the same bits.

use crate::simd::{Lanes, simd_levels};

simd_levels! {
    /// Writes the ReLU of each input to the output.
    pub fn relu(input: &[f32], output: &mut [f32]) = relu_body
}

#[inline(always)]
fn relu_body<L: Lanes, const ROWS: usize>(_: L::Token, input: &[f32], output: &mut [f32]) {
    output.iter_mut().zip(input).for_each(|(output, value)| *output = value.max(0.0));
}

simd_levels! {
    /// Updates the rows of `maxima`, of `width` values each: row `targets[i]` becomes the element-wise maximum of itself and
    /// row i of `features`.
    ///
    /// # Panics
    /// If a target is not a row of `maxima`.
    pub fn max_rows(features: &[f32], width: usize, targets: &[usize], maxima: &mut [f32]) = max_rows_body
}

#[inline(always)]
fn max_rows_body<L: Lanes, const ROWS: usize>(
    _: L::Token,
    features: &[f32],
    width: usize,
    targets: &[usize],
    maxima: &mut [f32],
) {
    for (feature, &target) in features.chunks_exact(width).zip(targets) {
        let maxima = &mut maxima[target * width..][..width];
        maxima.iter_mut().zip(feature).for_each(|(most, value)| *most = most.max(*value));
    }
}

simd_levels! {
    /// Adds one feature, times the weight of each row, to the eight rows `targets` of `sums`. A row of `sums` is one value
    /// longer than the feature; the last value is the sum of the weights.
    ///
    /// # Panics
    /// If a target is not a row of `sums`.
    pub fn add_weighted(feature: &[f32], weights: &[f32; 8], targets: &[usize; 8], sums: &mut [f32]) = add_weighted_body
}

#[inline(always)]
fn add_weighted_body<L: Lanes, const ROWS: usize>(
    _: L::Token,
    feature: &[f32],
    weights: &[f32; 8],
    targets: &[usize; 8],
    sums: &mut [f32],
) {
    let width = feature.len() + 1;
    for (&target, weight) in targets.iter().zip(weights) {
        let row = &mut sums[target * width..][..width];
        row.iter_mut().zip(feature).for_each(|(sum, value)| *sum += weight * value);
        row[width - 1] += weight;
    }
}

simd_levels! {
    /// Finds the point that is nearest to a query and writes its index to `best`. The lowest index wins ties; without points
    /// the index is 0.
    pub fn nearest_row(points: &[[f32; 3]], query: [f32; 3], best: &mut usize) = nearest_row_body
}

#[inline(always)]
fn nearest_row_body<L: Lanes, const ROWS: usize>(_: L::Token, points: &[[f32; 3]], query: [f32; 3], best: &mut usize) {
    const RUN: usize = 64;
    let mut least = f32::INFINITY;
    *best = 0;
    for (run, points) in points.chunks(RUN).enumerate() {
        let mut distances = [f32::INFINITY; RUN];
        for (distance, point) in distances.iter_mut().zip(points) {
            let [x, y, z] = [point[0] - query[0], point[1] - query[1], point[2] - query[2]];
            *distance = x * x + y * y + z * z;
        }
        let least_of_run = distances.iter().fold(f32::INFINITY, |least, &d| if d < least { d } else { least });
        if least_of_run < least {
            least = least_of_run;
            *best = run * RUN + distances.iter().position(|&d| d == least).unwrap_or(0);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{SimdLevel, naive};

    #[test]
    fn every_level_has_the_bits_of_the_plain_loop() {
        let mut random = naive::Random::new(7);
        for width in [1, 5, 16, 32, 33] {
            let features = random.values(6 * width);
            let targets = [1, 0, 1, 1, 2, 0];
            let (start, weights) = (random.values(3 * width), std::array::from_fn(|i| i as f32 * 0.1));
            let (mut maxima, mut sums) = (start.clone(), vec![0.0; 4 * (width + 1)]);
            for (row, &target) in targets.iter().enumerate() {
                for i in 0..width {
                    let most = &mut maxima[target * width + i];
                    *most = most.max(features[row * width + i]);
                }
            }
            let corners = [3, 1, 1, 0, 2, 2, 0, 3];
            for (corner, weight) in corners.iter().zip(weights) {
                for i in 0..width {
                    sums[corner * (width + 1) + i] += weight * features[i];
                }
                sums[corner * (width + 1) + width] += weight;
            }
            for level in SimdLevel::available() {
                let mut result = start.clone();
                max_rows(level, &features, width, &targets, &mut result);
                assert_eq!(result, maxima, "{level:?} {width}");
                let mut result = vec![0.0; sums.len()];
                add_weighted(level, &features[..width], &weights, &corners, &mut result);
                assert_eq!(result, sums, "{level:?} {width}");
                let mut result = vec![f32::NAN; features.len()];
                relu(level, &features, &mut result);
                assert_eq!(result, features.iter().map(|v| v.max(0.0)).collect::<Vec<_>>(), "{level:?} {width}");
            }
        }
    }

    #[test]
    fn every_level_finds_the_first_of_the_nearest() {
        let points: Vec<[f32; 3]> = (0_u16..200).map(|i| [i % 5, i % 7, i % 3].map(f32::from)).collect();
        for level in SimdLevel::available() {
            let nearest = |points: &[[f32; 3]], query| {
                let mut best = usize::MAX;
                nearest_row(level, points, query, &mut best);
                best
            };
            for (index, point) in points.iter().enumerate() {
                let first = points.iter().position(|other| other == point).unwrap();
                assert_eq!(nearest(&points, *point), first, "{level:?} {index}");
            }
            assert_eq!([nearest(&points[..1], [9.0; 3]), nearest(&[], [0.0; 3])], [0, 0]);
        }
    }
}

//! Trilinear interpolation of feature rows.

use crate::simd::{LANES, Lanes, load, simd_levels, store};

/// The eight voxels around a query, and the position of the query between them.
#[derive(Debug, Clone, Copy, Default)]
pub struct Corners {
    /// Flat voxel indices. Bit 0 of a corner's number is x, bit 1 is y, bit 2 is z.
    pub voxels: [u32; 8],
    /// Position within the cell along x, y, z, in [0, 1].
    pub fraction: [f32; 3],
}

impl Corners {
    /// The weight of each corner: a product over the axes of the fraction or its complement.
    #[inline(always)]
    pub fn weights(&self) -> [f32; 8] {
        let [x, y, z] = self.fraction;
        let [x, y, z] = [[1.0 - x, x], [1.0 - y, y], [1.0 - z, z]];
        let mut weights = [0.0; 8];
        for (corner, weight) in weights.iter_mut().enumerate() {
            *weight = x[corner & 1] * y[corner >> 1 & 1] * z[corner >> 2];
        }
        weights
    }

    /// Derivatives of the weights along x, y and z, per voxel.
    #[inline(always)]
    fn slopes(&self) -> [[f32; 3]; 8] {
        let [x, y, z] = self.fraction;
        let [x, y, z] = [[1.0 - x, x], [1.0 - y, y], [1.0 - z, z]];
        let sign = [-1.0, 1.0];
        let mut slopes = [[0.0; 3]; 8];
        for (corner, slope) in slopes.iter_mut().enumerate() {
            let [i, j, k] = [corner & 1, corner >> 1 & 1, corner >> 2];
            *slope = [sign[i] * y[j] * z[k], x[i] * sign[j] * z[k], x[i] * y[j] * sign[k]];
        }
        slopes
    }
}

simd_levels! {
    /// Interpolates `volume`, (voxels, channels), at each query; `features` is (queries, channels).
    ///
    /// # Panics
    /// If a corner lies outside the volume.
    pub fn interpolate(volume: &[f32], channels: usize, corners: &[Corners], features: &mut [f32]) = interpolate_body
}

#[inline(always)]
fn interpolate_body<L: Lanes, const ROWS: usize>(
    token: L::Token,
    volume: &[f32],
    channels: usize,
    corners: &[Corners],
    features: &mut [f32],
) {
    for (query, (at, feature)) in corners.iter().zip(features.chunks_exact_mut(channels)).enumerate() {
        // Rows of different queries lie far apart in memory, so the rows of a later query are prefetched.
        if let Some(later) = corners.get(query + 8) {
            for &voxel in &later.voxels {
                for line in (0..channels).step_by(LANES) {
                    L::prefetch(volume.as_ptr().wrapping_add(voxel as usize * channels + line));
                }
            }
        }
        let weights = at.weights();
        for (block, feature) in feature.chunks_mut(LANES).enumerate() {
            let mut sum = L::splat(token, 0.0);
            for (&voxel, &weight) in at.voxels.iter().zip(&weights) {
                let row = &volume[voxel as usize * channels + block * LANES..];
                sum = L::splat(token, weight).multiply_add(load(token, row, feature.len()), sum);
            }
            store(sum, feature, feature.len());
        }
    }
}

simd_levels! {
    /// Propagates `in_feature`, the gradient with respect to the features (queries, channels), back to the queries.
    /// The results are derivatives along x, y and z, per voxel.
    ///
    /// # Panics
    /// If a corner lies outside the volume.
    pub fn interpolate_backward(
        volume: &[f32], channels: usize, corners: &[Corners], in_feature: &[f32], gradients: &mut [[f32; 3]],
    ) = interpolate_backward_body
}

#[inline(always)]
fn interpolate_backward_body<L: Lanes, const ROWS: usize>(
    token: L::Token,
    volume: &[f32],
    channels: usize,
    corners: &[Corners],
    in_feature: &[f32],
    gradients: &mut [[f32; 3]],
) {
    let rows = in_feature.chunks_exact(channels).zip(gradients);
    for (corners, (in_feature, gradient)) in corners.iter().zip(rows) {
        let slopes = corners.slopes();
        let mut sums = [L::splat(token, 0.0); 3];
        for (block, in_feature) in in_feature.chunks(LANES).enumerate() {
            let mut slopes_of_feature = [L::splat(token, 0.0); 3];
            for (&voxel, slope) in corners.voxels.iter().zip(&slopes) {
                let row = load::<L>(token, &volume[voxel as usize * channels + block * LANES..], in_feature.len());
                for axis in 0..3 {
                    slopes_of_feature[axis] = L::splat(token, slope[axis]).multiply_add(row, slopes_of_feature[axis]);
                }
            }
            let in_feature = load(token, in_feature, in_feature.len());
            for axis in 0..3 {
                sums[axis] = slopes_of_feature[axis].multiply_add(in_feature, sums[axis]);
            }
        }
        for axis in 0..3 {
            gradient[axis] = sum_of_lanes(sums[axis].to_array());
        }
    }
}

/// Sums the lanes by adding halves pairwise.
#[inline(always)]
fn sum_of_lanes(mut values: [f32; LANES]) -> f32 {
    let mut half = LANES / 2;
    while half > 0 {
        for i in 0..half {
            values[i] += values[i + half];
        }
        half /= 2;
    }
    values[0]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{SimdLevel, naive};

    #[test]
    fn every_level_is_exact_on_a_trilinear_function() {
        // a + b x + c y + d z + e x y z is reproduced exactly by trilinear interpolation within a cell.
        let function = |[x, y, z]: [f32; 3]| 0.3 + 0.5 * x - 0.7 * y + 0.9 * z + 0.4 * x * y * z;
        let mut random = naive::Random::new(4);
        for channels in [1, 7, 16, 33] {
            let corner_value = |corner: usize| function(std::array::from_fn(|axis| (corner >> axis & 1) as f32));
            let volume: Vec<f32> =
                (0..8 * channels).map(|i| corner_value(i / channels) * (i % channels) as f32).collect();
            let fraction: [f32; 3] = std::array::from_fn(|_| random.values(1)[0].abs());
            let corners = Corners { voxels: std::array::from_fn(|corner| corner as u32), fraction };
            let expected: Vec<f32> = (0..channels).map(|channel| function(fraction) * channel as f32).collect();
            let in_feature = random.values(channels);
            let total: f32 = in_feature.iter().enumerate().map(|(channel, g)| channel as f32 * g).sum();
            let [x, y, z] = fraction;
            let slopes = [0.5 + 0.4 * y * z, -0.7 + 0.4 * x * z, 0.9 + 0.4 * x * y].map(|slope| slope * total);
            for level in SimdLevel::available() {
                let mut features = vec![f32::NAN; channels];
                interpolate(level, &volume, channels, &[corners], &mut features);
                naive::assert_close(&features, &expected, 1e-4, &format!("{level:?} {channels}"));
                let mut gradient = [[f32::NAN; 3]];
                interpolate_backward(level, &volume, channels, &[corners], &in_feature, &mut gradient);
                naive::assert_close(&gradient[0], &slopes, 2e-3, &format!("{level:?} {channels} gradient"));
            }
        }
    }
}

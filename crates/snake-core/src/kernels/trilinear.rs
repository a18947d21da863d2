//! Trilinear interpolation of feature rows.

use super::simd::{Lanes, simd_levels};

/// The eight voxels around a query and its place between them.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Corners {
    /// Flat voxel indices; bit 0 of the corner's number is x, bit 1 is y, bit 2 is z.
    pub(crate) voxels: [u32; 8],
    /// Position within the cell along x, y, z, in [0, 1].
    pub(crate) fraction: [f32; 3],
}

impl Corners {
    /// Weight of a corner: the product over axes of the fraction or its complement.
    #[inline(always)]
    fn weight(&self, corner: usize) -> f32 {
        let along = |axis: usize| if corner >> axis & 1 == 1 { self.fraction[axis] } else { 1.0 - self.fraction[axis] };
        along(0) * along(1) * along(2)
    }

    /// Derivative along x, y, z (per voxel) of the interpolation of eight corner values.
    pub(crate) fn gradient(&self, values: [f32; 8]) -> [f32; 3] {
        std::array::from_fn(|axis| {
            let (one, other) = ((axis + 1) % 3, (axis + 2) % 3);
            (0..8).filter(|corner| corner >> axis & 1 == 0).fold(0.0, |sum, low| {
                let along = |a: usize| if low >> a & 1 == 1 { self.fraction[a] } else { 1.0 - self.fraction[a] };
                sum + along(one) * along(other) * (values[low | 1 << axis] - values[low])
            })
        })
    }
}

simd_levels! {
    /// Interpolates rows of `channels` values of `volume` at each of the corners; `features` is `(queries, channels)`.
    pub(crate) fn interpolate(volume: &[f32], channels: usize, corners: &[Corners], features: &mut [f32]) = interpolate_body
}

#[inline(always)]
fn interpolate_body<L: Lanes, const ROWS: usize>(
    volume: &[f32],
    channels: usize,
    corners: &[Corners],
    features: &mut [f32],
) {
    for (corners, feature) in corners.iter().zip(features.chunks_exact_mut(channels)) {
        feature.fill(0.0);
        for (corner, &voxel) in corners.voxels.iter().enumerate() {
            let weight = corners.weight(corner);
            let row = &volume[voxel as usize * channels..][..channels];
            for (f, &value) in feature.iter_mut().zip(row) {
                *f = if L::FUSED { weight.mul_add(value, *f) } else { weight * value + *f };
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{SimdLevel, naive};
    use super::*;

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
            for level in SimdLevel::available() {
                let mut features = vec![f32::NAN; channels];
                interpolate(level, &volume, channels, &[corners], &mut features);
                naive::assert_close(&features, &expected, 1e-4, &format!("{level:?} {channels}"));
            }
            let [x, y, z] = fraction;
            let expected = [0.5 + 0.4 * y * z, -0.7 + 0.4 * x * z, 0.9 + 0.4 * x * y];
            let gradient = corners.gradient(std::array::from_fn(corner_value));
            naive::assert_close(&gradient, &expected, 1e-5, "gradient");
        }
    }
}

//! Group normalisation as a scale and a shift of each channel, which the convolution applies while it reads.

use rayon::prelude::*;

/// The sum and the sum of squares of each channel of a volume `(voxels, channels)`, in float64. Runs of fixed length are
/// summed in parallel and added in order, so the bits do not depend on the number of threads.
pub fn channel_sums(volume: &[f32], channels: usize) -> Vec<[f64; 2]> {
    const RUN: usize = 4096;
    let mut partial = vec![[0.0; 2]; volume.len().div_ceil(RUN * channels) * channels];
    volume.par_chunks(RUN * channels).zip(partial.par_chunks_mut(channels)).for_each(|(run, sums)| {
        for voxel in run.chunks_exact(channels) {
            for (sum, &value) in sums.iter_mut().zip(voxel) {
                let value = f64::from(value);
                sum[0] += value;
                sum[1] += value * value;
            }
        }
    });
    add_in_order(&partial, channels)
}

/// Adds the sums of several runs, `(runs, channels)`, from the first to the last.
pub(crate) fn add_in_order(partial: &[[f64; 2]], channels: usize) -> Vec<[f64; 2]> {
    let mut total = vec![[0.0; 2]; channels];
    for sums in partial.chunks_exact(channels) {
        for (total, sum) in total.iter_mut().zip(sums) {
            total[0] += sum[0];
            total[1] += sum[1];
        }
    }
    total
}

/// The weights of a group normalisation.
#[derive(Debug)]
pub struct GroupNorm {
    /// Groups of consecutive channels.
    pub groups: usize,
    /// Factor of each channel.
    pub weight: Vec<f32>,
    /// Offset of each channel.
    pub bias: Vec<f32>,
}

impl GroupNorm {
    const EPSILON: f64 = 1e-5;

    /// The scale and the shift of each channel (`normalised = value * scale + shift`), from the sums of
    /// [`channel_sums`] over this many voxels.
    pub fn scale_and_shift(&self, sums: &[[f64; 2]], voxels: usize) -> [Vec<f32>; 2] {
        let size = sums.len() / self.groups;
        let count = (voxels * size) as f64;
        let (mut scale, mut shift) = (vec![0.0; sums.len()], vec![0.0; sums.len()]);
        for (group, sums) in sums.chunks_exact(size).enumerate() {
            let total = |which: usize| sums.iter().map(|s| s[which]).sum::<f64>();
            let mean = total(0) / count;
            let variance = (total(1) / count - mean * mean).max(0.0);
            let inverse = 1.0 / (variance + Self::EPSILON).sqrt();
            for channel in group * size..(group + 1) * size {
                let factor = f64::from(self.weight[channel]) * inverse;
                scale[channel] = factor as f32;
                shift[channel] = (f64::from(self.bias[channel]) - mean * factor) as f32;
            }
        }
        [scale, shift]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::naive;

    #[test]
    fn equals_the_textbook() {
        let mut random = naive::Random::new(3);
        let cases = [(6, 8, 8), (27, 5, 1), (60, 24, 8), (17 * 16 * 18, 16, 4)];
        for (voxels, channels, groups) in naive::cases(cases, 3) {
            let norm = GroupNorm { groups, weight: random.values(channels), bias: random.values(channels) };
            let volume = random.values(voxels * channels);
            let expected = naive::group_norm(groups, &norm.weight, &norm.bias, GroupNorm::EPSILON, &volume);
            let [scale, shift] = norm.scale_and_shift(&channel_sums(&volume, channels), voxels);
            let normalized: Vec<f32> =
                volume.iter().enumerate().map(|(i, v)| v * scale[i % channels] + shift[i % channels]).collect();
            naive::assert_close(&normalized, &expected, 1e-5, &format!("{voxels} {channels} {groups}"));
        }
    }
}

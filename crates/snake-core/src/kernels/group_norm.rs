//! Group normalisation, in two passes: statistics, then scale and shift into the padded input of a convolution.

use rayon::prelude::*;

/// Scale and shift of every channel: `normalised = value * scale + shift`.
#[derive(Debug)]
pub(crate) struct GroupStatistics {
    pub(crate) scale: Vec<f32>,
    pub(crate) shift: Vec<f32>,
}

/// Statistics of a volume `(voxels, channels)` for `groups` groups of consecutive channels, folded with the layer's
/// `weight` and `bias`. Sums are taken in float64 over fixed runs of voxels and added in order.
pub(crate) fn group_statistics(
    volume: &[f32],
    groups: usize,
    weight: &[f32],
    bias: &[f32],
    epsilon: f64,
) -> GroupStatistics {
    const RUN: usize = 4096;
    let channels = weight.len();
    let partial: Vec<Vec<[f64; 2]>> = volume
        .par_chunks(RUN * channels)
        .map(|run| {
            let mut sums = vec![[0.0; 2]; channels];
            for voxel in run.chunks_exact(channels) {
                for (sum, &value) in sums.iter_mut().zip(voxel) {
                    let value = f64::from(value);
                    sum[0] += value;
                    sum[1] += value * value;
                }
            }
            sums
        })
        .collect();
    let size = channels / groups;
    let count = (volume.len() / channels * size) as f64;
    let (mut scale, mut shift) = (vec![0.0; channels], vec![0.0; channels]);
    for group in 0..groups {
        let members = group * size..(group + 1) * size;
        let total =
            |which: usize| -> f64 { partial.iter().flat_map(|sums| &sums[members.clone()]).map(|s| s[which]).sum() };
        let mean = total(0) / count;
        let variance = (total(1) / count - mean * mean).max(0.0);
        let inverse = 1.0 / (variance + epsilon).sqrt();
        for channel in members {
            let factor = f64::from(weight[channel]) * inverse;
            scale[channel] = factor as f32;
            shift[channel] = (f64::from(bias[channel]) - mean * factor) as f32;
        }
    }
    GroupStatistics { scale, shift }
}

/// Writes the normalised volume `(D, H, W, channels)` into `padded` `(D + 2, H + 2, W + 2, channels)`, whose border
/// it sets to zero.
pub(crate) fn normalize_into_padded(
    volume: &[f32],
    size: [usize; 3],
    statistics: &GroupStatistics,
    padded: &mut [f32],
) {
    let [depth, height, width] = size;
    let channels = statistics.scale.len();
    let line = (width + 2) * channels;
    padded.par_chunks_mut(line).enumerate().for_each(|(row, out)| {
        let (z, y) = (row / (height + 2), row % (height + 2));
        if z == 0 || z > depth || y == 0 || y > height {
            return out.fill(0.0);
        }
        let (left, rest) = out.split_at_mut(channels);
        let (inner, right) = rest.split_at_mut(width * channels);
        left.fill(0.0);
        right.fill(0.0);
        let source = &volume[((z - 1) * height + y - 1) * width * channels..][..width * channels];
        for (out, voxel) in inner.chunks_exact_mut(channels).zip(source.chunks_exact(channels)) {
            for (((o, v), scale), shift) in out.iter_mut().zip(voxel).zip(&statistics.scale).zip(&statistics.shift) {
                *o = v * scale + shift;
            }
        }
    });
}

#[cfg(test)]
mod tests {
    use super::super::naive;
    use super::*;

    #[test]
    fn equals_the_textbook() {
        let mut random = naive::Random::new(3);
        for (size, channels, groups) in
            [([1, 2, 3], 8, 8), ([4, 3, 5], 24, 8), ([17, 16, 18], 16, 4), ([3, 3, 3], 5, 1)]
        {
            let (weight, bias) = (random.values(channels), random.values(channels));
            let volume = random.values(size.iter().product::<usize>() * channels);
            let expected = naive::pad(size, channels, &naive::group_norm(groups, &weight, &bias, 1e-5, &volume));
            let statistics = group_statistics(&volume, groups, &weight, &bias, 1e-5);
            let mut padded = vec![f32::NAN; expected.len()];
            normalize_into_padded(&volume, size, &statistics, &mut padded);
            naive::assert_close(&padded, &expected, 1e-5, &format!("{size:?} {channels} {groups}"));
        }
    }
}

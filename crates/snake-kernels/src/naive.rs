//! Textbook versions of the kernels in float64, and helpers for the tests.

/// `(rows, inputs)` to `(rows, outputs)`, weights `(outputs, inputs)`.
pub(crate) fn linear(inputs: usize, outputs: usize, weight: &[f32], bias: &[f32], input: &[f32]) -> Vec<f32> {
    let rows = input.len() / inputs;
    let value = |row: usize, output: usize| {
        let products = (0..inputs).map(|k| f64::from(input[row * inputs + k]) * f64::from(weight[output * inputs + k]));
        (products.sum::<f64>() + f64::from(bias[output])) as f32
    };
    (0..rows * outputs).map(|i| value(i / outputs, i % outputs)).collect()
}

/// Pads a volume `(D, H, W, channels)` with a border of one zero voxel.
pub(crate) fn pad([depth, height, width]: [usize; 3], channels: usize, volume: &[f32]) -> Vec<f32> {
    let mut padded = vec![0.0; (depth + 2) * (height + 2) * (width + 2) * channels];
    for z in 0..depth {
        for y in 0..height {
            let from = (z * height + y) * width * channels;
            let to = (((z + 1) * (height + 2) + y + 1) * (width + 2) + 1) * channels;
            padded[to..to + width * channels].copy_from_slice(&volume[from..from + width * channels]);
        }
    }
    padded
}

/// Concatenates the volumes of several sources, upsampling some, then scales and shifts each channel.
pub(crate) fn normalized(
    [depth, height, width]: [usize; 3],
    sources: &[(usize, bool)],
    volumes: &[Vec<f32>],
    [scale, shift]: &[Vec<f32>; 2],
) -> Vec<f32> {
    let mut joined: Vec<f32> = Vec::new();
    for voxel in 0..depth * height * width {
        let place = [voxel / (height * width), voxel / width % height, voxel % width];
        for (&(channels, upsampled), volume) in sources.iter().zip(volumes) {
            let half = |n: usize| if upsampled { n / 2 } else { n };
            let [z, y, x] = place.map(half);
            joined.extend(&volume[((z * half(height) + y) * half(width) + x) * channels..][..channels]);
        }
    }
    let norm = scale.iter().zip(shift).cycle();
    joined.iter().zip(norm).map(|(value, (scale, shift))| value * scale + shift).collect()
}

/// [`conv3d`], then ReLU.
pub(crate) fn conv3d_relu(size: [usize; 3], inputs: usize, outputs: usize, weight: &[f32], volume: &[f32]) -> Vec<f32> {
    conv3d(size, inputs, outputs, weight, volume).into_iter().map(|value| value.max(0.0)).collect()
}

/// 3x3x3 convolution with zero padding; weights `(outputs, inputs, 3, 3, 3)`.
pub(crate) fn conv3d(size: [usize; 3], inputs: usize, outputs: usize, weight: &[f32], volume: &[f32]) -> Vec<f32> {
    let padded = pad(size, inputs, volume);
    let [depth, height, width] = size;
    let mut result = Vec::with_capacity(depth * height * width * outputs);
    for z in 0..depth {
        for y in 0..height {
            for x in 0..width {
                for output in 0..outputs {
                    let mut sum = 0.0;
                    for tap in 0..27 {
                        let (dz, dy, dx) = (tap / 9, tap / 3 % 3, tap % 3);
                        let voxel = ((z + dz) * (height + 2) + y + dy) * (width + 2) + x + dx;
                        for input in 0..inputs {
                            let w = weight[(output * inputs + input) * 27 + tap];
                            sum += f64::from(w) * f64::from(padded[voxel * inputs + input]);
                        }
                    }
                    result.push(sum as f32);
                }
            }
        }
    }
    result
}

/// Group normalisation of a volume `(voxels, channels)`.
pub(crate) fn group_norm(groups: usize, weight: &[f32], bias: &[f32], epsilon: f64, volume: &[f32]) -> Vec<f32> {
    let channels = weight.len();
    let group_of = |i: usize| i % channels / (channels / groups);
    let moment = |group: usize, of: &dyn Fn(f64) -> f64| {
        let members = (0..volume.len()).filter(|&i| group_of(i) == group);
        members.clone().map(|i| of(f64::from(volume[i]))).sum::<f64>() / members.count() as f64
    };
    let means: Vec<f64> = (0..groups).map(|group| moment(group, &|v| v)).collect();
    let variances: Vec<f64> = (0..groups).map(|group| moment(group, &|v| (v - means[group]).powi(2))).collect();
    let value = |i: usize| {
        let group = group_of(i);
        let unit = (f64::from(volume[i]) - means[group]) / (variances[group] + epsilon).sqrt();
        (unit * f64::from(weight[i % channels]) + f64::from(bias[i % channels])) as f32
    };
    (0..volume.len()).map(value).collect()
}

/// Seeded uniform values in [-1, 1).
pub(crate) struct Random(u64);

impl Random {
    pub(crate) fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1)
    }

    pub(crate) fn values(&mut self, number: usize) -> Vec<f32> {
        (0..number)
            .map(|_| {
                self.0 ^= self.0 << 13;
                self.0 ^= self.0 >> 7;
                self.0 ^= self.0 << 17;
                (self.0 >> 40) as f32 / (1 << 23) as f32 - 1.0
            })
            .collect()
    }
}

/// The cases of a test. Under Miri, which takes minutes for a second, only the first few.
pub(crate) fn cases<T, const N: usize>(all: [T; N], under_miri: usize) -> impl Iterator<Item = T> {
    all.into_iter().take(if cfg!(miri) { under_miri } else { N })
}

pub(crate) fn assert_close(found: &[f32], expected: &[f32], tolerance: f32, case: &str) {
    assert_eq!(found.len(), expected.len(), "{case}");
    for (i, (f, e)) in found.iter().zip(expected).enumerate() {
        assert!((f - e).abs() <= tolerance, "{case}: value {i} is {f}, expected {e}");
    }
}

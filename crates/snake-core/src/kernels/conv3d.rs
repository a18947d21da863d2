//! 3x3x3 convolution of a zero-padded volume.
//!
//! In channels-last layout the three x-neighbours of a voxel are 3 C consecutive numbers, so the convolution of a row
//! is nine linear layers (one for each dz, dy) of 3 C inputs whose rows overlap: they advance by C. The sum over
//! dz, dy and the inputs stays in registers.

use rayon::prelude::*;

use super::SimdLevel;
use super::simd::{LANES, Lanes, accumulate_tile, pack, simd_levels};

/// Weights of a 3x3x3 convolution without bias, packed as `[block][dz][dy][dx, channel][lane]`.
#[derive(Debug)]
pub(crate) struct PackedConv3d {
    pub(crate) inputs: usize,
    pub(crate) outputs: usize,
    weights: Vec<[f32; LANES]>,
}

impl PackedConv3d {
    /// From weights `(outputs, inputs, 3, 3, 3)` in the order z, y, x.
    pub(crate) fn new(inputs: usize, outputs: usize, weight: &[f32]) -> Self {
        let weights = pack(outputs, 27 * inputs, |output, k| {
            let (tap, input) = (k / inputs, k % inputs);
            weight[(output * inputs + input) * 27 + tap]
        });
        Self { inputs, outputs, weights }
    }
}

/// Convolution and ReLU: `padded` is `(D + 2, H + 2, W + 2, inputs)` with a border of zeros, the result
/// `(D, H, W, outputs)`; `size` is D, H, W.
pub(crate) fn conv3d(level: SimdLevel, layer: &PackedConv3d, size: [usize; 3], padded: &[f32], output: &mut [f32]) {
    let [_, height, width] = size;
    output.par_chunks_mut(width * layer.outputs).enumerate().for_each(|(row, output)| {
        conv3d_row(level, layer, [height, width], [row / height, row % height], padded, output);
    });
}

simd_levels! {
    /// One row of the output at `place` (z, y); `size` is H, W.
    fn conv3d_row(
        layer: &PackedConv3d,
        size: [usize; 2],
        place: [usize; 2],
        padded: &[f32],
        output: &mut [f32],
    ) = conv3d_row_body
}

#[inline(always)]
fn conv3d_row_body<L: Lanes, const ROWS: usize>(
    layer: &PackedConv3d,
    [height, width]: [usize; 2],
    [z, y]: [usize; 2],
    padded: &[f32],
    output: &mut [f32],
) {
    let line = (width + 2) * layer.inputs;
    let lines: [&[f32]; 9] =
        std::array::from_fn(|k| &padded[((z + k / 3) * (height + 2) + y + k % 3) * line..][..line]);
    for (block, weights) in layer.weights.chunks_exact(27 * layer.inputs).enumerate() {
        let mut x = 0;
        while x < width {
            if x + ROWS <= width {
                conv3d_tile::<L, ROWS>(layer, weights, &lines, block, x, output);
                x += ROWS;
            } else {
                conv3d_tile::<L, 1>(layer, weights, &lines, block, x, output);
                x += 1;
            }
        }
    }
}

#[inline(always)]
fn conv3d_tile<L: Lanes, const ROWS: usize>(
    layer: &PackedConv3d,
    weights: &[[f32; LANES]],
    lines: &[&[f32]; 9],
    block: usize,
    x: usize,
    output: &mut [f32],
) {
    let mut sums = [L::splat(0.0); ROWS];
    for (line, weights) in lines.iter().zip(weights.chunks_exact(3 * layer.inputs)) {
        sums = accumulate_tile::<L, ROWS>(sums, &line[x * layer.inputs..], layer.inputs, weights);
    }
    let lanes = LANES.min(layer.outputs - block * LANES);
    for (r, sum) in sums.iter().enumerate() {
        let out = &mut output[(x + r) * layer.outputs + block * LANES..][..lanes];
        for (o, s) in out.iter_mut().zip(sum.to_array()) {
            *o = s.max(0.0);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::naive;
    use super::*;

    #[test]
    fn every_level_equals_the_textbook() {
        let mut random = naive::Random::new(2);
        for (size, inputs, outputs) in
            [([1, 1, 1], 1, 1), ([2, 3, 5], 3, 7), ([3, 2, 8], 16, 16), ([4, 5, 9], 17, 33), ([6, 6, 17], 48, 16)]
        {
            let weight = random.values(outputs * inputs * 27);
            let volume = random.values(size.iter().product::<usize>() * inputs);
            let expected = naive::conv3d_relu(size, inputs, outputs, &weight, &volume);
            let padded = naive::pad(size, inputs, &volume);
            for level in SimdLevel::available() {
                let mut output = vec![f32::NAN; expected.len()];
                conv3d(level, &PackedConv3d::new(inputs, outputs, &weight), size, &padded, &mut output);
                // Sums of up to 1296 products of values below 1.
                naive::assert_close(&output, &expected, 1e-4, &format!("{level:?} {size:?} {inputs} {outputs}"));
            }
        }
    }
}

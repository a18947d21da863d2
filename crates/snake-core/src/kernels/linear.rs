//! Fully connected layer over many rows.

use super::simd::{LANES, Lanes, accumulate_tile, pack, simd_levels};

/// Weights and bias of a linear layer, packed for the microkernel.
#[derive(Debug)]
pub(crate) struct PackedLinear {
    pub(crate) inputs: usize,
    pub(crate) outputs: usize,
    weights: Vec<[f32; LANES]>,
    bias: Vec<[f32; LANES]>,
}

impl PackedLinear {
    /// From a weight matrix `(outputs, inputs)` and a bias, empty for none.
    pub(crate) fn new(inputs: usize, outputs: usize, weight: &[f32], bias: &[f32]) -> Self {
        let weights = pack(outputs, inputs, |output, input| weight[output * inputs + input]);
        let bias = pack(outputs, 1, |output, _| bias.get(output).copied().unwrap_or(0.0));
        Self { inputs, outputs, weights, bias }
    }
}

simd_levels! {
    /// `output = input * weights + bias` for rows of `layer.inputs` and `layer.outputs` values;
    /// with `add`, the result is added to what `output` holds.
    pub(crate) fn linear(layer: &PackedLinear, input: &[f32], output: &mut [f32], add: bool) = linear_body
}

#[inline(always)]
fn linear_body<L: Lanes, const ROWS: usize>(layer: &PackedLinear, input: &[f32], output: &mut [f32], add: bool) {
    let rows = input.len() / layer.inputs;
    let mut row = 0;
    while row < rows {
        if row + ROWS <= rows {
            linear_tile::<L, ROWS>(layer, &input[row * layer.inputs..], &mut output[row * layer.outputs..], add);
            row += ROWS;
        } else {
            linear_tile::<L, 1>(layer, &input[row * layer.inputs..], &mut output[row * layer.outputs..], add);
            row += 1;
        }
    }
}

#[inline(always)]
fn linear_tile<L: Lanes, const ROWS: usize>(layer: &PackedLinear, input: &[f32], output: &mut [f32], add: bool) {
    for (block, (weights, bias)) in layer.weights.chunks_exact(layer.inputs).zip(&layer.bias).enumerate() {
        let sums = accumulate_tile::<L, ROWS>([L::load(bias); ROWS], input, layer.inputs, weights);
        let lanes = LANES.min(layer.outputs - block * LANES);
        for (r, sum) in sums.iter().enumerate() {
            let out = &mut output[r * layer.outputs + block * LANES..][..lanes];
            for (o, s) in out.iter_mut().zip(sum.to_array()) {
                *o = if add { *o + s } else { s };
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{SimdLevel, naive};
    use super::*;

    #[test]
    fn every_level_equals_the_textbook() {
        let mut random = naive::Random::new(1);
        for (rows, inputs, outputs) in
            [(0, 3, 5), (1, 1, 1), (7, 3, 15), (8, 32, 16), (9, 64, 17), (31, 32, 32), (64, 96, 33)]
        {
            let (weight, bias) = (random.values(inputs * outputs), random.values(outputs));
            let (input, start) = (random.values(rows * inputs), random.values(rows * outputs));
            for add in [false, true] {
                let expected = naive::linear(inputs, outputs, &weight, &bias, &input, add.then_some(&start));
                for level in SimdLevel::available() {
                    let mut output = start.clone();
                    linear(level, &PackedLinear::new(inputs, outputs, &weight, &bias), &input, &mut output, add);
                    // Sums of up to 96 products of values below 1: float32 rounding stays below 1e-5.
                    naive::assert_close(&output, &expected, 1e-5, &format!("{level:?} {rows} {inputs} {outputs}"));
                }
            }
        }
    }
}

//! Fully connected layer over many rows.

use crate::simd::{LANES, Lanes, accumulate_tile, load, pack, simd_levels, store};

/// Weights and bias of a linear layer, packed for the microkernel.
#[derive(Debug)]
pub struct PackedLinear {
    inputs: usize,
    outputs: usize,
    weights: Vec<[f32; LANES]>,
    bias: Vec<[f32; LANES]>,
}

impl PackedLinear {
    /// Packs a weight matrix `(outputs, inputs)` and a bias of `outputs` values; an empty bias means none.
    ///
    /// # Panics
    /// If the matrix is shorter than `outputs * inputs`.
    pub fn new(inputs: usize, outputs: usize, weight: &[f32], bias: &[f32]) -> Self {
        let weights = pack(outputs, inputs, |output, input| weight[output * inputs + input]);
        let bias = pack(outputs, 1, |output, _| bias.get(output).copied().unwrap_or(0.0));
        Self { inputs, outputs, weights, bias }
    }

    /// Number of values in an input row.
    pub fn inputs(&self) -> usize {
        self.inputs
    }

    /// Number of values in an output row.
    pub fn outputs(&self) -> usize {
        self.outputs
    }
}

/// How a linear layer writes its results. Each slice in it is as long as the output.
#[derive(Debug)]
pub enum Epilogue<'a> {
    /// Store the results.
    Store,
    /// Store the ReLU of the results.
    Relu,
    /// Add the results to the output.
    Add,
    /// Add the results to the output, and write the ReLU of the sums to this slice.
    AddAndRelu(&'a mut [f32]),
    /// Store a result where this ReLU is positive, and zero elsewhere: the backward pass of the ReLU.
    Mask(&'a [f32]),
    /// Add a result to the output where this ReLU is positive.
    AddMasked(&'a [f32]),
}

simd_levels! {
    /// Computes `input * weights + bias` for `input` of shape (rows, inputs); `output` is (rows, outputs).
    ///
    /// # Panics
    /// If the output or a slice of the epilogue is shorter than (rows, outputs).
    pub fn linear(layer: &PackedLinear, input: &[f32], output: &mut [f32], epilogue: Epilogue) = linear_body
}

#[inline(always)]
fn linear_body<L: Lanes, const ROWS: usize>(
    token: L::Token,
    layer: &PackedLinear,
    input: &[f32],
    output: &mut [f32],
    mut epilogue: Epilogue,
) {
    let rows = input.len() / layer.inputs;
    let tiled = rows - rows % ROWS;
    for row in (0..tiled).step_by(ROWS) {
        linear_rows::<L, ROWS>(token, layer, row, input, output, &mut epilogue);
    }
    for row in tiled..rows {
        linear_rows::<L, 1>(token, layer, row, input, output, &mut epilogue);
    }
}

#[inline(always)]
fn linear_rows<L: Lanes, const ROWS: usize>(
    token: L::Token,
    layer: &PackedLinear,
    row: usize,
    input: &[f32],
    output: &mut [f32],
    epilogue: &mut Epilogue,
) {
    let input = &input[row * layer.inputs..];
    let mut block = 0;
    if L::PAIRS {
        while block + 2 <= layer.bias.len() {
            linear_blocks::<L, ROWS, 2>(token, layer, row, block, input, output, epilogue);
            block += 2;
        }
    }
    for block in block..layer.bias.len() {
        linear_blocks::<L, ROWS, 1>(token, layer, row, block, input, output, epilogue);
    }
}

#[inline(always)]
fn linear_blocks<L: Lanes, const ROWS: usize, const BLOCKS: usize>(
    token: L::Token,
    layer: &PackedLinear,
    row: usize,
    block: usize,
    input: &[f32],
    output: &mut [f32],
    epilogue: &mut Epilogue,
) {
    let weights = std::array::from_fn(|b| &layer.weights[(block + b) * layer.inputs..][..layer.inputs]);
    let bias = std::array::from_fn(|b| [L::load(token, &layer.bias[block + b]); ROWS]);
    let sums: [_; BLOCKS] = accumulate_tile(bias, input, layer.inputs, weights);
    for (block, sums) in (block..).zip(sums) {
        let place = row * layer.outputs + block * LANES;
        // Most blocks are full: with a constant number of lanes, the compiler can unroll them.
        match layer.outputs - block * LANES {
            LANES.. => finish::<L, ROWS>(sums, place, layer.outputs, LANES, output, epilogue),
            lanes => finish::<L, ROWS>(sums, place, layer.outputs, lanes, output, epilogue),
        }
    }
}

/// Writes `lanes` sums of each row as the epilogue says; rows are `stride` apart.
#[inline(always)]
fn finish<L: Lanes, const ROWS: usize>(
    sums: [L; ROWS],
    place: usize,
    stride: usize,
    lanes: usize,
    output: &mut [f32],
    epilogue: &mut Epilogue,
) {
    // One loop per case keeps the sums in registers.
    macro_rules! store_each {
        ($sum:ident, $place:ident, $result:expr) => {
            for r in 0..ROWS {
                let ($sum, $place) = (sums[r], place + r * stride..place + r * stride + lanes);
                let result = $result;
                store(result, &mut output[$place], lanes);
            }
        };
    }
    let token = sums[0].token();
    let zero = L::splat(token, 0.0);
    match epilogue {
        Epilogue::Store => store_each!(sum, place, sum),
        Epilogue::Relu => store_each!(sum, place, sum.max(zero)),
        Epilogue::Add => store_each!(sum, place, sum.add(load(token, &output[place.clone()], lanes))),
        Epilogue::AddAndRelu(relu) => store_each!(sum, place, {
            let sum = sum.add(load(token, &output[place.clone()], lanes));
            store(sum.max(zero), &mut relu[place.clone()], lanes);
            sum
        }),
        Epilogue::Mask(relu) => store_each!(sum, place, sum.mask_positive(load(token, &relu[place.clone()], lanes))),
        Epilogue::AddMasked(relu) => store_each!(sum, place, {
            sum.mask_positive(load(token, &relu[place.clone()], lanes)).add(load(token, &output[place.clone()], lanes))
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{SimdLevel, naive};

    #[test]
    fn every_level_equals_the_textbook() {
        let mut random = naive::Random::new(1);
        let cases = [(0, 3, 5), (1, 1, 1), (7, 3, 15), (8, 32, 16), (9, 64, 17), (31, 32, 32), (64, 96, 33)];
        for (rows, inputs, outputs) in naive::cases(cases, 5) {
            let (weight, bias) = (random.values(inputs * outputs), random.values(outputs));
            let (input, start) = (random.values(rows * inputs), random.values(rows * outputs));
            let relu: Vec<f32> = random.values(rows * outputs).iter().map(|v| v.max(0.0)).collect();
            let plain = naive::linear(inputs, outputs, &weight, &bias, &input);
            let zip = |f: &dyn Fn(f32, f32, f32) -> f32| -> Vec<f32> {
                plain.iter().zip(&start).zip(&relu).map(|((&p, &s), &r)| f(p, s, r)).collect()
            };
            let keep = |p: f32, r: f32| if r > 0.0 { p } else { 0.0 };
            for level in SimdLevel::available() {
                let check = |epilogue: Epilogue, expected: &[f32]| {
                    let case = format!("{level:?} {rows} {inputs} {outputs} {epilogue:?}");
                    let mut output = start.clone();
                    linear(level, &PackedLinear::new(inputs, outputs, &weight, &bias), &input, &mut output, epilogue);
                    // Sums of up to 96 products of values below 1: float32 rounding stays below 1e-5.
                    naive::assert_close(&output, expected, 1e-5, &case);
                };
                check(Epilogue::Store, &plain);
                check(Epilogue::Relu, &zip(&|p, _, _| p.max(0.0)));
                check(Epilogue::Add, &zip(&|p, s, _| p + s));
                let mut beside = vec![f32::NAN; start.len()];
                check(Epilogue::AddAndRelu(&mut beside), &zip(&|p, s, _| p + s));
                naive::assert_close(&beside, &zip(&|p, s, _| (p + s).max(0.0)), 1e-5, "ReLU beside");
                check(Epilogue::Mask(&relu), &zip(&|p, _, r| keep(p, r)));
                check(Epilogue::AddMasked(&relu), &zip(&|p, s, r| keep(p, r) + s));
            }
        }
    }
}

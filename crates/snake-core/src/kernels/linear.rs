//! Fully connected layer over many rows.

use super::simd::{LANES, Lanes, accumulate_tile, load, pack, simd_levels, store};

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

/// What becomes of the results of a linear layer; slices are as long as the output.
#[derive(Debug)]
pub(crate) enum Then<'a> {
    Store,
    /// Store their ReLU.
    Relu,
    /// Add them to what the output holds.
    Add,
    /// Add, and write the sums' ReLU here.
    AddAndRelu(&'a mut [f32]),
    /// Store those for which this ReLU is positive, zero for the others: its derivative.
    Mask(&'a [f32]),
    /// Add those for which this ReLU is positive.
    AddMasked(&'a [f32]),
}

simd_levels! {
    /// `input * weights + bias` for rows of `layer.inputs` values, each giving `layer.outputs`.
    pub(crate) fn linear(layer: &PackedLinear, input: &[f32], output: &mut [f32], then: Then) = linear_body
}

#[inline(always)]
fn linear_body<L: Lanes, const ROWS: usize>(layer: &PackedLinear, input: &[f32], output: &mut [f32], mut then: Then) {
    let rows = input.len() / layer.inputs;
    let tiled = rows - rows % ROWS;
    for row in (0..tiled).step_by(ROWS) {
        linear_rows::<L, ROWS>(layer, row, input, output, &mut then);
    }
    for row in tiled..rows {
        linear_rows::<L, 1>(layer, row, input, output, &mut then);
    }
}

#[inline(always)]
fn linear_rows<L: Lanes, const ROWS: usize>(
    layer: &PackedLinear,
    row: usize,
    input: &[f32],
    output: &mut [f32],
    then: &mut Then,
) {
    let input = &input[row * layer.inputs..];
    for (block, (weights, bias)) in layer.weights.chunks_exact(layer.inputs).zip(&layer.bias).enumerate() {
        let sums = accumulate_tile::<L, ROWS>([L::load(bias); ROWS], input, layer.inputs, weights);
        let place = row * layer.outputs + block * LANES;
        // The number of lanes is nearly always the whole block: so that the compiler knows it there.
        match layer.outputs - block * LANES {
            LANES.. => finish::<L, ROWS>(sums, place, layer.outputs, LANES, output, then),
            lanes => finish::<L, ROWS>(sums, place, layer.outputs, lanes, output, then),
        }
    }
}

/// Does to `lanes` sums of each row what `then` says; rows are `stride` apart.
#[inline(always)]
fn finish<L: Lanes, const ROWS: usize>(
    sums: [L; ROWS],
    place: usize,
    stride: usize,
    lanes: usize,
    output: &mut [f32],
    then: &mut Then,
) {
    // One loop for each case, with the sums in registers.
    macro_rules! store_each {
        ($sum:ident, $place:ident, $result:expr) => {
            for r in 0..ROWS {
                let ($sum, $place) = (sums[r], place + r * stride..place + r * stride + lanes);
                let result = $result;
                store(result, &mut output[$place], lanes);
            }
        };
    }
    let zero = L::splat(0.0);
    match then {
        Then::Store => store_each!(sum, place, sum),
        Then::Relu => store_each!(sum, place, sum.at_least(zero)),
        Then::Add => store_each!(sum, place, sum.plus(load(&output[place.clone()], lanes))),
        Then::AddAndRelu(relu) => store_each!(sum, place, {
            let sum = sum.plus(load(&output[place.clone()], lanes));
            store(sum.at_least(zero), &mut relu[place.clone()], lanes);
            sum
        }),
        Then::Mask(relu) => store_each!(sum, place, sum.where_positive(load(&relu[place.clone()], lanes))),
        Then::AddMasked(relu) => store_each!(sum, place, {
            sum.where_positive(load(&relu[place.clone()], lanes)).plus(load(&output[place.clone()], lanes))
        }),
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
            let relu: Vec<f32> = random.values(rows * outputs).iter().map(|v| v.max(0.0)).collect();
            let plain = naive::linear(inputs, outputs, &weight, &bias, &input);
            let zip = |f: &dyn Fn(f32, f32, f32) -> f32| -> Vec<f32> {
                plain.iter().zip(&start).zip(&relu).map(|((&p, &s), &r)| f(p, s, r)).collect()
            };
            let keep = |p: f32, r: f32| if r > 0.0 { p } else { 0.0 };
            for level in SimdLevel::available() {
                let check = |then: Then, expected: &[f32]| {
                    let case = format!("{level:?} {rows} {inputs} {outputs} {then:?}");
                    let mut output = start.clone();
                    linear(level, &PackedLinear::new(inputs, outputs, &weight, &bias), &input, &mut output, then);
                    // Sums of up to 96 products of values below 1: float32 rounding stays below 1e-5.
                    naive::assert_close(&output, expected, 1e-5, &case);
                };
                check(Then::Store, &plain);
                check(Then::Relu, &zip(&|p, _, _| p.max(0.0)));
                check(Then::Add, &zip(&|p, s, _| p + s));
                let mut beside = vec![f32::NAN; start.len()];
                check(Then::AddAndRelu(&mut beside), &zip(&|p, s, _| p + s));
                naive::assert_close(&beside, &zip(&|p, s, _| (p + s).max(0.0)), 1e-5, "ReLU beside");
                check(Then::Mask(&relu), &zip(&|p, _, r| keep(p, r)));
                check(Then::AddMasked(&relu), &zip(&|p, s, r| keep(p, r) + s));
            }
        }
    }
}

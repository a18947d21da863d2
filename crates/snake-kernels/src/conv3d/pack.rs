//! Transformed and packed weights of a 3x3x3 convolution.

use super::{FAR, NEAR};
use crate::simd::LANES;

/// Input channels of one matrix product.
pub(super) const BLOCK: usize = 2 * LANES;

/// Up to BLOCK channels of one source.
#[derive(Debug)]
pub(super) struct Block {
    pub(super) source: usize,
    /// First channel within the source, and within the whole input.
    pub(super) first: [usize; 2],
    pub(super) channels: usize,
    /// `[point][output block][channel][lane]`; points that are always zero are left out.
    pub(super) weights: Vec<[f32; LANES]>,
    pub(super) upsampled: bool,
}

/// Weights of a 3x3x3 convolution without bias, transformed and packed.
#[derive(Debug)]
pub struct PackedConv3d {
    pub(super) outputs: usize,
    /// Outputs of a tile along an axis: M.
    pub(super) tile: usize,
    pub(super) blocks: Vec<Block>,
}

/// The points of a source: all N³. With N = 4, an upsampled source has only those without a 2 along any axis.
pub(super) fn points(n: usize, upsampled: bool) -> impl Iterator<Item = usize> {
    let skip = upsampled && n == 4;
    (0..n * n * n).filter(move |p| !skip || [p / 16, p / 4 % 4, p % 4].iter().all(|&k| k != 2))
}

/// One tap of the filters of LANES outputs.
type Tap = [f64; LANES];

/// Transforms LANES filters along an axis to U; the first N values count.
fn weights_of_axis(n: usize, [a, b, c]: [Tap; 3]) -> [Tap; 6] {
    let mut values = [[0.0; LANES]; 6];
    for lane in 0..LANES {
        let of_lane = weights_of_filter(n, [a[lane], b[lane], c[lane]]);
        values.iter_mut().zip(of_lane).for_each(|(values, value)| values[lane] = value);
    }
    values
}

/// Transforms a filter along an axis to U; the first N values count.
fn weights_of_filter(n: usize, [a, b, c]: [f64; 3]) -> [f64; 6] {
    if n == 4 {
        return [a, 0.5 * (a + b + c), 0.5 * (a - b + c), c, 0.0, 0.0];
    }
    // The filter's polynomial at a point, divided by the distances of this point from the other finite points.
    let at = |node: f64, distances: f64| (a + node * (b + node * c)) / distances;
    let [near, far] = [NEAR * NEAR, FAR * FAR];
    let [of_near, of_far] = [2.0 * near * (near - far), 2.0 * far * (far - near)];
    [a / (near * far), at(NEAR, of_near), at(-NEAR, of_near), at(FAR, of_far), at(-FAR, of_far), c]
}

/// Transforms LANES filters of 3x3x3 taps in the order z, y, x along all axes, to N³ points `[z][y][x]`.
fn weights_of_points(n: usize, taps: &[Tap; 27]) -> Vec<[f32; LANES]> {
    let rows: [[Tap; 6]; 9] = std::array::from_fn(|zy| weights_of_axis(n, std::array::from_fn(|x| taps[zy * 3 + x])));
    let mut values = vec![[0.0; LANES]; n * n * n];
    for x in 0..n {
        let planes: [[Tap; 6]; 3] =
            std::array::from_fn(|z| weights_of_axis(n, std::array::from_fn(|y| rows[z * 3 + y][x])));
        for y in 0..n {
            let column = weights_of_axis(n, planes.map(|plane| plane[y]));
            for z in 0..n {
                values[(z * n + y) * n + x] = column[z].map(|value| value as f32);
            }
        }
    }
    values
}

impl PackedConv3d {
    /// Transforms weights `(outputs, inputs, 3, 3, 3)`, with taps in the order z, y, x. `sources` holds the channels of
    /// each source and whether it is upsampled; `tile` is M: 2, or else 4.
    ///
    /// # Panics
    /// If there are fewer weights than the shape says.
    pub fn new(sources: &[(usize, bool)], outputs: usize, weight: &[f32], tile: usize) -> Self {
        let tile = if tile == 2 { 2 } else { 4 };
        let inputs: usize = sources.iter().map(|s| s.0).sum();
        let n = tile + 2;
        let output_blocks = outputs.div_ceil(LANES);
        // The filters of one input and the LANES outputs of a block; outputs beyond the last have zeros.
        let taps = |output_block: usize, input: usize| -> [Tap; 27] {
            std::array::from_fn(|tap| {
                std::array::from_fn(|lane| match output_block * LANES + lane {
                    output if output < outputs => f64::from(weight[(output * inputs + input) * 27 + tap]),
                    _ => 0.0,
                })
            })
        };
        let mut blocks = Vec::new();
        let mut before = 0;
        for (source, &(channels, upsampled)) in sources.iter().enumerate() {
            for first in (0..channels).step_by(BLOCK) {
                let width = BLOCK.min(channels - first);
                // On this thread alone: loading a model must not start Rayon's global pool.
                let filters = output_blocks * width;
                let mut weights = vec![[0.0; LANES]; points(n, upsampled).count() * filters];
                for filter in 0..filters {
                    let of_points = weights_of_points(n, &taps(filter / width, before + first + filter % width));
                    for (k, p) in points(n, upsampled).enumerate() {
                        weights[k * filters + filter] = of_points[p];
                    }
                }
                blocks.push(Block { source, first: [first, before + first], channels: width, weights, upsampled });
            }
            before += channels;
        }
        Self { outputs, tile, blocks }
    }

    /// Channels of the output.
    pub fn outputs(&self) -> usize {
        self.outputs
    }

    /// Outputs of a tile along an axis: 2 or 4.
    pub fn tile(&self) -> usize {
        self.tile
    }
}

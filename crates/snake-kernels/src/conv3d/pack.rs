//! Transformed and packed weights of a 3x3x3 convolution.

use super::{FAR, NEAR};
use crate::simd::LANES;

/// Maximum number of input channels of one matrix product.
pub(super) const BLOCK: usize = 2 * LANES;

/// Up to `BLOCK` channels of one source.
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

impl Block {
    /// Number of values of one tile at one point, in whole registers.
    pub(super) fn width(&self) -> usize {
        self.channels.next_multiple_of(LANES)
    }
}

/// Weights of a 3x3x3 convolution without bias, transformed and packed.
#[derive(Debug)]
pub struct PackedConv3d {
    pub(super) outputs: usize,
    /// Outputs of a tile along an axis: M.
    pub(super) tile: usize,
    pub(super) blocks: Vec<Block>,
}

/// The points of a source: all N³. With N = 4, an upsampled source has only those whose index is not 2 along any axis.
pub(super) fn points(n: usize, upsampled: bool) -> impl Iterator<Item = usize> {
    let skip = upsampled && n == 4;
    (0..n * n * n).filter(move |p| !skip || [p / 16, p / 4 % 4, p % 4].iter().all(|&k| k != 2))
}

/// One tap of the filters of LANES outputs.
type Tap = [f64; LANES];

/// Transforms LANES filters along an axis to U: N values, `step` apart.
#[inline(always)]
fn transform_axis(n: usize, [a, b, c]: [&Tap; 3], values: &mut [Tap], step: usize) {
    // The filter's polynomial at a point is divided by the distances between this point and the other finite points.
    const NEAR_2: f64 = NEAR * NEAR;
    const FAR_2: f64 = FAR * FAR;
    const SCALE_ZERO: f64 = 1.0 / (NEAR_2 * FAR_2);
    const SCALE_NEAR: f64 = 1.0 / (2.0 * NEAR_2 * (NEAR_2 - FAR_2));
    const SCALE_FAR: f64 = 1.0 / (2.0 * FAR_2 * (FAR_2 - NEAR_2));
    for lane in 0..LANES {
        let [a, b, c] = [a[lane], b[lane], c[lane]];
        let at_pair = |even: f64, odd: f64, factor: f64| [(even + odd) * factor, (even - odd) * factor];
        values[0][lane] = a;
        values[(n - 1) * step][lane] = c;
        if n == 4 {
            [values[step][lane], values[2 * step][lane]] = at_pair(a + c, b, 0.5);
        } else {
            values[0][lane] *= SCALE_ZERO;
            [values[step][lane], values[2 * step][lane]] = at_pair(a + NEAR_2 * c, NEAR * b, SCALE_NEAR);
            [values[3 * step][lane], values[4 * step][lane]] = at_pair(a + FAR_2 * c, FAR * b, SCALE_FAR);
        }
    }
}

/// Transforms LANES filters of 3x3x3 taps, ordered z, y, x, along all axes to the first N³ points `[z][y][x]` of `values`.
fn transform_filters(n: usize, taps: &[Tap; 27], values: &mut [[f32; LANES]; 216]) {
    // `[x][z][y]`, `[x][y][z]` and the points along z.
    let (mut rows, mut planes, mut column) = ([[0.0; LANES]; 54], [[0.0; LANES]; 108], [[0.0; LANES]; 6]);
    for row in 0..9 {
        let taps = &taps[3 * row..];
        transform_axis(n, [&taps[0], &taps[1], &taps[2]], &mut rows[row..], 9);
    }
    for x in 0..n {
        for z in 0..3 {
            let taps = &rows[9 * x + 3 * z..];
            transform_axis(n, [&taps[0], &taps[1], &taps[2]], &mut planes[18 * x + z..], 3);
        }
        for y in 0..n {
            let taps = &planes[18 * x + 3 * y..];
            transform_axis(n, [&taps[0], &taps[1], &taps[2]], &mut column, 1);
            for z in 0..n {
                values[(z * n + y) * n + x] = column[z].map(|value| value as f32);
            }
        }
    }
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
        // The filters from one input to the LANES outputs of a block; outputs beyond the last are zero.
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
                // Runs on this thread only: loading a model must not start Rayon's global pool.
                let filters = output_blocks * width;
                let mut weights = vec![[0.0; LANES]; points(n, upsampled).count() * filters];
                let mut transformed = [[0.0; LANES]; 216];
                for filter in 0..filters {
                    transform_filters(n, &taps(filter / width, before + first + filter % width), &mut transformed);
                    for (k, p) in points(n, upsampled).enumerate() {
                        weights[k * filters + filter] = transformed[p];
                    }
                }
                blocks.push(Block { source, first: [first, before + first], channels: width, weights, upsampled });
            }
            before += channels;
        }
        Self { outputs, tile, blocks }
    }

    /// Transforms weights like [`PackedConv3d::new`], into one convolution of blocks per source, whose sums are added.
    ///
    /// # Panics
    /// If there are fewer weights than the shape says.
    pub fn for_blocks(sources: &[(usize, bool)], outputs: usize, weight: &[f32]) -> Vec<Self> {
        let inputs: usize = sources.iter().map(|s| s.0).sum();
        let mut before = 0;
        let mut parts = Vec::new();
        for &(channels, upsampled) in sources {
            let filters = weight.chunks_exact(27 * inputs);
            let part: Vec<f32> = filters.flat_map(|filter| &filter[27 * before..][..27 * channels]).copied().collect();
            // Small tiles of an upsampled source need as many products as large ones, but an eighth of the weights.
            parts.push(Self::new(&[(channels, upsampled)], outputs, &part, if upsampled { 2 } else { 4 }));
            before += channels;
        }
        parts
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

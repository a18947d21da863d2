//! The products of many tiles at one point: a small matrix product.

use crate::simd::{LANES, Lanes, accumulate_tile};

/// `products (tiles, LANES) += inputs (tiles, width) weights (channels, LANES)`; `fresh` starts the sums at zero. Meanwhile it
/// prefetches the weights of the `next` product, because all weights together fill the second-level cache.
#[inline(always)]
pub(super) fn multiply<L: Lanes, const ROWS: usize>(
    token: L::Token,
    inputs: &[f32],
    width: usize,
    weights: &[[f32; LANES]],
    next: &[[f32; LANES]],
    products: &mut [f32],
    fresh: bool,
) {
    let inputs = inputs.chunks_exact(ROWS * width);
    let products = products.as_chunks_mut::<LANES>().0.as_chunks_mut::<ROWS>().0;
    let mut ahead = next.chunks(next.len().div_ceil(inputs.len()).max(1));
    for (inputs, products) in inputs.zip(products) {
        for line in ahead.next().unwrap_or_default() {
            L::prefetch(line.as_ptr());
        }
        let mut sums = [L::splat(token, 0.0); ROWS];
        if !fresh {
            for r in 0..ROWS {
                sums[r] = L::load(token, &products[r]);
            }
        }
        let [sums] = accumulate_tile([sums], inputs, width, [weights]);
        for r in 0..ROWS {
            sums[r].store(&mut products[r]);
        }
    }
}

//! SIMD levels, and the microkernel that convolutions and linear layers share.

mod lanes;
mod level;

pub(crate) use lanes::*;
pub use level::SimdLevel;
pub(crate) use level::*;

/// Number of output channels in a microkernel; weights are packed in blocks of this size.
pub(crate) const LANES: usize = 16;

/// Compiles `$body::<L, ROWS>(token, args)` for the [`Lanes`] of each level, and defines `$name(level, args)`, which calls the
/// version for the given level.
macro_rules! simd_levels {
    ($(#[$doc:meta])* $visibility:vis fn $name:ident($($argument:ident: $kind:ty),* $(,)?) = $body:ident) => {
        $(#[$doc])*
        $visibility fn $name(level: $crate::simd::SimdLevel, $($argument: $kind),*) {
            use $crate::simd::*;
            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx2,fma")]
            fn avx2(token: Avx2Token, $($argument: $kind),*) {
                $body::<Avx2Lanes, { Avx2Lanes::ROWS }>(token, $($argument),*)
            }
            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx512f,avx2,fma")]
            fn avx512(token: Avx512Token, $($argument: $kind),*) {
                $body::<Avx512Lanes, { Avx512Lanes::ROWS }>(token, $($argument),*)
            }
            match level.0 {
                // SAFETY: the tokens come from detection alone.
                #[cfg(target_arch = "x86_64")]
                Instructions::Avx2(token) => unsafe { avx2(token, $($argument),*) },
                #[cfg(target_arch = "x86_64")]
                Instructions::Avx512(token) => unsafe { avx512(token, $($argument),*) },
                #[cfg(target_arch = "aarch64")]
                Instructions::Neon => $body::<NeonLanes, { NeonLanes::ROWS }>((), $($argument),*),
                Instructions::Portable => $body::<PortableLanes, { PortableLanes::ROWS }>((), $($argument),*),
            }
        }
    };
}
pub(crate) use simd_levels;

/// `sums[b][r] += input[r * stride ..][.. weights[b].len()] * weights[b]` for ROWS rows and BLOCKS blocks of output channels. The
/// weights of all blocks have the same length. Each input is read once for all blocks.
#[inline(always)]
pub(crate) fn accumulate_tile<L: Lanes, const ROWS: usize, const BLOCKS: usize>(
    mut sums: [[L; ROWS]; BLOCKS],
    input: &[f32],
    stride: usize,
    weights: [&[[f32; LANES]]; BLOCKS],
) -> [[L; ROWS]; BLOCKS] {
    let (length, token) = (weights[0].len(), sums[0][0].token());
    assert!(input.len() >= (ROWS - 1) * stride + length, "rows end within the input");
    let mut add = |k: usize, weights: [&[f32; LANES]; BLOCKS]| {
        let weights = weights.map(|weights| L::load(token, weights));
        for r in 0..ROWS {
            // SAFETY: r < ROWS and k < length, so the index is below the length asserted above. A check of each product
            // would cost a third of the speed.
            let value = L::splat(token, unsafe { *input.get_unchecked(r * stride + k) });
            for (sums, weight) in sums.iter_mut().zip(weights) {
                sums[r] = value.multiply_add(weight, sums[r]);
            }
        }
    };
    // Weights have equal lengths and are taken four at a time, so indices are checked and row addresses computed once per four.
    let weights = weights.map(|weights| weights[..length].as_chunks::<4>());
    for number in 0..length / 4 {
        let fours = weights.map(|(fours, _)| &fours[number]);
        for k in 0..4 {
            add(4 * number + k, fours.map(|four| &four[k]));
        }
    }
    for k in 0..length % 4 {
        add(length / 4 * 4 + k, weights.map(|(_, rest)| &rest[k]));
    }
    sums
}

/// Loads the first `lanes` values, and zeros into the other lanes.
#[inline(always)]
pub(crate) fn load<L: Lanes>(token: L::Token, values: &[f32], lanes: usize) -> L {
    match values.first_chunk() {
        Some(values) if lanes == LANES => L::load(token, values),
        _ => {
            let mut padded = [0.0; LANES];
            padded[..lanes].copy_from_slice(&values[..lanes]);
            L::load(token, &padded)
        }
    }
}

/// Loads LANES values without a check, which would cost as much as a load.
///
/// # Safety
/// There are LANES values from `first` on.
#[inline(always)]
pub(crate) unsafe fn load_at<L: Lanes>(token: L::Token, values: &[f32], first: usize) -> L {
    debug_assert!(first + LANES <= values.len());
    // SAFETY: the caller's.
    L::load(token, unsafe { &*values.as_ptr().add(first).cast() })
}

/// Stores all lanes without a check.
///
/// # Safety
/// There are LANES values from `first` on.
#[inline(always)]
pub(crate) unsafe fn store_at<L: Lanes>(from: L, values: &mut [f32], first: usize) {
    debug_assert!(first + LANES <= values.len());
    // SAFETY: the caller's.
    from.store(unsafe { &mut *values.as_mut_ptr().add(first).cast() });
}

/// Stores the first `lanes` lanes.
#[inline(always)]
pub(crate) fn store<L: Lanes>(from: L, values: &mut [f32], lanes: usize) {
    match values.first_chunk_mut() {
        Some(values) if lanes == LANES => from.store(values),
        _ => values[..lanes].copy_from_slice(&from.to_array()[..lanes]),
    }
}

/// Packs weights `(outputs, inputs)` into blocks of LANES outputs, `[block][input][lane]`, padded with zeros.
pub(crate) fn pack(outputs: usize, inputs: usize, weight: impl Fn(usize, usize) -> f32) -> Vec<[f32; LANES]> {
    let mut packed = Vec::with_capacity(outputs.div_ceil(LANES) * inputs);
    for block in 0..outputs.div_ceil(LANES) {
        for input in 0..inputs {
            packed.push(std::array::from_fn(|lane| {
                let output = block * LANES + lane;
                if output < outputs { weight(output, input) } else { 0.0 }
            }));
        }
    }
    packed
}

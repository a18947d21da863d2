//! Levels of instructions, and the microkernel that convolutions and linear layers share.

#[cfg(target_arch = "x86_64")]
use std::arch::x86_64::{
    __m256, __m512, _CMP_GT_OQ, _mm256_and_ps, _mm256_cmp_ps, _mm256_setzero_ps, _mm512_cmp_ps_mask,
    _mm512_maskz_mov_ps, _mm512_setzero_ps,
};
use std::sync::OnceLock;

/// Output channels that a microkernel holds at a time; weights are packed in blocks of this many.
pub(crate) const LANES: usize = 16;

/// A level of instructions that this processor has.
///
/// Only detection makes one ([`SimdLevel::available`], [`SimdLevel::current`]), so a kernel that is given a level can rely
/// on its instructions.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SimdLevel(pub(crate) Instructions);

/// The instructions that kernels are compiled for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Instructions {
    /// Plain loops: SSE2 on x86-64, and whatever the compiler makes of them on others.
    Portable,
    /// NEON, which every aarch64 processor has.
    #[cfg(target_arch = "aarch64")]
    Neon,
    /// AVX2 with fused multiply-add.
    #[cfg(target_arch = "x86_64")]
    Avx2,
    /// AVX-512 F with fused multiply-add.
    #[cfg(target_arch = "x86_64")]
    Avx512,
}

impl SimdLevel {
    /// The levels that this processor has, slowest first.
    pub fn available() -> Vec<Self> {
        #[allow(unused_mut)]
        let mut levels = vec![Self(Instructions::Portable)];
        #[cfg(target_arch = "aarch64")]
        levels.push(Self(Instructions::Neon));
        #[cfg(target_arch = "x86_64")]
        {
            if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
                levels.push(Self(Instructions::Avx2));
                if is_x86_feature_detected!("avx512f") {
                    levels.push(Self(Instructions::Avx512));
                }
            }
        }
        levels
    }

    /// The level in use. The first call chooses it, unless [`SimdLevel::make_current`] did: the level that the environment
    /// variable `SNAKE_SIMD` names (`portable`, `avx2`, `avx512`, `neon`) if this processor has it, else the fastest.
    pub fn current() -> Self {
        *CURRENT.get_or_init(|| {
            let wanted = std::env::var("SNAKE_SIMD").unwrap_or_default();
            let levels = Self::available();
            let named = levels.iter().find(|level| level.name() == wanted);
            named.or(levels.last()).copied().unwrap_or(Self(Instructions::Portable))
        })
    }

    /// Chooses this level for the program. All calls of a program use one level, so that they give the same bits.
    ///
    /// # Errors
    /// The level in use, when another level is in use already: call this before anything else.
    pub fn make_current(self) -> Result<(), Self> {
        match *CURRENT.get_or_init(|| self) {
            level if level == self => Ok(()),
            level => Err(level),
        }
    }

    /// The name of the level, as in `SNAKE_SIMD`.
    pub fn name(self) -> &'static str {
        match self.0 {
            Instructions::Portable => "portable",
            #[cfg(target_arch = "aarch64")]
            Instructions::Neon => "neon",
            #[cfg(target_arch = "x86_64")]
            Instructions::Avx2 => "avx2",
            #[cfg(target_arch = "x86_64")]
            Instructions::Avx512 => "avx512",
        }
    }
}

/// The level in use.
static CURRENT: OnceLock<SimdLevel> = OnceLock::new();

/// LANES numbers in the registers of a level.
pub(crate) trait Lanes: Copy {
    /// Whether multiply-adds round once.
    const FUSED: bool;
    /// Rows whose sums fit into the registers, beside a row of weights.
    const ROWS: usize;
    /// Whether the sums of two blocks of outputs for so many rows fit as well.
    const PAIRS: bool = false;
    fn load(values: &[f32; LANES]) -> Self;
    fn splat(value: f32) -> Self;
    /// `self * factor + addend`.
    fn multiply_add(self, factor: Self, addend: Self) -> Self;
    fn add(self, other: Self) -> Self;
    fn sub(self, other: Self) -> Self;
    /// The larger of each pair.
    fn max(self, other: Self) -> Self;
    /// `self` where `condition` is above zero, and zero elsewhere.
    fn mask_positive(self, condition: Self) -> Self;
    fn store(self, values: &mut [f32; LANES]);
    /// Prefetches the memory at an address, which need not be valid.
    fn prefetch(_address: *const f32) {}

    #[inline(always)]
    fn to_array(self) -> [f32; LANES] {
        let mut values = [0.0; LANES];
        self.store(&mut values);
        values
    }
}

/// The portable level: plain arrays, which the compiler maps to the baseline registers.
#[derive(Clone, Copy)]
pub(crate) struct PortableLanes([f32; LANES]);

impl Lanes for PortableLanes {
    const FUSED: bool = cfg!(target_arch = "aarch64");
    const ROWS: usize = 2;

    #[inline(always)]
    fn load(values: &[f32; LANES]) -> Self {
        Self(*values)
    }

    #[inline(always)]
    fn splat(value: f32) -> Self {
        Self([value; LANES])
    }

    #[inline(always)]
    fn multiply_add(self, factor: Self, addend: Self) -> Self {
        Self(std::array::from_fn(|lane| match Self::FUSED {
            true => self.0[lane].mul_add(factor.0[lane], addend.0[lane]),
            false => self.0[lane] * factor.0[lane] + addend.0[lane],
        }))
    }

    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self(std::array::from_fn(|lane| self.0[lane] + other.0[lane]))
    }

    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Self(std::array::from_fn(|lane| self.0[lane] - other.0[lane]))
    }

    #[inline(always)]
    fn max(self, other: Self) -> Self {
        Self(std::array::from_fn(|lane| if self.0[lane] > other.0[lane] { self.0[lane] } else { other.0[lane] }))
    }

    #[inline(always)]
    fn mask_positive(self, condition: Self) -> Self {
        Self(std::array::from_fn(|lane| if condition.0[lane] > 0.0 { self.0[lane] } else { 0.0 }))
    }

    #[inline(always)]
    fn store(self, values: &mut [f32; LANES]) {
        *values = self.0;
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
#[inline]
fn mask_positive_256(value: __m256, condition: __m256) -> __m256 {
    _mm256_and_ps(value, _mm256_cmp_ps::<_CMP_GT_OQ>(condition, _mm256_setzero_ps()))
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f")]
#[inline]
fn mask_positive_512(value: __m512, condition: __m512) -> __m512 {
    _mm512_maskz_mov_ps(_mm512_cmp_ps_mask::<_CMP_GT_OQ>(condition, _mm512_setzero_ps()), value)
}

/// Defines a [`Lanes`] of `$count` registers of a level.
#[cfg(target_arch = "x86_64")]
macro_rules! x86_lanes {
    ($(#[$doc:meta])* $name:ident, $register:ty, $count:literal, $rows:literal,
     $load:ident, $store:ident, $splat:ident, $fused:ident, $plus:ident, $minus:ident, $max:ident,
     $mask_positive:ident) => {
        $(#[$doc])*
        #[derive(Clone, Copy)]
        pub(crate) struct $name([$register; $count]);

        // SAFETY of each block: these methods are inlined into functions compiled for the level, which are called only
        // where `SimdLevel::available` found it; loads and stores stay within the LANES values of their array.
        impl Lanes for $name {
            const FUSED: bool = true;
            const ROWS: usize = $rows;
            const PAIRS: bool = $count == 1;

            #[inline(always)]
            fn prefetch(address: *const f32) {
                unsafe { std::arch::x86_64::_mm_prefetch::<{ std::arch::x86_64::_MM_HINT_T0 }>(address.cast()) }
            }

            #[inline(always)]
            fn load(values: &[f32; LANES]) -> Self {
                let mut lanes = Self::splat(0.0);
                for i in 0..$count {
                    lanes.0[i] = unsafe { std::arch::x86_64::$load(values.as_ptr().add(i * (LANES / $count))) };
                }
                lanes
            }

            #[inline(always)]
            fn splat(value: f32) -> Self {
                Self([unsafe { std::arch::x86_64::$splat(value) }; $count])
            }

            #[inline(always)]
            fn multiply_add(self, factor: Self, addend: Self) -> Self {
                let mut result = self;
                for i in 0..$count {
                    result.0[i] = unsafe { std::arch::x86_64::$fused(self.0[i], factor.0[i], addend.0[i]) };
                }
                result
            }

            #[inline(always)]
            fn add(self, other: Self) -> Self {
                let mut result = self;
                for i in 0..$count {
                    result.0[i] = unsafe { std::arch::x86_64::$plus(self.0[i], other.0[i]) };
                }
                result
            }

            #[inline(always)]
            fn sub(self, other: Self) -> Self {
                let mut result = self;
                for i in 0..$count {
                    result.0[i] = unsafe { std::arch::x86_64::$minus(self.0[i], other.0[i]) };
                }
                result
            }

            #[inline(always)]
            fn max(self, other: Self) -> Self {
                let mut result = self;
                for i in 0..$count {
                    result.0[i] = unsafe { std::arch::x86_64::$max(self.0[i], other.0[i]) };
                }
                result
            }

            #[inline(always)]
            fn mask_positive(self, condition: Self) -> Self {
                let mut result = self;
                for i in 0..$count {
                    result.0[i] = unsafe { $mask_positive(self.0[i], condition.0[i]) };
                }
                result
            }

            #[inline(always)]
            fn store(self, values: &mut [f32; LANES]) {
                for i in 0..$count {
                    unsafe { std::arch::x86_64::$store(values.as_mut_ptr().add(i * (LANES / $count)), self.0[i]) }
                }
            }
        }
    };
}
#[cfg(target_arch = "x86_64")]
x86_lanes!(
    Avx2Lanes,
    std::arch::x86_64::__m256,
    2,
    4,
    _mm256_loadu_ps,
    _mm256_storeu_ps,
    _mm256_set1_ps,
    _mm256_fmadd_ps,
    _mm256_add_ps,
    _mm256_sub_ps,
    _mm256_max_ps,
    mask_positive_256
);
#[cfg(target_arch = "x86_64")]
x86_lanes!(
    Avx512Lanes,
    std::arch::x86_64::__m512,
    1,
    8,
    _mm512_loadu_ps,
    _mm512_storeu_ps,
    _mm512_set1_ps,
    _mm512_fmadd_ps,
    _mm512_add_ps,
    _mm512_sub_ps,
    _mm512_max_ps,
    mask_positive_512
);

/// Defines the operations of [`NeonLanes`] that combine registers one by one.
#[cfg(target_arch = "aarch64")]
macro_rules! neon_operations {
    ($(fn $name:ident($($other:ident),*) = $operation:expr;)*) => {
        $(
            #[inline(always)]
            fn $name(self, $($other: Self),*) -> Self {
                let mut result = self;
                for i in 0..4 {
                    // SAFETY: every aarch64 processor that this is compiled for has NEON.
                    result.0[i] = unsafe { $operation(self.0[i], $($other.0[i]),*) };
                }
                result
            }
        )*
    };
}

/// NEON: four registers of four numbers.
#[cfg(target_arch = "aarch64")]
#[derive(Clone, Copy)]
pub(crate) struct NeonLanes([std::arch::aarch64::float32x4_t; 4]);

#[cfg(target_arch = "aarch64")]
impl Lanes for NeonLanes {
    const FUSED: bool = true;
    const ROWS: usize = 4;

    #[inline(always)]
    fn load(values: &[f32; LANES]) -> Self {
        // SAFETY: four numbers from each multiple of four are within the array of LANES.
        Self(std::array::from_fn(|i| unsafe { std::arch::aarch64::vld1q_f32(values.as_ptr().add(4 * i)) }))
    }

    #[inline(always)]
    fn splat(value: f32) -> Self {
        // SAFETY: every aarch64 processor that this is compiled for has NEON.
        Self([unsafe { std::arch::aarch64::vdupq_n_f32(value) }; 4])
    }

    neon_operations! {
        fn multiply_add(factor, addend) = |a, b, c| std::arch::aarch64::vfmaq_f32(c, a, b);
        fn add(other) = std::arch::aarch64::vaddq_f32;
        fn sub(other) = std::arch::aarch64::vsubq_f32;
        fn max(other) = |a, b| std::arch::aarch64::vbslq_f32(std::arch::aarch64::vcgtq_f32(a, b), a, b);
        fn mask_positive(condition) = |a, b| {
            let zero = std::arch::aarch64::vdupq_n_f32(0.0);
            std::arch::aarch64::vbslq_f32(std::arch::aarch64::vcgtq_f32(b, zero), a, zero)
        };
    }

    #[inline(always)]
    fn store(self, values: &mut [f32; LANES]) {
        for (i, register) in self.0.into_iter().enumerate() {
            // SAFETY: four numbers from each multiple of four are within the array of LANES.
            unsafe { std::arch::aarch64::vst1q_f32(values.as_mut_ptr().add(4 * i), register) }
        }
    }
}

/// Compiles `$body::<L, ROWS>(args)` for the [`Lanes`] of each level, and defines `$name(level, args)`, which calls the
/// version of the level.
macro_rules! simd_levels {
    ($(#[$doc:meta])* $visibility:vis fn $name:ident($($argument:ident: $kind:ty),* $(,)?) = $body:ident) => {
        $(#[$doc])*
        $visibility fn $name(level: $crate::simd::SimdLevel, $($argument: $kind),*) {
            use $crate::simd::*;
            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx2,fma")]
            fn avx2($($argument: $kind),*) {
                $body::<Avx2Lanes, { Avx2Lanes::ROWS }>($($argument),*)
            }
            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx512f,avx2,fma")]
            fn avx512($($argument: $kind),*) {
                $body::<Avx512Lanes, { Avx512Lanes::ROWS }>($($argument),*)
            }
            match level.0 {
                // SAFETY: a `SimdLevel` comes from `SimdLevel::available` alone, which asked the processor.
                #[cfg(target_arch = "x86_64")]
                Instructions::Avx2 => unsafe { avx2($($argument),*) },
                #[cfg(target_arch = "x86_64")]
                Instructions::Avx512 => unsafe { avx512($($argument),*) },
                #[cfg(target_arch = "aarch64")]
                Instructions::Neon => $body::<NeonLanes, { NeonLanes::ROWS }>($($argument),*),
                Instructions::Portable => $body::<PortableLanes, { PortableLanes::ROWS }>($($argument),*),
            }
        }
    };
}
pub(crate) use simd_levels;

/// `sums[b][r] += input[r * stride ..][.. weights[b].len()] * weights[b]` for ROWS rows and BLOCKS blocks of output channels, whose
/// weights are equally long. Each input is read once for all blocks.
#[inline(always)]
pub(crate) fn accumulate_tile<L: Lanes, const ROWS: usize, const BLOCKS: usize>(
    mut sums: [[L; ROWS]; BLOCKS],
    input: &[f32],
    stride: usize,
    weights: [&[[f32; LANES]]; BLOCKS],
) -> [[L; ROWS]; BLOCKS] {
    let length = weights[0].len();
    assert!(input.len() >= (ROWS - 1) * stride + length, "rows end within the input");
    let mut add = |k: usize, weights: [&[f32; LANES]; BLOCKS]| {
        let weights = weights.map(L::load);
        for r in 0..ROWS {
            // SAFETY: r < ROWS and k < length, so the index is below the length asserted above. A check of each product
            // would cost a third of the speed.
            let value = L::splat(unsafe { *input.get_unchecked(r * stride + k) });
            for (sums, weight) in sums.iter_mut().zip(weights) {
                sums[r] = value.multiply_add(weight, sums[r]);
            }
        }
    };
    // Equal lengths, and four at a time, so that indices are checked and the addresses of the rows computed once for them.
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
pub(crate) fn load<L: Lanes>(values: &[f32], lanes: usize) -> L {
    match values.first_chunk() {
        Some(values) if lanes == LANES => L::load(values),
        _ => {
            let mut padded = [0.0; LANES];
            padded[..lanes].copy_from_slice(&values[..lanes]);
            L::load(&padded)
        }
    }
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

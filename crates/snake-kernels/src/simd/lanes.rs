//! The SIMD registers of each level, and the tokens that are needed to make a value of them.

#[cfg(target_arch = "x86_64")]
use std::arch::x86_64::{
    __m256, __m512, _CMP_GT_OQ, _mm256_and_ps, _mm256_cmp_ps, _mm256_setzero_ps, _mm512_cmp_ps_mask,
    _mm512_maskz_mov_ps, _mm512_setzero_ps,
};

use super::LANES;

/// LANES numbers in the registers of a level. Making them requires the token of the level, which only detection gives.
pub(crate) trait Lanes: Copy {
    /// The proof that this processor has the instructions. It takes no memory.
    type Token: Copy;
    /// Whether multiply-adds round once.
    const FUSED: bool;
    /// Number of rows whose sums fit into the registers, together with a row of weights.
    const ROWS: usize;
    /// Whether the sums of two blocks of outputs for that many rows fit as well.
    const PAIRS: bool = false;
    fn load(token: Self::Token, values: &[f32; LANES]) -> Self;
    fn splat(token: Self::Token, value: f32) -> Self;
    /// The token with which these lanes were made.
    fn token(self) -> Self::Token;
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
    type Token = ();
    const FUSED: bool = cfg!(target_arch = "aarch64");
    const ROWS: usize = 2;

    #[inline(always)]
    fn load((): (), values: &[f32; LANES]) -> Self {
        Self(*values)
    }

    #[inline(always)]
    fn splat((): (), value: f32) -> Self {
        Self([value; LANES])
    }

    #[inline(always)]
    fn token(self) {}

    #[inline(always)]
    fn multiply_add(self, factor: Self, addend: Self) -> Self {
        Self(std::array::from_fn(|lane| {
            if Self::FUSED {
                self.0[lane].mul_add(factor.0[lane], addend.0[lane])
            } else {
                self.0[lane] * factor.0[lane] + addend.0[lane]
            }
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

/// Defines the operations of [`Lanes`] that work register by register.
#[cfg(any(target_arch = "x86_64", target_arch = "aarch64"))]
macro_rules! register_operations {
    ($(fn $name:ident($($other:ident),*) = $operation:expr;)*) => {
        $(
            #[inline(always)]
            fn $name(self, $($other: Self),*) -> Self {
                let mut result = self;
                for i in 0..result.0.len() {
                    // SAFETY: lanes are made with a token of the level only, so the processor has the instructions.
                    result.0[i] = unsafe { $operation(self.0[i], $($other.0[i]),*) };
                }
                result
            }
        )*
    };
}

/// Defines a [`Lanes`] type with `$count` registers of a level.
#[cfg(target_arch = "x86_64")]
macro_rules! x86_lanes {
    ($name:ident, $token:ident, $detected:expr, $register:ty, $count:literal, $rows:literal,
     $load:ident, $store:ident, $splat:ident, $fused:ident, $plus:ident, $minus:ident, $max:ident,
     $mask_positive:ident) => {
        /// The proof that this processor has the instructions of the level.
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        pub(crate) struct $token(());

        impl $token {
            /// `None` if this processor lacks the instructions.
            pub(crate) fn new() -> Option<Self> {
                ($detected).then_some(Self(()))
            }
        }

        #[derive(Clone, Copy)]
        pub(crate) struct $name([$register; $count]);

        // SAFETY of each block: a token of the level is given, or lanes, which only a token makes: the processor has the
        // instructions. Loads and stores stay within the LANES values of their array.
        impl Lanes for $name {
            type Token = $token;
            const FUSED: bool = true;
            const ROWS: usize = $rows;
            const PAIRS: bool = $count == 1;

            #[inline(always)]
            fn prefetch(address: *const f32) {
                unsafe { std::arch::x86_64::_mm_prefetch::<{ std::arch::x86_64::_MM_HINT_T0 }>(address.cast()) }
            }

            #[inline(always)]
            fn load(token: $token, values: &[f32; LANES]) -> Self {
                let mut lanes = Self::splat(token, 0.0);
                for i in 0..$count {
                    lanes.0[i] = unsafe { std::arch::x86_64::$load(values.as_ptr().add(i * (LANES / $count))) };
                }
                lanes
            }

            #[inline(always)]
            fn splat(_: $token, value: f32) -> Self {
                Self([unsafe { std::arch::x86_64::$splat(value) }; $count])
            }

            #[inline(always)]
            fn token(self) -> $token {
                $token(())
            }

            register_operations! {
                fn multiply_add(factor, addend) = std::arch::x86_64::$fused;
                fn add(other) = std::arch::x86_64::$plus;
                fn sub(other) = std::arch::x86_64::$minus;
                fn max(other) = std::arch::x86_64::$max;
                fn mask_positive(condition) = $mask_positive;
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
    Avx2Token,
    is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma"),
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
    Avx512Token,
    Avx2Token::new().is_some() && is_x86_feature_detected!("avx512f"),
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

/// NEON: four registers of four numbers.
#[cfg(target_arch = "aarch64")]
#[derive(Clone, Copy)]
pub(crate) struct NeonLanes([std::arch::aarch64::float32x4_t; 4]);

#[cfg(target_arch = "aarch64")]
impl Lanes for NeonLanes {
    type Token = ();
    const FUSED: bool = true;
    const ROWS: usize = 4;

    #[inline(always)]
    fn load((): (), values: &[f32; LANES]) -> Self {
        // SAFETY: four numbers from each multiple of four are within the array of LANES.
        Self(std::array::from_fn(|i| unsafe { std::arch::aarch64::vld1q_f32(values.as_ptr().add(4 * i)) }))
    }

    #[inline(always)]
    fn splat((): (), value: f32) -> Self {
        // SAFETY: every aarch64 processor that this is compiled for has NEON.
        Self([unsafe { std::arch::aarch64::vdupq_n_f32(value) }; 4])
    }

    #[inline(always)]
    fn token(self) {}

    register_operations! {
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

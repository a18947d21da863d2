//! Instruction-set levels and the one microkernel that convolutions and linear layers share.

use std::sync::OnceLock;

/// Output channels that a microkernel holds at a time; weights are packed in blocks of this many.
pub(crate) const LANES: usize = 16;

/// The instructions that kernels are compiled for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SimdLevel {
    /// What every processor of the architecture has (SSE2 on x86-64, NEON on aarch64).
    Portable,
    /// AVX2 with fused multiply-add.
    Avx2,
    /// AVX-512 F with fused multiply-add.
    Avx512,
}

impl SimdLevel {
    /// The levels that this processor can run, slowest first.
    pub fn available() -> Vec<Self> {
        #[allow(unused_mut)]
        let mut levels = vec![Self::Portable];
        #[cfg(target_arch = "x86_64")]
        {
            if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
                levels.push(Self::Avx2);
                if is_x86_feature_detected!("avx512f") {
                    levels.push(Self::Avx512);
                }
            }
        }
        levels
    }

    /// The level in use, chosen once: the fastest available, or the one that the environment variable `SNAKE_SIMD`
    /// names (`portable`, `avx2`, `avx512`) if this processor has it.
    pub fn current() -> Self {
        static LEVEL: OnceLock<SimdLevel> = OnceLock::new();
        *LEVEL.get_or_init(|| {
            let wanted = std::env::var("SNAKE_SIMD").unwrap_or_default();
            let levels = Self::available();
            let named = levels.iter().find(|level| level.name() == wanted);
            named.or(levels.last()).copied().unwrap_or(Self::Portable)
        })
    }

    /// The name that `SNAKE_SIMD` takes.
    pub fn name(self) -> &'static str {
        match self {
            Self::Portable => "portable",
            Self::Avx2 => "avx2",
            Self::Avx512 => "avx512",
        }
    }
}

/// LANES numbers in a level's registers.
pub(crate) trait Lanes: Copy {
    /// Whether multiply-adds round once.
    const FUSED: bool;
    /// Rows whose sums fit into the registers beside a row of weights.
    const ROWS: usize;
    fn load(values: &[f32; LANES]) -> Self;
    fn splat(value: f32) -> Self;
    /// `self * factor + addend`.
    fn multiply_add(self, factor: Self, addend: Self) -> Self;
    fn to_array(self) -> [f32; LANES];
}

/// The portable level: plain arrays, which the compiler fits to the architecture's baseline registers.
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
    fn to_array(self) -> [f32; LANES] {
        self.0
    }
}

/// Defines a [`Lanes`] of `$count` registers of a level.
#[cfg(target_arch = "x86_64")]
macro_rules! x86_lanes {
    ($(#[$doc:meta])* $name:ident, $register:ty, $count:literal, $rows:literal, $splat:ident, $fused:ident) => {
        $(#[$doc])*
        #[derive(Clone, Copy)]
        pub(crate) struct $name([$register; $count]);

        // SAFETY of each block: these methods are inlined into functions compiled for the level, which are called only
        // where `SimdLevel::available` found it; arrays of registers and of floats have the same size and accept any
        // bits.
        impl Lanes for $name {
            const FUSED: bool = true;
            const ROWS: usize = $rows;

            #[inline(always)]
            fn load(values: &[f32; LANES]) -> Self {
                Self(unsafe { std::mem::transmute::<[f32; LANES], [$register; $count]>(*values) })
            }

            #[inline(always)]
            fn splat(value: f32) -> Self {
                Self([unsafe { std::arch::x86_64::$splat(value) }; $count])
            }

            #[inline(always)]
            fn multiply_add(self, factor: Self, addend: Self) -> Self {
                let fused = |i: usize| unsafe { std::arch::x86_64::$fused(self.0[i], factor.0[i], addend.0[i]) };
                Self(std::array::from_fn(fused))
            }

            #[inline(always)]
            fn to_array(self) -> [f32; LANES] {
                unsafe { std::mem::transmute::<[$register; $count], [f32; LANES]>(self.0) }
            }
        }
    };
}
#[cfg(target_arch = "x86_64")]
x86_lanes!(Avx2Lanes, std::arch::x86_64::__m256, 2, 4, _mm256_set1_ps, _mm256_fmadd_ps);
#[cfg(target_arch = "x86_64")]
x86_lanes!(Avx512Lanes, std::arch::x86_64::__m512, 1, 8, _mm512_set1_ps, _mm512_fmadd_ps);

/// Compiles `$body::<L, ROWS>(args)` for each level's [`Lanes`] and defines `$name(level, args)` that calls the right
/// one.
macro_rules! simd_levels {
    ($(#[$doc:meta])* $visibility:vis fn $name:ident($($argument:ident: $kind:ty),* $(,)?) = $body:ident) => {
        $(#[$doc])*
        $visibility fn $name(level: $crate::kernels::SimdLevel, $($argument: $kind),*) {
            use $crate::kernels::simd::*;
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
            match level {
                // SAFETY: these levels come from `SimdLevel::available`, which asked the processor.
                #[cfg(target_arch = "x86_64")]
                SimdLevel::Avx2 => unsafe { avx2($($argument),*) },
                #[cfg(target_arch = "x86_64")]
                SimdLevel::Avx512 => unsafe { avx512($($argument),*) },
                _ => $body::<PortableLanes, { PortableLanes::ROWS }>($($argument),*),
            }
        }
    };
}
pub(crate) use simd_levels;

/// `sums[r] += input[r * stride ..][.. weights.len()] * weights` for ROWS rows and one block of output channels.
#[inline(always)]
pub(crate) fn accumulate_tile<L: Lanes, const ROWS: usize>(
    mut sums: [L; ROWS],
    input: &[f32],
    stride: usize,
    weights: &[[f32; LANES]],
) -> [L; ROWS] {
    let rows: [&[f32]; ROWS] = std::array::from_fn(|r| &input[r * stride..][..weights.len()]);
    for (k, weight) in weights.iter().enumerate() {
        let weight = L::load(weight);
        for r in 0..ROWS {
            sums[r] = L::splat(rows[r][k]).multiply_add(weight, sums[r]);
        }
    }
    sums
}

/// Packs rows of weights `(outputs, inputs)` into blocks of LANES outputs: `[block][input][lane]`, zero beyond.
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

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

/// Compiles `$body::<FUSED, ROWS>(args)` once per level and defines `$name(level, args)` that calls the right one.
///
/// FUSED: multiply-adds round once. ROWS: rows that a tile keeps in registers at that level.
macro_rules! simd_levels {
    ($(#[$doc:meta])* $visibility:vis fn $name:ident($($argument:ident: $kind:ty),* $(,)?) = $body:ident) => {
        $(#[$doc])*
        $visibility fn $name(level: $crate::kernels::SimdLevel, $($argument: $kind),*) {
            const FUSED_BASELINE: bool = cfg!(target_arch = "aarch64");
            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx2,fma")]
            fn avx2($($argument: $kind),*) {
                $body::<true, 4>($($argument),*)
            }
            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx512f,avx2,fma")]
            fn avx512($($argument: $kind),*) {
                $body::<true, 8>($($argument),*)
            }
            match level {
                // SAFETY: these levels come from `SimdLevel::available`, which asked the processor.
                #[cfg(target_arch = "x86_64")]
                $crate::kernels::SimdLevel::Avx2 => unsafe { avx2($($argument),*) },
                #[cfg(target_arch = "x86_64")]
                $crate::kernels::SimdLevel::Avx512 => unsafe { avx512($($argument),*) },
                _ => $body::<FUSED_BASELINE, 2>($($argument),*),
            }
        }
    };
}
pub(crate) use simd_levels;

/// a * b + c.
#[inline(always)]
pub(crate) fn multiply_add<const FUSED: bool>(a: f32, b: f32, c: f32) -> f32 {
    if FUSED { a.mul_add(b, c) } else { a * b + c }
}

/// `sums[r] += input[r * stride ..][.. weights.len()] * weights` for ROWS rows and one block of output channels.
#[inline(always)]
pub(crate) fn accumulate_tile<const FUSED: bool, const ROWS: usize>(
    sums: &mut [[f32; LANES]; ROWS],
    input: &[f32],
    stride: usize,
    weights: &[[f32; LANES]],
) {
    let rows: [&[f32]; ROWS] = std::array::from_fn(|r| &input[r * stride..][..weights.len()]);
    for (k, weight) in weights.iter().enumerate() {
        for (sum, row) in sums.iter_mut().zip(&rows) {
            let value = row[k];
            for (s, w) in sum.iter_mut().zip(weight) {
                *s = multiply_add::<FUSED>(value, *w, *s);
            }
        }
    }
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

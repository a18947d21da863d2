//! SIMD levels: the sets of instructions for which the kernels are compiled.

use std::sync::OnceLock;

#[cfg(target_arch = "x86_64")]
use super::lanes::{Avx2Token, Avx512Token};

/// A SIMD level that this processor has.
///
/// A level can only come from detection ([`SimdLevel::available`], [`SimdLevel::current`]). So a kernel can rely on the
/// instructions of the level that it is given, which holds the token of their lanes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SimdLevel(pub(crate) Instructions);

/// The instructions for which kernels are compiled.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Instructions {
    /// Plain loops: SSE2 on x86-64, and the baseline instructions of the compiler's target elsewhere.
    Portable,
    /// NEON, which every aarch64 processor has.
    #[cfg(target_arch = "aarch64")]
    Neon,
    /// AVX2 with fused multiply-add.
    #[cfg(target_arch = "x86_64")]
    Avx2(Avx2Token),
    /// AVX-512 F with fused multiply-add.
    #[cfg(target_arch = "x86_64")]
    Avx512(Avx512Token),
}

impl SimdLevel {
    /// The levels that this processor has, slowest first.
    pub fn available() -> Vec<Self> {
        #[allow(unused_mut)]
        let mut levels = vec![Self(Instructions::Portable)];
        #[cfg(target_arch = "aarch64")]
        levels.push(Self(Instructions::Neon));
        #[cfg(target_arch = "x86_64")]
        levels.extend(Avx2Token::new().map(|token| Self(Instructions::Avx2(token))));
        #[cfg(target_arch = "x86_64")]
        levels.extend(Avx512Token::new().map(|token| Self(Instructions::Avx512(token))));
        levels
    }

    /// The level in use. The first call chooses it, unless [`SimdLevel::make_current`] did: the level that `SNAKE_SIMD`
    /// names in the environment (`portable`, `avx2`, `avx512`, `neon`) if this processor has it, else the fastest.
    pub fn current() -> Self {
        *CURRENT.get_or_init(|| {
            let wanted = std::env::var("SNAKE_SIMD").unwrap_or_default();
            let levels = Self::available();
            let named = levels.iter().find(|level| level.name() == wanted);
            named.or(levels.last()).copied().unwrap_or(Self(Instructions::Portable))
        })
    }

    /// Refuses a `SNAKE_SIMD` that names no level of this processor. [`SimdLevel::current`] would use the fastest level.
    ///
    /// # Errors
    /// The refusal in words.
    pub fn check_environment() -> Result<(), String> {
        let wanted = std::env::var("SNAKE_SIMD").unwrap_or_default();
        let names: Vec<&str> = Self::available().into_iter().map(Self::name).collect();
        if wanted.is_empty() || names.contains(&&wanted[..]) {
            return Ok(());
        }
        Err(format!("SNAKE_SIMD is {wanted}: allowed is {}", names.join(" or ")))
    }

    /// Chooses this level for the program. All calls of a program use one level, so they give the same bits.
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
            Instructions::Avx2(_) => "avx2",
            #[cfg(target_arch = "x86_64")]
            Instructions::Avx512(_) => "avx512",
        }
    }
}

/// The level in use.
static CURRENT: OnceLock<SimdLevel> = OnceLock::new();

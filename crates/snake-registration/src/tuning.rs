//! Constants of a step as one table: a row says what the constant is, its value, its unit and where
//! the value comes from.

/// The constants of a step, `TUNING`, and the struct that documents them:
///
/// ```text
/// tuning! {
///     /// Largest number of matches from which transforms are estimated.
///     max_seeds: usize = 200, unit "matches", from "set by hand";
/// }
/// ```
macro_rules! tuning {
    ($( $(#[doc = $doc:literal])+ $name:ident: $type:ty = $value:expr, unit $unit:literal, from $source:literal; )+) => {
        /// The constants of this step: what each is, its unit, and where its value comes from. Seven
        /// hexadecimal digits are a commit of the repository.
        #[derive(Debug, Clone, Copy)]
        #[non_exhaustive]
        pub struct Tuning { $(
            $(#[doc = $doc])+
            #[doc = concat!("\nValue: `", stringify!($value), "` (", $unit, "); ", $source, ".")]
            pub $name: $type,
        )+ }

        /// The values of the constants.
        #[cfg(not(feature = "scan"))]
        pub const TUNING: Tuning = Tuning { $($name: $value),+ };

        /// The values of the constants, changed as `SNAKE_SCAN` says.
        #[cfg(feature = "scan")]
        pub static TUNING: std::sync::LazyLock<Tuning> = std::sync::LazyLock::new(|| Tuning {
            $($name: $crate::tuning::scan::scanned(concat!(module_path!(), "::", stringify!($name)), $value)),+
        });
    };
}
pub(crate) use tuning;

/// What a constant changes, as `tests/bench/sensitivity.py` asks: `SNAKE_SCAN=snake_registration::cloud::planes::NAME=0.5`
/// multiplies a constant; several are separated by commas.
#[cfg(feature = "scan")]
pub(crate) mod scan {
    use std::num::NonZeroUsize;

    pub(crate) trait Scanned {
        fn times(self, factor: f64) -> Self;
    }

    macro_rules! scanned {
        ($($type:ty: $times:expr;)+) => {
            $(impl Scanned for $type {
                fn times(self, factor: f64) -> Self {
                    $times(self, factor)
                }
            })+
        };
    }
    scanned! {
        f32: |value: f32, factor: f64| value * factor as f32;
        f64: |value: f64, factor: f64| value * factor;
        i32: |value: i32, factor: f64| (f64::from(value) * factor).round() as i32;
        usize: |value: usize, factor: f64| (value as f64 * factor).round() as usize;
        NonZeroUsize: |value: NonZeroUsize, factor| NonZeroUsize::new(value.get().times(factor)).unwrap_or(value);
        (f64, usize): |value: (f64, usize), factor: f64| (value.0.times(factor), value.1);
    }

    impl<T: Scanned, const N: usize> Scanned for [T; N] {
        fn times(self, factor: f64) -> Self {
            self.map(|value| value.times(factor))
        }
    }

    pub(crate) fn scanned<T: Scanned>(name: &str, value: T) -> T {
        let asked = std::env::var("SNAKE_SCAN").unwrap_or_default();
        let factors = asked.split(',').filter_map(|one| one.split_once('=')).filter(|(of, _)| *of == name);
        factors.fold(value, |value, (_, factor)| value.times(factor.parse().expect("a factor")))
    }
}

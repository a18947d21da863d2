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
        pub const TUNING: Tuning = Tuning { $($name: $value),+ };
    };
}
pub(crate) use tuning;

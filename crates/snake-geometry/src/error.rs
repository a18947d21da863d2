//! The error type of the crate.

use crate::shortened;

/// An error. Its text says what to do about it.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// An argument cannot be used.
    #[error("{what}: {}", shortened(reason))]
    Input {
        /// The name of the argument.
        what: &'static str,
        /// The reason.
        reason: String,
    },
    /// An option is outside its range.
    #[error("option `{name}` is {}: allowed is {allowed}", shortened(value))]
    Option {
        /// The name of the option in the options struct.
        name: &'static str,
        /// The given value.
        value: String,
        /// The allowed values.
        allowed: &'static str,
    },
}

/// A result with the crate's [`Error`].
pub type Result<T> = std::result::Result<T, Error>;

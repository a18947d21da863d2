//! The error type of geometry, files, the field and registration.

use std::path::PathBuf;

use crate::{shortened, shortened_value};

/// An error. Its text says what to do.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file could not be opened, read or written.
    #[error("{}: {source}", shortened_value(&path.display()))]
    Io {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// The content of a file does not follow its format, or the extension names no known format.
    #[error("{}: {}", shortened_value(&path.display()), shortened(reason))]
    Format {
        /// The file.
        path: PathBuf,
        /// The fault, with the line or the byte offset where one is known.
        reason: String,
    },
    /// A weight file does not match the network that its metadata describes.
    #[error("weights: `{tensor}`: expected {expected}, found {found}")]
    Weights {
        /// The tensor or the metadata key.
        tensor: String,
        /// The expected content.
        expected: String,
        /// The content of the file.
        found: String,
    },
    /// An argument cannot be used.
    #[error("{what}: {}", shortened(reason))]
    Input {
        /// The name of the argument.
        what: &'static str,
        /// The reason.
        reason: String,
    },
    /// No rigid transform fits two clouds: they do not overlap, or are in different units.
    #[error("source and target: {}", shortened(reason))]
    NoTransform {
        /// The attempts, and the likely fault.
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
    /// The caller cancelled the call with a `CancelFlag`.
    #[error("cancelled")]
    Cancelled,
    /// The call did not end before its deadline.
    #[error("the deadline passed before the call ended")]
    DeadlineExceeded,
}

/// A result with the [`Error`].
pub type Result<T> = std::result::Result<T, Error>;

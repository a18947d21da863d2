//! The error type of the crate.

use std::path::PathBuf;

use snake_geometry::{shortened, shortened_value};

/// An error. Its text gives the way out.
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
    /// The caller cancelled the call with its [`CancelFlag`](crate::CancelFlag).
    #[error("cancelled")]
    Cancelled,
    /// The call did not end before its [deadline](crate::Control::deadline).
    #[error("the deadline passed before the call ended")]
    DeadlineExceeded,
}

/// A result with the crate's [`Error`].
pub type Result<T> = std::result::Result<T, Error>;

impl From<snake_geometry::Error> for Error {
    fn from(error: snake_geometry::Error) -> Self {
        match error {
            snake_geometry::Error::Input { what, reason } => Self::Input { what, reason },
            snake_geometry::Error::Option { name, value, allowed } => Self::Option { name, value, allowed },
            other => Self::Input { what: "points", reason: other.to_string() },
        }
    }
}

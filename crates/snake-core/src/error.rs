//! The one error type of the crate.

use std::path::PathBuf;

/// What went wrong, in words that say what to do about it.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file could not be opened, read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the operating system said.
        source: std::io::Error,
    },
    /// A weight file does not hold the network that it claims to hold.
    #[error("weights: `{tensor}`: expected {expected}, found {found}")]
    Weights {
        /// The tensor or the metadata key.
        tensor: String,
        /// What the network needs there.
        expected: String,
        /// What the file holds.
        found: String,
    },
    /// An array handed in cannot be used.
    #[error("{what}: {reason}")]
    Input {
        /// Which argument.
        what: &'static str,
        /// Why it cannot be used.
        reason: String,
    },
    /// An option is outside its range.
    #[error("option `{name}` is {value}: allowed is {allowed}")]
    Option {
        /// The option's name, as in the options struct.
        name: &'static str,
        /// The value given.
        value: String,
        /// The values that can be used.
        allowed: &'static str,
    },
    /// The caller cancelled the call by its [`CancelFlag`](crate::CancelFlag).
    #[error("cancelled")]
    Cancelled,
    /// The call was not done by its [deadline](crate::Control::deadline).
    #[error("the deadline passed before the call was done")]
    DeadlineExceeded,
}

/// A result with the crate's [`Error`].
pub type Result<T> = std::result::Result<T, Error>;

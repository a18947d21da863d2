//! The one error type of the crate.

use std::path::PathBuf;

/// A file that cannot be read or written, and why.
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
    /// A file's content does not follow its format, or its extension names none.
    #[error("{}: {reason}", path.display())]
    Format {
        /// The file.
        path: PathBuf,
        /// What is wrong, with the line or the byte offset where one is known.
        reason: String,
    },
    /// An argument cannot be used.
    #[error("{what}: {reason}")]
    Input {
        /// The argument.
        what: &'static str,
        /// Why it cannot be used.
        reason: String,
    },
}

/// A result with the crate's [`Error`].
pub type Result<T> = std::result::Result<T, Error>;

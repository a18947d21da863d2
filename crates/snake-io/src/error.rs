//! The error type of the crate.

use std::path::PathBuf;

use snake_geometry::{shortened, shortened_value};

/// The reason why a file cannot be read or written.
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
    /// An argument cannot be used.
    #[error("{what}: {}", shortened(reason))]
    Input {
        /// The name of the argument.
        what: &'static str,
        /// The reason why it cannot be used.
        reason: String,
    },
}

/// A result with the crate's [`Error`].
pub type Result<T> = std::result::Result<T, Error>;

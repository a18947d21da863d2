//! The error type of the crate.

use std::path::PathBuf;

/// An error. Its text says what to do about it.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The model refuses its options or a tile.
    #[error(transparent)]
    Core(#[from] snake_core::Error),
    /// An input file cannot be read.
    #[error(transparent)]
    Input(#[from] snake_io::Error),
    /// A file of the run's folder cannot be read or written.
    #[error("{}: {source}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// A file of the run's folder has another content than was written.
    #[error("{}: {reason}; remove the folder to begin again", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// The cloud or the tiles cannot be used.
    #[error("{what}: {reason}")]
    Refused {
        /// The name of the argument.
        what: &'static str,
        /// The reason.
        reason: String,
    },
}

/// A result with the crate's [`Error`].
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    /// The error of a file of the run's folder.
    pub(crate) fn file(path: &std::path::Path) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::File { path, source }
    }
}

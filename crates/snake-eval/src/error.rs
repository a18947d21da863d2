//! The error type of data sets and their views.

use std::path::{Path, PathBuf};

use snake_geometry::{shortened, shortened_value};

/// The reason why a data set cannot be opened or a view cannot be drawn.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file or a folder of a data set cannot be read.
    #[error("cannot read {}: {source}", shortened_value(&path.display()))]
    Io {
        /// The file or the folder.
        path: PathBuf,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// A file or a folder does not follow the layout of its data set.
    #[error("{}: {}", shortened_value(&path.display()), shortened(reason))]
    Layout {
        /// The file or the folder.
        path: PathBuf,
        /// The fault, with the entry where one is known.
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
    /// A cloud or an array cannot be read from its file.
    #[error(transparent)]
    File(#[from] snake_io::Error),
    /// A cloud cannot be used, for example because it has no extent.
    #[error(transparent)]
    Core(#[from] snake_core::Error),
}

impl From<snake_geometry::Error> for Error {
    fn from(error: snake_geometry::Error) -> Self {
        Self::Core(error.into())
    }
}

/// A result with the crate's [`Error`].
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    /// The error of a file or folder that cannot be read.
    pub(crate) fn io(path: &Path, source: std::io::Error) -> Self {
        Self::Io { path: path.into(), source }
    }

    /// The error of a file or folder that does not follow its layout.
    pub(crate) fn layout(path: &Path, reason: impl Into<String>) -> Self {
        Self::Layout { path: path.into(), reason: reason.into() }
    }
}

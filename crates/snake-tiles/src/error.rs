//! The error type of the crate.

use std::path::{Path, PathBuf};

use snake_geometry::{shortened, shortened_value};

use crate::plan::Tile;

/// An error. Its text gives the way out.
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
    #[error("{}: {source}", shortened_value(&path.display()))]
    File {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// A file of the run's folder has another content than was written.
    #[error("{}: {}", shortened_value(&path.display()), shortened(reason))]
    Damaged {
        /// The file.
        path: PathBuf,
        /// The fault.
        reason: String,
    },
    /// Another process uses the folder.
    #[error("{} is in use by {holder}; {advice}", folder.display())]
    InUse {
        /// The folder.
        folder: PathBuf,
        /// The process and its host.
        holder: String,
        /// The way out.
        advice: String,
    },
    /// Tiles have no result, so that their keypoints would be missing.
    #[error("{} of {total} tiles are missing: {}; detect them first", missing.len(), places(missing))]
    Missing {
        /// The tiles.
        missing: Vec<Tile>,
        /// Number of all tiles.
        total: usize,
    },
    /// The cloud or the tiles cannot be used.
    #[error("{what}: {}", shortened(reason))]
    Refused {
        /// The name of the argument.
        what: &'static str,
        /// The reason.
        reason: String,
    },
}

impl From<snake_geometry::Error> for Error {
    fn from(error: snake_geometry::Error) -> Self {
        Self::Core(error.into())
    }
}

/// A result with the crate's [`Error`].
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    /// The error of a file of the run's folder.
    pub(crate) fn file(path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::File { path, source }
    }

    /// The error of a file whose checksum does not fit.
    pub(crate) fn damaged(path: &Path) -> Self {
        let reason = "is damaged: its checksum does not fit; the same run writes it again".into();
        Self::Damaged { path: path.into(), reason }
    }

    /// The error of a file in the run's folder that no run wrote.
    pub(crate) fn not_own(folder: &Path, name: &Path) -> Self {
        let reason = format!(
            "{} has `{}`, which no run wrote; move it away, or name a `folder` that is new or empty",
            folder.display(),
            name.display()
        );
        Self::Refused { what: "the folder of the tiles", reason }
    }
}

/// The places of some tiles.
fn places(tiles: &[Tile]) -> String {
    let place = |tile: &Tile| format!("{}_{}", tile.place[0], tile.place[1]);
    let mut text = tiles.iter().take(5).map(place).collect::<Vec<_>>().join(", ");
    if tiles.len() > 5 {
        text += ", ..";
    }
    text
}

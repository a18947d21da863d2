//! The error type of the crate.

use std::path::{Path, PathBuf};

use snake_geometry::{shortened, shortened_value};

use crate::plan::Tile;

/// An error. Its text says what to do.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// An input or a file of the run's folder cannot be read or written, or the model refuses its options or a tile.
    #[error(transparent)]
    Core(#[from] snake_core::Error),
    /// A file in the run's folder does not have the content that the run wrote.
    #[error("{}: {}", shortened_value(&path.display()), shortened(reason))]
    Damaged {
        /// The file.
        path: PathBuf,
        /// The fault.
        reason: String,
    },
    /// Some tiles have no result, so their keypoints would be missing.
    #[error("{} of {total} tiles are missing: {}; detect them first", missing.len(), places(missing))]
    Missing {
        /// The tiles without a result.
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

/// A result with the crate's [`Error`].
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    /// The error for a file in the run's folder.
    pub(crate) fn file(path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::Core(snake_core::Error::Io { path, source })
    }

    /// The error for a file that is not as the run left it.
    pub(crate) fn damaged(path: &Path, fault: &str) -> Self {
        let reason = format!("is damaged: {fault}; remove the folder of the tiles, and begin again");
        Self::Damaged { path: path.into(), reason }
    }

    /// The error for a file in the run's folder that no run wrote.
    pub(crate) fn not_own(folder: &Path, name: &str) -> Self {
        let fault = format!("has `{name}`, which no run wrote; move it away, or name a `folder` that is new or empty");
        Self::folder(folder, &fault)
    }

    /// The error for a folder that has a run of another id.
    pub(crate) fn other_run(folder: &Path) -> Self {
        let fault = "has the tiles of other inputs, options or weights, or of another version; remove it, or name a `folder` \
                     that is new or empty";
        Self::folder(folder, fault)
    }

    /// The error for a process whose run was removed by another process.
    pub(crate) fn removed(folder: &Path) -> Self {
        Self::folder(folder, "is no longer there: another process with the same run ended and removed it")
    }

    fn folder(folder: &Path, fault: &str) -> Self {
        Self::Refused { what: "the folder of the tiles", reason: format!("{} {fault}", folder.display()) }
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

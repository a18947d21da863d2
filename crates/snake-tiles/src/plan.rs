//! The plan of a run: what it was made from, and its tiles.

use std::ops::Range;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use serde::{Deserialize, Serialize};
use snake_core::TileSettings;
use snake_io::Crs;

use crate::{Error, Result};

/// Everything that decides the content of a run's folder.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Source {
    /// The version of this crate.
    version: String,
    /// Each input file with its size and the time of its last change.
    files: Vec<(PathBuf, u64, Option<SystemTime>)>,
    /// How the files are read.
    read: String,
    /// Columns along the side of a tile.
    columns: i32,
    /// Model and options.
    settings: TileSettings,
}

impl Source {
    pub(crate) fn new(
        files: &[PathBuf],
        read: &snake_io::ReadOptions,
        columns: i32,
        settings: TileSettings,
    ) -> Result<Self> {
        let file = |path: &PathBuf| {
            let metadata = path.metadata().map_err(Error::file(path))?;
            let absolute = path.canonicalize().map_err(Error::file(path))?;
            Ok((absolute, metadata.len(), metadata.modified().ok()))
        };
        let files = files.iter().map(file).collect::<Result<_>>()?;
        Ok(Self { version: env!("CARGO_PKG_VERSION").into(), files, read: format!("{read:?}"), columns, settings })
    }
}

/// An input file that could not be read.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Failure {
    /// The file.
    pub path: PathBuf,
    /// The reason.
    pub reason: String,
}

/// A tile that has points.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Tile {
    /// Its place among the tiles, along x and y.
    pub place: [i32; 2],
    /// Number of its points.
    pub num_points: u64,
    /// Number of its windows, which take about equal times.
    pub num_windows: u64,
}

/// The tiles of a run, written once all points are on disk.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Plan {
    pub(crate) source: Source,
    /// Added to all points, see [`snake_core::Cloud::origin`].
    pub(crate) origin: [f64; 3],
    pub(crate) crs: Option<Crs>,
    /// Points of all files, those that are not finite included.
    pub(crate) num_points: u64,
    pub(crate) num_skipped: u64,
    pub(crate) failures: Vec<Failure>,
    /// By place, ascending.
    pub(crate) tiles: Vec<Tile>,
}

impl Plan {
    fn path(folder: &Path) -> PathBuf {
        folder.join("plan.json")
    }

    /// The plan in a folder, if it is complete and from the same source.
    pub(crate) fn read(folder: &Path, source: &Source) -> Option<Self> {
        let plan: Self = serde_json::from_slice(&std::fs::read(Self::path(folder)).ok()?).ok()?;
        (plan.source == *source).then_some(plan)
    }

    /// The plan in a folder, whatever its inputs were. It must have the settings.
    pub(crate) fn of_settings(folder: &Path, settings: &TileSettings) -> Result<Self> {
        let path = Self::path(folder);
        let bytes = std::fs::read(&path).map_err(Error::file(&path))?;
        let damaged = |reason| Error::Damaged { path: path.clone(), reason };
        let plan: Self = serde_json::from_slice(&bytes).map_err(|error| damaged(error.to_string()))?;
        if plan.source.settings != *settings || plan.source.version != env!("CARGO_PKG_VERSION") {
            return Err(damaged("is of another model, other options or another version".into()));
        }
        Ok(plan)
    }

    pub(crate) fn write(&self, folder: &Path) -> Result<()> {
        let path = Self::path(folder);
        let written = snake_io::write_atomically(&path, |file| Ok(serde_json::to_writer(file, self)?));
        written.map_err(Error::file(&path))
    }

    /// Removes the files of earlier runs. A folder with other files is refused.
    pub(crate) fn clear(folder: &Path) -> Result<()> {
        let error = || Error::file(folder);
        std::fs::create_dir_all(folder).map_err(error())?;
        let known = ["plan.json", "points", "candidates"];
        for entry in folder.read_dir().map_err(error())? {
            let entry = entry.map_err(error())?;
            if !known.iter().any(|name| entry.file_name() == *name) {
                let reason = format!("has the file {}, which is not of a run", entry.file_name().display());
                return Err(Error::Refused { what: "the folder of the tiles", reason });
            }
        }
        let path = Self::path(folder);
        if path.exists() {
            std::fs::remove_file(&path).map_err(Error::file(&path))?;
        }
        for name in ["points", "candidates"] {
            let path = folder.join(name);
            if path.exists() {
                std::fs::remove_dir_all(&path).map_err(Error::file(&path))?;
            }
            std::fs::create_dir(&path).map_err(Error::file(&path))?;
        }
        Ok(())
    }

    /// The columns of cells of the tile at a place.
    pub(crate) fn columns(&self, place: [i32; 2]) -> [Range<i32>; 2] {
        let side = self.source.columns;
        place.map(|place| place * side..(place + 1) * side)
    }

    /// The place of the tile of a cell.
    pub(crate) fn place(&self, [x, y, _]: [i32; 3]) -> [i32; 2] {
        place(self.source.columns, [x, y])
    }

    /// The tiles that have columns in a range.
    pub(crate) fn tiles_in(&self, columns: &[Range<i32>; 2]) -> impl Iterator<Item = &Tile> {
        let [x, y] = columns.clone().map(|range| place(self.source.columns, [range.start, range.end - 1]));
        let first = self.tiles.partition_point(|tile| tile.place[0] < x[0]);
        let end = self.tiles.partition_point(|tile| tile.place[0] <= x[1]);
        self.tiles[first..end].iter().filter(move |tile| (y[0]..=y[1]).contains(&tile.place[1]))
    }
}

/// The places of columns.
pub(crate) fn place(side: i32, columns: [i32; 2]) -> [i32; 2] {
    columns.map(|column| column.div_euclid(side))
}

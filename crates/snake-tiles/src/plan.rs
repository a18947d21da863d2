//! The plan of a run: what it was made from, and its tiles.

use std::ops::Range;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use snake_core::TileSettings;
use snake_io::{Copc, Crs, LocalFile, Ranges};

use crate::{Error, Result};

/// Everything that decides the content of a run's folder.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Source {
    /// The version of this crate.
    version: String,
    /// Each input file with its size and its version, for files on disk the time of the last change.
    files: Vec<(PathBuf, u64, String)>,
    /// Whether the points are read from the files by bounds.
    pub(crate) by_bounds: bool,
    /// How the files are read.
    read: String,
    /// Columns along the side of a tile.
    pub(crate) columns: i32,
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
            let read = || identity(&LocalFile::new(path)?);
            read().map_err(Error::file(path))
        };
        let files = files.iter().map(file).collect::<Result<_>>()?;
        let (version, read) = (env!("CARGO_PKG_VERSION").into(), format!("{read:?}"));
        Ok(Self { version, files, by_bounds: false, read, columns, settings })
    }

    /// The source of a run that reads COPC files by bounds.
    pub(crate) fn of_copc(files: &[Copc], columns: i32, settings: TileSettings) -> Result<Self> {
        let (version, files) = (env!("CARGO_PKG_VERSION").into(), identities(files)?);
        Ok(Self { version, files, by_bounds: true, read: String::new(), columns, settings })
    }
}

/// The name, the size and the version of a file.
fn identity(file: &dyn Ranges) -> std::io::Result<(PathBuf, u64, String)> {
    Ok((file.path().into(), file.length()?, file.version()?))
}

fn identities(files: &[Copc]) -> Result<Vec<(PathBuf, u64, String)>> {
    files.iter().map(|file| identity(file.source()).map_err(Error::file(file.source().path()))).collect()
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
    /// Number of its points; an estimate when they are read from COPC files.
    pub num_points: u64,
    /// Number of its windows, which take about equal times. For COPC files the number of its columns, with or without points.
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

    /// The paths of the input files.
    pub(crate) fn files(&self) -> impl Iterator<Item = &Path> {
        self.source.files.iter().map(|(path, ..)| path.as_path())
    }

    /// Refuses other COPC files than those of the run.
    pub(crate) fn check_files(&self, folder: &Path, files: &[Copc]) -> Result<()> {
        if self.source.by_bounds && self.source.files == identities(files)? {
            return Ok(());
        }
        Err(Error::Damaged { path: Self::path(folder), reason: "is of other files, or a file has changed".into() })
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
        // The folder `inputs` has copies of files behind URLs, which are kept.
        let known = ["plan.json", "points", "candidates", "inputs"];
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

    /// Whether all tiles lie in a range of columns.
    pub(crate) fn is_inside(&self, columns: &[Range<i32>; 2]) -> bool {
        self.tiles.iter().all(|tile| {
            let own = self.columns(tile.place);
            (0..2).all(|axis| columns[axis].start <= own[axis].start && own[axis].end <= columns[axis].end)
        })
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

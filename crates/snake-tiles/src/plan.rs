//! The plan of a run: its inputs, and its tiles.

use std::fs::File;
use std::ops::Range;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use snake_core::TileSettings;
use snake_geometry::{Bounds, Point, subtract_origin};
use snake_io::{Copc, Crs, LocalFile, Ranges};

use crate::folder::{PLAN, RunFolder};
use crate::{Error, Result, candidates};

/// Everything that determines the candidates of a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Source {
    /// The version of this crate.
    version: String,
    /// Each input file with the digest of its content; behind a URL, with the size and the version from the server.
    files: Vec<(PathBuf, String)>,
    /// Whether the points are read from the files by bounds.
    pub(crate) by_bounds: bool,
    /// How the files are read.
    read: String,
    /// Number of columns along the side of a tile.
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
        let file = |path: &PathBuf| LocalFile::new(path).map_err(Error::file(path)).map(|file| content(&file));
        let files = files.iter().map(file).collect::<Result<_>>()?;
        let (version, read) = (env!("CARGO_PKG_VERSION").into(), format!("{read:?}"));
        Ok(Self { version, files, by_bounds: false, read, columns, settings })
    }

    /// The source of a run that reads COPC files by bounds.
    pub(crate) fn from_copc(files: &[Copc], columns: i32, settings: TileSettings) -> Self {
        let files = files.iter().map(|file| content(file.source())).collect();
        Self {
            version: env!("CARGO_PKG_VERSION").into(),
            files,
            by_bounds: true,
            read: String::new(),
            columns,
            settings,
        }
    }

    /// The id of the run, which its folder carries.
    pub(crate) fn id(&self) -> Result<String> {
        let text = serde_json::to_vec(self).map_err(|error| Error::file(Path::new(PLAN))(error.into()))?;
        Ok(blake3::hash(&text).to_hex()[..32].into())
    }
}

/// The path and the content of a file. An unreadable file has the error's text; the plan lists it as a failure.
fn content(file: &dyn Ranges) -> (PathBuf, String) {
    let path = file.path().to_owned();
    let digest = || Ok(blake3::Hasher::new().update_reader(File::open(&path)?)?.finalize().to_string());
    let words = || Ok(format!("{} bytes, {}", file.length()?, file.version()?));
    let content = if path.is_file() { digest() } else { words() };
    let content = content.unwrap_or_else(|error: std::io::Error| error.to_string());
    (path, content)
}

/// The size and the version of a file; on disk, the time of its last change. Quicker to get than the content.
pub(crate) type Version = (u64, String);

pub(crate) fn version(file: &dyn Ranges) -> Result<Version> {
    let version = || Ok((file.length()?, file.version()?));
    version().map_err(Error::file(file.path()))
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
    /// Number of its points; an estimate if they are read from COPC files.
    pub num_points: u64,
}

/// The tiles of a run, written once all points are on disk.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Plan {
    pub(crate) source: Source,
    /// The versions of the input files, in order.
    pub(crate) versions: Vec<Version>,
    /// Added to all points, see [`snake_geometry::Cloud::origin`].
    pub(crate) origin: [f64; 3],
    /// The lowest and the highest corner of the points, relative to the origin.
    pub(crate) corners: [Point; 2],
    pub(crate) crs: Option<Crs>,
    /// Number of points in all files, including those that are not finite.
    pub(crate) num_points: u64,
    pub(crate) num_skipped: u64,
    pub(crate) failures: Vec<Failure>,
    /// The resolution of the cloud, if the options need it.
    pub(crate) resolution: Option<f64>,
    /// Ordered by place, ascending.
    pub(crate) tiles: Vec<Tile>,
}

impl Plan {
    /// A plan without tiles.
    pub(crate) fn new(source: Source, versions: Vec<Version>, cloud: Extent) -> Self {
        let Extent { bounds, crs, failures, .. } = cloud;
        let origin = bounds.origin();
        let corners = [bounds.low, bounds.high].map(|corner| subtract_origin(corner, origin));
        Self {
            source,
            versions,
            origin,
            corners,
            crs,
            num_points: 0,
            num_skipped: 0,
            failures,
            resolution: None,
            tiles: Vec::new(),
        }
    }

    /// The plan in a folder.
    pub(crate) fn read(folder: &RunFolder) -> Result<Self> {
        let damaged = |error: serde_json::Error| Error::damaged(&folder.path.join(PLAN), &error.to_string());
        serde_json::from_slice(&folder.read(PLAN)?).map_err(damaged)
    }

    /// The plan in a folder, made by another process with these settings.
    pub(crate) fn open(folder: &RunFolder, settings: &TileSettings) -> Result<Self> {
        let plan = Self::read(folder)?;
        let is_same = plan.source.settings == *settings && plan.source.version == env!("CARGO_PKG_VERSION");
        if is_same { Ok(plan) } else { Err(Error::other_run(&folder.path)) }
    }

    /// The paths of the input files.
    pub(crate) fn files(&self) -> impl Iterator<Item = &Path> {
        self.source.files.iter().map(|(path, ..)| path.as_path())
    }

    /// Refuses COPC files that are not those of the run.
    pub(crate) fn check_files(&self, folder: &RunFolder, files: &[Copc]) -> Result<()> {
        let versions = files.iter().map(|file| version(file.source())).collect::<Result<Vec<_>>>()?;
        let paths = files.iter().map(|file| file.source().path());
        if self.source.by_bounds && self.versions == versions && self.files().eq(paths) {
            return Ok(());
        }
        Err(Error::other_run(&folder.path))
    }

    pub(crate) fn write(&self, folder: &RunFolder) -> Result<()> {
        let text = serde_json::to_vec(self).map_err(|error| Error::file(&folder.path.join(PLAN))(error.into()))?;
        folder.write(PLAN, &text)
    }

    /// The file names of all tiles.
    pub(crate) fn names(&self) -> impl Iterator<Item = String> {
        let names = |tile: &Tile| [candidates::name(tile.place), points_file(tile.place)];
        self.tiles.iter().flat_map(names)
    }

    /// The columns of voxels in the tile at a place.
    pub(crate) fn columns(&self, place: [i32; 2]) -> [Range<i32>; 2] {
        let side = self.source.columns;
        place.map(|place| place * side..(place + 1) * side)
    }

    /// The place of the tile that has a column.
    pub(crate) fn place(&self, column: [i32; 2]) -> [i32; 2] {
        place(self.source.columns, column)
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

/// The places of the tiles that have these columns, along each axis.
pub(crate) fn place(side: i32, columns: [i32; 2]) -> [i32; 2] {
    columns.map(|column| column.div_euclid(side))
}

/// The properties of a cloud that are known before its tiles.
#[derive(Default)]
pub(crate) struct Extent {
    pub(crate) bounds: Bounds,
    pub(crate) crs: Option<Crs>,
    /// The first file that has a coordinate reference system.
    first: Option<PathBuf>,
    pub(crate) failures: Vec<Failure>,
}

impl Extent {
    /// Adds the coordinate reference system of a file.
    pub(crate) fn add_crs(&mut self, file: &Path, crs: Option<Crs>) -> Result<()> {
        let Some(crs) = crs else { return Ok(()) };
        if let Err(reason) = crs.check_lengths() {
            let reason = format!("{}: {reason}", file.display());
            return Err(Error::Refused { what: "coordinate reference system", reason });
        }
        match (&self.first, &self.crs) {
            (Some(first), Some(other)) if *other != crs => {
                let reason = format!("{} and {} have different ones", first.display(), file.display());
                Err(Error::Refused { what: "coordinate reference system", reason })
            }
            _ => {
                (self.first, self.crs) = (Some(file.to_owned()), Some(crs));
                Ok(())
            }
        }
    }

    /// Refuses a cloud without extent.
    pub(crate) fn checked(self) -> Result<Self> {
        if (0..3).all(|axis| self.bounds.low[axis] >= self.bounds.high[axis]) {
            let reason = "a cloud needs at least two different points".into();
            return Err(Error::Refused { what: "inputs", reason });
        }
        Ok(self)
    }
}

/// The name of the file with the points of the tile at a place.
pub(crate) fn points_file([x, y]: [i32; 2]) -> String {
    format!("points/{x}_{y}.bin")
}

//! A run in tiles: from files to keypoints.

use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use snake_core::{Control, Options, PlacedDetector, TileDetector, TileOutcome};
use snake_geometry::{Bounds, Point, subtract_origin};
use snake_io::{Copc, Crs, LocalFile, ReadOptions};

use crate::candidates;
use crate::folder::{PLAN, RunFolder};
use crate::plan::{Extent, Failure, Plan, Source, Tile, Version, place, version};
use crate::points::{PointWriter, for_each_point};
use crate::{Error, Result};

/// A run whose points are on disk.
#[derive(Debug)]
pub struct TiledRun {
    pub(crate) detector: PlacedDetector,
    pub(crate) plan: Plan,
    pub(crate) folder: RunFolder,
    /// The COPC files with the points; empty if the points are in the folder.
    pub(crate) copc: Vec<Copc>,
}

impl TiledRun {
    /// Writes the points of the files to tiles of about `side` cloud units in `folder`, or continues the run in that folder.
    /// The files make up one cloud, in this order.
    ///
    /// The folder must be new, empty or of the same run. Several processes may use it at once: they write the same bytes.
    ///
    /// COPC files are not copied: if all files are COPC files, this is [`TiledRun::prepare_copc`].
    /// Files that cannot be read are left out, see [`TiledRun::failures`].
    ///
    /// # Errors
    /// [`Error::Refused`] for a side that is not positive or makes too many tiles, for coordinates in degrees, for
    /// files of different coordinate reference systems, for a folder with another run or with files that no run wrote, and for
    /// inputs that change while they are read; [`Error::Core`] when no file can be read, when the folder cannot be written, or
    /// when the voxel size does not suit the cloud.
    pub fn prepare(
        mut detector: TileDetector,
        files: &[PathBuf],
        read: &ReadOptions,
        side: f64,
        folder: &Path,
    ) -> Result<Self> {
        if let Some(copc) = open_all(files.iter().map(PathBuf::as_path), read) {
            return Self::prepare_copc(detector, copc, side, folder);
        }
        choose_voxel_size(&mut detector, &mut |found| {
            let outcomes = files.iter().map(|file| snake_io::for_each_position(file, read, found));
            let (read, failed): (Vec<_>, Vec<_>) = outcomes.partition(|outcome| outcome.is_ok());
            // If one of several files cannot be read, it becomes a failure later.
            failed.into_iter().next().filter(|_| read.is_empty()).map_or(Ok(()), |error| Ok(error.map(drop)?))
        })?;
        let columns = columns_of(&detector, side)?;
        let versions = || -> Result<Vec<Version>> {
            files.iter().map(|path| version(&LocalFile::new(path).map_err(Error::file(path))?)).collect()
        };
        let before = versions()?;
        let source = Source::new(files, read, columns, detector.settings())?;
        let folder = RunFolder::new(folder, source.id()?)?;
        if folder.has(PLAN) {
            return Self::placed(&detector, Plan::read(&folder)?, folder, Vec::new());
        }
        let plan = Plan::new(source, before, extent(files, read)?);
        Self::placed(&detector, plan, folder, Vec::new())?.begun(&detector, |run| {
            run.sort_points(files, read)?;
            if versions()? == run.plan.versions {
                return Ok(());
            }
            let reason = "changed while they were read; begin again once they are complete".into();
            Err(Error::Refused { what: "inputs", reason })
        })
    }

    /// Marks the folder, calls `make` and then writes the plan. If one of these fails, the files are removed.
    pub(crate) fn begun(mut self, detector: &TileDetector, make: impl FnOnce(&mut Self) -> Result<()>) -> Result<Self> {
        self.folder.mark()?;
        let prepare = || {
            make(&mut self)?;
            if detector.needs_resolution() {
                self.plan.resolution = Some(self.resolution()?);
                self.detector = detector.place(self.plan.corners, self.plan.resolution)?;
            }
            self.plan.write(&self.folder)
        };
        match prepare() {
            Ok(()) => Ok(self),
            Err(error) => {
                let _left = self.remove();
                Err(error)
            }
        }
    }

    /// The run with the detector for the plan's cloud.
    pub(crate) fn placed(detector: &TileDetector, plan: Plan, folder: RunFolder, copc: Vec<Copc>) -> Result<Self> {
        Ok(Self { detector: detector.place(plan.corners, plan.resolution)?, plan, folder, copc })
    }

    /// Opens the run that [`TiledRun::prepare`] made in a folder, for another process or machine that sees the folder. The
    /// input files are only needed if they are COPC files.
    ///
    /// # Errors
    /// [`Error::Core`] if there is no such run; [`Error::Refused`] for another model, other options or another version.
    pub fn open(detector: TileDetector, folder: &Path) -> Result<Self> {
        let folder = RunFolder::open(folder)?;
        let plan = Plan::open(&folder, &detector.settings())?;
        if !plan.source.by_bounds {
            return Self::placed(&detector, plan, folder, Vec::new());
        }
        let copc = open_all(plan.files(), &ReadOptions::default()).ok_or_else(|| Error::other_run(&folder.path))?;
        Self::open_copc(detector, copc, &folder.path)
    }

    /// The folder with the points and the candidates.
    pub fn folder(&self) -> &Path {
        &self.folder.path
    }

    /// Removes the files of the run, and the folder if a run created it. Returns the files that no run wrote; they remain.
    ///
    /// # Errors
    /// [`Error::Core`] when a file cannot be removed.
    pub fn remove(self) -> Result<Vec<PathBuf>> {
        self.folder.remove(self.plan.names())
    }

    /// The options.
    pub fn options(&self) -> &Options {
        self.detector.options()
    }

    /// The tiles that have points.
    pub fn tiles(&self) -> &[Tile] {
        &self.plan.tiles
    }

    /// The input files that were left out because they could not be read.
    pub fn failures(&self) -> &[Failure] {
        &self.plan.failures
    }

    /// Number of points in all files, and how many of them were skipped because they are not finite.
    pub fn num_points(&self) -> (u64, u64) {
        (self.plan.num_points, self.plan.num_skipped)
    }

    /// Added to all keypoints, see [`snake_geometry::Cloud::origin`].
    pub fn origin(&self) -> [f64; 3] {
        self.plan.origin
    }

    /// The coordinate reference system of the files.
    pub fn crs(&self) -> Option<&Crs> {
        self.plan.crs.as_ref()
    }

    /// The lowest and the highest x and y of a tile, in the units of the files.
    pub fn bounds(&self, tile: &Tile) -> [[f64; 2]; 2] {
        self.corners(&self.plan.columns(tile.place))
    }

    /// The lowest and the highest corner of columns, in the units of the files.
    pub(crate) fn corners(&self, columns: &[Range<i32>; 2]) -> [[f64; 2]; 2] {
        [[columns[0].start, columns[1].start], [columns[0].end, columns[1].end]].map(|column| {
            let corner = self.detector.corner_of_column(column);
            std::array::from_fn(|axis| corner[axis] + self.plan.origin[axis])
        })
    }

    /// Whether the candidates of a tile are on disk.
    pub fn is_detected(&self, tile: &Tile) -> bool {
        self.folder.has(&candidates::name(tile.place))
    }

    /// Finds the candidates of a tile and writes them to the folder, unless they are already there.
    ///
    /// # Errors
    /// [`Error::Core`] and [`Error::Damaged`] for the files of the folder; [`Error::Refused`] when another process has removed
    /// it; the errors of [`snake_core::Model::detect_with`] as [`Error::Core`].
    pub fn detect(&self, tile: &Tile, control: &Control) -> Result<()> {
        if self.is_detected(tile) {
            return Ok(());
        }
        let columns = self.plan.columns(tile.place);
        let mut margin = self.detector.margin();
        let candidates = loop {
            let near = widen(&columns, margin);
            let (points, _) = self.points(&widen(&near, self.detector.halo()))?;
            let is_whole = self.plan.is_inside(&near);
            match self.detector.detect(&points, &columns, margin, is_whole, control)? {
                TileOutcome::Done(candidates) => break candidates,
                TileOutcome::NeedsMargin(wider) => margin = wider,
            }
        };
        self.folder.check()?;
        candidates::write(&self.folder, tile.place, &candidates)
    }

    /// The points in a range of columns, in the order of the cloud, and their indices.
    pub(crate) fn points(&self, columns: &[Range<i32>; 2]) -> Result<(Vec<Point>, Vec<u64>)> {
        let mut inside = Vec::new();
        let mut add = |point: Point, index: u64| {
            if self.detector.is_in(&point, columns) {
                inside.push((index, point));
            }
        };
        if !self.copc.is_empty() {
            self.for_each_near(columns, &mut add)?;
        } else {
            for tile in self.plan.tiles_in(columns) {
                for_each_point(&self.folder, tile, &mut add)?;
            }
        }
        inside.sort_unstable_by_key(|(index, _)| *index);
        Ok(inside.into_iter().map(|(index, point)| (point, index)).unzip())
    }

    /// The second pass over the files: writes the points of each tile. Afterwards the plan has the tiles, even after an error.
    fn sort_points(&mut self, files: &[PathBuf], read: &ReadOptions) -> Result<()> {
        let Self { detector, plan, folder, .. } = self;
        let (columns, origin) = (plan.source.columns, plan.origin);
        let mut writer = PointWriter::new(folder);
        let mut outcome = Ok(());
        for file in files.iter().filter(|file| plan.failures.iter().all(|failure| failure.path != **file)) {
            let read_all = snake_io::for_each_position(file, read, &mut |position| {
                let index = plan.num_points;
                plan.num_points += 1;
                if outcome.is_ok() && position.iter().all(|v| v.is_finite()) {
                    let point = subtract_origin(position, origin);
                    let column = detector.column(&point).map_err(Error::from);
                    outcome = column.and_then(|column| writer.add(place(columns, column), point, index));
                } else {
                    plan.num_skipped += 1;
                }
            });
            outcome = outcome.and(read_all.map(drop).map_err(Error::from));
        }
        outcome = outcome.and_then(|()| writer.finish());
        plan.tiles = writer.tiles();
        outcome
    }
}

/// Columns, extended by `by` columns on all sides.
pub(crate) fn widen(columns: &[Range<i32>; 2], by: i32) -> [Range<i32>; 2] {
    columns.clone().map(|range| range.start.saturating_sub(by)..range.end.saturating_add(by))
}

/// The number of columns along a side of about `side` cloud units.
pub(crate) fn columns_of(detector: &TileDetector, side: f64) -> Result<i32> {
    let column_side = detector.column_side()?;
    let columns = (side / column_side).round().max(1.0);
    if !(side > 0.0 && columns < f64::from(1 << 20)) {
        let reason = format!("a side of {side}; allowed is about {column_side} to 1000000 times that");
        return Err(Error::Refused { what: "tile", reason });
    }
    Ok(columns as i32)
}

/// Maximum number of points of a cloud whose voxel size can be chosen: the choice needs all of them in memory.
const CHOSEN_POINTS: usize = 2_000_000;

/// A function that receives a position.
type Take<'a> = dyn FnMut([f64; 3]) + 'a;

/// Chooses the voxel size if the options have none. `read` calls its argument with all points.
pub(crate) fn choose_voxel_size(
    detector: &mut TileDetector,
    read: &mut dyn FnMut(&mut Take<'_>) -> Result<()>,
) -> Result<()> {
    if !detector.needs_voxel_size() {
        return Ok(());
    }
    let (mut positions, mut bounds, mut number) = (Vec::new(), Bounds::default(), 0_usize);
    read(&mut |position| {
        if position.iter().all(|v| v.is_finite()) {
            bounds.add(position);
            number += 1;
            if number <= CHOSEN_POINTS {
                positions.push(position);
            }
        }
    })?;
    if number > CHOSEN_POINTS {
        let reason = format!(
            "none is given, and {number} points are too many to choose one from (at most {CHOSEN_POINTS}); give a length in \
             cloud units such as 0.1: details smaller than it are not seen"
        );
        return Err(Error::Refused { what: "voxel_size", reason });
    }
    let points: Vec<Point> = positions.into_iter().map(|position| subtract_origin(position, bounds.origin())).collect();
    Ok(detector.choose_voxel_size(&points)?)
}

/// The first pass over the files.
fn extent(files: &[PathBuf], read: &ReadOptions) -> Result<Extent> {
    let mut extent = Extent::default();
    for file in files {
        let mut bounds = extent.bounds;
        let crs = match snake_io::for_each_position(file, read, &mut |position| bounds.add(position)) {
            Ok(crs) => crs,
            Err(error) if files.len() == 1 => return Err(error.into()),
            Err(error) => {
                extent.failures.push(Failure { path: file.clone(), reason: error.to_string() });
                continue;
            }
        };
        extent.bounds = bounds;
        extent.add_crs(file, crs)?;
    }
    if extent.failures.len() == files.len() {
        let reason = extent.failures.first().map_or("no files".into(), |failure| failure.reason.clone());
        return Err(Error::Refused { what: "inputs", reason: format!("none can be read: {reason}") });
    }
    extent.checked()
}

/// Opens the files, if all are COPC files whose points are read unchanged.
fn open_all<'a>(files: impl IntoIterator<Item = &'a Path>, read: &ReadOptions) -> Option<Vec<Copc>> {
    if read.columns.is_some() || read.sample.is_some() || read.keep_withheld {
        return None;
    }
    files.into_iter().map(|path| Copc::open(Arc::new(LocalFile::new(path).ok()?)).ok()?).collect()
}

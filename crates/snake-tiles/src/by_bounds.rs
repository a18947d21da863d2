//! Runs that read their points from COPC files by bounds, instead of from a copy that is sorted into tiles.

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::Path;

use snake_core::{PlacedDetector, TileDetector};
use snake_geometry::{Bounds, Point, subtract_origin};
use snake_io::Copc;

use crate::Result;
use crate::folder::{PLAN, RunFolder};
use crate::plan::{Extent, Plan, Source, Tile, place, version};
use crate::run::{TiledRun, choose_voxel_size, columns_of, widen};

/// An unbounded rectangle.
const EVERYWHERE: [[f64; 2]; 2] = [[f64::NEG_INFINITY; 2], [f64::INFINITY; 2]];

impl TiledRun {
    /// [`TiledRun::prepare`] for COPC files that make up one cloud and may be behind a server. It reads only their
    /// octrees. So [`Tile::num_points`] is an estimate, and a tile may be empty. Each tile reads its points from the
    /// files by bounds. All points are read here only if the voxel size has to be chosen or if lengths are in `r`.
    ///
    /// # Errors
    /// The errors of [`TiledRun::prepare`].
    pub fn prepare_copc(mut detector: TileDetector, files: Vec<Copc>, side: f64, folder: &Path) -> Result<Self> {
        choose_voxel_size(&mut detector, &mut |found| {
            files.iter().try_for_each(|file| Ok(file.for_each_position_in(EVERYWHERE, &mut |_, at| found(at))?))
        })?;
        let columns = columns_of(&detector, side)?;
        let versions = files.iter().map(|file| version(file.source())).collect::<Result<_>>()?;
        let source = Source::from_copc(&files, columns, detector.settings());
        let folder = RunFolder::new(folder, source.id()?)?;
        if folder.has(PLAN) {
            let mut plan = Plan::read(&folder)?;
            if plan.versions != versions {
                plan.versions = versions;
                plan.write(&folder)?;
            }
            return Self::placed(&detector, plan, folder, files);
        }
        let mut extent = Extent::default();
        for file in &files {
            [file.bounds().low, file.bounds().high].into_iter().for_each(|corner| extent.bounds.add(corner));
            extent.add_crs(file.source().path(), file.crs().cloned())?;
        }
        let bounds = extent.bounds;
        let plan = Plan::new(source, versions, extent.checked()?);
        Self::placed(&detector, plan, folder, files)?.begun(&detector, |run| {
            run.plan.num_points = run.copc.iter().map(Copc::num_points).sum();
            run.plan.tiles = tiles(&run.detector, &run.plan, &run.copc, &bounds)?;
            Ok(())
        })
    }

    /// [`TiledRun::open`] for a run of [`TiledRun::prepare_copc`] whose files are not on a disk that all machines see.
    ///
    /// # Errors
    /// The errors of [`TiledRun::open`]; also when a file has changed.
    pub fn open_copc(detector: TileDetector, files: Vec<Copc>, folder: &Path) -> Result<Self> {
        let folder = RunFolder::open(folder)?;
        let plan = Plan::open(&folder, &detector.settings())?;
        plan.check_files(&folder, &files)?;
        Self::placed(&detector, plan, folder, files)
    }

    /// Calls `found` with all points in a rectangle of columns and their indices in the cloud; also with some points outside.
    pub(crate) fn for_each_near(&self, columns: &[Range<i32>; 2], found: &mut dyn FnMut(Point, u64)) -> Result<()> {
        // Columns are computed from points in f32. Reading one column more includes the points at the border.
        let [low, high] = self.corners(&widen(columns, 1));
        let mut first = 0;
        for file in &self.copc {
            file.for_each_position_in([low, high], &mut |index, position| {
                found(subtract_origin(position, self.plan.origin), first + index);
            })?;
            first += file.num_points();
        }
        Ok(())
    }
}

/// The tiles that may have points, ordered by place.
fn tiles(detector: &PlacedDetector, plan: &Plan, files: &[Copc], bounds: &Bounds) -> Result<Vec<Tile>> {
    let column = |corner| detector.column(&subtract_origin(corner, plan.origin));
    let (low, high) = (column(bounds.low)?, column(bounds.high)?);
    let number = |low: [i32; 2], high: [i32; 2]| -> u64 {
        (0..2).map(|axis| u64::from(high[axis].abs_diff(low[axis])) + 1).fold(1, u64::saturating_mul)
    };
    let mut shares: BTreeMap<[i32; 2], f64> = BTreeMap::new();
    for (node, num_points) in files.iter().flat_map(Copc::nodes) {
        let at = |corner: [f64; 3], axis: usize| corner[axis].clamp(bounds.low[axis], bounds.high[axis]);
        let corner = |of: [f64; 3]| column(std::array::from_fn(|axis| at(of, axis)));
        let [low, high] = [corner(node.low)?, corner(node.high)?].map(|column| plan.place(column));
        let share = num_points as f64 / number(low, high) as f64;
        // A point may lie two coordinate steps outside its node, in the next tile.
        for x in low[0] - 1..=high[0] + 1 {
            for y in low[1] - 1..=high[1] + 1 {
                let is_inside = (low[0]..=high[0]).contains(&x) && (low[1]..=high[1]).contains(&y);
                *shares.entry([x, y]).or_default() += if is_inside { share } else { 0.0 };
            }
        }
    }
    // One additional column, for the same reason.
    let (low, high) = ([low[0] - 1, low[1] - 1], [high[0] + 1, high[1] + 1]);
    let side = plan.source.columns;
    let [first, last] = [low, high].map(|columns| place(side, columns));
    let is_inside = |at: &[i32; 2]| (0..2).all(|axis| (first[axis]..=last[axis]).contains(&at[axis]));
    let tile = |(place, share): ([i32; 2], f64)| Tile { place, num_points: share.round() as u64 };
    Ok(shares.into_iter().filter(|(place, _)| is_inside(place)).map(tile).collect())
}

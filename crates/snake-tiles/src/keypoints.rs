//! Makes keypoints from the candidates of all tiles.

use snake_core::{Candidate, Control, Counts, by_rank};
use snake_geometry::{Fate, Keypoint, Point};

use crate::candidates::{self, Summary};
use crate::plan::Tile;
use crate::run::TiledRun;
use crate::{Error, Result};

/// A keypoint of a tile.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TiledKeypoint {
    /// The keypoint relative to [`TiledRun::origin`]. Its `nearest_index` counts the points of all files.
    pub keypoint: Keypoint,
    /// The place of the tile that found it.
    pub tile: [i32; 2],
    /// The rank; keypoints with higher ranks come first, see [`Candidate::rank`].
    pub rank: f32,
    /// Saliency at the start of mode seeking. It orders keypoints of equal rank; after it come the z, y and x of their cells.
    pub start: f32,
    /// The voxel of the start, along x, y and z.
    pub cell: [i32; 3],
}

/// The results of the tiles of a run.
#[derive(Debug, Clone)]
pub struct Detected {
    /// The detected tiles, ordered by place.
    summaries: Vec<([i32; 2], Summary)>,
    /// Number of queries after each step, except keypoints.
    pub counts: Counts,
    /// Tiles whose candidates are not on disk. Their keypoints are missing, and keypoints close to them may differ.
    pub missing: Vec<Tile>,
}

/// The result of a run in tiles.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TiledDetection {
    /// The keypoints, best first.
    pub keypoints: Vec<TiledKeypoint>,
    /// Number of queries after each step.
    pub counts: Counts,
}

/// A rectangle along x and y, as its lowest and highest corner.
type Rectangle = [[f64; 2]; 2];

impl TiledRun {
    /// The keypoints of all tiles, bit-identical to those of [`snake_core::Model::detect`].
    ///
    /// # Errors
    /// [`Error::Missing`] when not all tiles are detected; [`Error::Core`] and [`Error::Damaged`] for the files of the
    /// folder; [`snake_core::Error::Cancelled`] and [`snake_core::Error::DeadlineExceeded`].
    pub fn finish(&self, control: &Control) -> Result<TiledDetection> {
        let detected = self.detected()?;
        if !detected.missing.is_empty() {
            return Err(Error::Missing { missing: detected.missing, total: self.tiles().len() });
        }
        self.finish_detected(&detected, control)
    }

    /// The keypoints of the detected tiles, without [`Detected::missing`].
    ///
    /// # Errors
    /// The errors of [`TiledRun::finish`].
    pub fn finish_detected(&self, detected: &Detected, control: &Control) -> Result<TiledDetection> {
        let counter = control.begin("suppression", detected.summaries.len());
        let mut kept = Vec::new();
        // Tiles are processed one after another, so the candidates of only one are in memory at a time.
        for (index, (place, _)) in detected.summaries.iter().enumerate() {
            counter.check()?;
            kept.extend(self.suppress(index, &detected.summaries)?.into_iter().map(|candidate| (candidate, *place)));
            counter.add(1);
        }
        kept.sort_by(|(a, _), (b, _)| by_rank(a, b));
        kept.truncate(self.detector.options().detect.max_keypoints);
        let keypoints = self.with_nearest(kept, control)?;
        let mut counts = detected.counts;
        counts.keypoints = keypoints.len();
        Ok(TiledDetection { keypoints, counts })
    }

    /// Reads the summaries of the candidates in the folder, once all tiles are detected.
    ///
    /// # Errors
    /// [`Error::Core`] and [`Error::Damaged`] for the files of the folder; [`Error::Refused`] when another process has removed it.
    pub fn detected(&self) -> Result<Detected> {
        let (mut summaries, mut counts) = (Vec::new(), Counts::default());
        let (there, missing): (Vec<Tile>, _) = self.tiles().iter().partition(|tile| self.is_detected(tile));
        self.folder.check()?;
        for tile in there {
            let summary = candidates::read_summary(&self.folder, tile.place)?;
            counts.add(&summary.counts);
            summaries.push((tile.place, summary));
        }
        Ok(Detected { summaries, counts, missing })
    }

    /// The keypoints of one tile. [`TiledRun::finish`] gives those of all tiles, sorted by falling [`TiledKeypoint::rank`], then as
    /// [`TiledKeypoint::start`] says, and limits their number.
    ///
    /// # Errors
    /// The errors of [`TiledRun::finish`].
    pub fn keypoints(&self, tile: &Tile, detected: &Detected, control: &Control) -> Result<Vec<TiledKeypoint>> {
        match detected.summaries.binary_search_by_key(&tile.place, |(place, _)| *place) {
            Ok(index) => {
                let kept = self.suppress(index, &detected.summaries)?.into_iter();
                self.with_nearest(kept.map(|candidate| (candidate, tile.place)).collect(), control)
            }
            Err(_) => Ok(Vec::new()),
        }
    }

    /// Keypoints from candidates and the places of their tiles.
    fn with_nearest(&self, kept: Vec<(Candidate, [i32; 2])>, control: &Control) -> Result<Vec<TiledKeypoint>> {
        let least = self.detector.options().detect.min_confidence;
        let is_good = |candidate: &Candidate| least.is_none() || candidate.confidence >= least;
        let kept: Vec<_> = kept.into_iter().filter(|(candidate, _)| is_good(candidate)).collect();
        let positions: Vec<Point> = kept.iter().map(|(candidate, _)| candidate.position).collect();
        let nearest = self.nearest(&positions, control)?;
        let keypoint = |((candidate, tile), nearest): ((Candidate, [i32; 2]), u64)| {
            let Candidate { position, saliency, occupancy, confidence, covariance, rank, start, cell, .. } = candidate;
            let nearest_index = nearest as usize;
            let keypoint = Keypoint { position, saliency, occupancy, nearest_index, confidence, covariance };
            TiledKeypoint { keypoint, tile, rank, start, cell }
        };
        Ok(kept.into_iter().zip(nearest).map(keypoint).collect())
    }

    /// The candidates of a tile that suppression keeps. A candidate's fate can depend on a chain of others, so the tile
    /// reads more of its neighbours until all fates are known.
    fn suppress(&self, index: usize, summaries: &[([i32; 2], Summary)]) -> Result<Vec<Candidate>> {
        let (place, Summary { bounds: Some(bounds), .. }) = &summaries[index] else { return Ok(Vec::new()) };
        let own = candidates::read(&self.folder, *place)?;
        let reach = self.detector.suppression_reach();
        let mut margin = 4.0 * reach;
        loop {
            let [low, high] = bounds.map(|corner| corner.map(f64::from));
            let seen = [low.map(|v| v - margin), high.map(|v| v + margin)];
            let (mut near, mut sees_whole_tiles) = (own.clone(), true);
            for (other, (place, summary)) in summaries.iter().enumerate() {
                let Some(bounds) = summary.bounds.filter(|_| other != index) else { continue };
                let bounds = bounds.map(|corner| corner.map(f64::from));
                let is_whole = contains(&seen, bounds[0]) && contains(&seen, bounds[1]);
                sees_whole_tiles &= is_whole;
                if is_whole || (0..2).all(|axis| bounds[0][axis] <= seen[1][axis] && seen[0][axis] <= bounds[1][axis]) {
                    let candidates = candidates::read(&self.folder, *place)?.into_iter();
                    near.extend(candidates.filter(|candidate| contains(&seen, in_plane(candidate))));
                }
            }
            let inner = [seen[0].map(|v| v + reach), seen[1].map(|v| v - reach)];
            let fates = self.detector.fates(&near, |c| sees_whole_tiles || contains(&inner, in_plane(c)))?;
            if !fates[..own.len()].contains(&Fate::Unknown) {
                let kept = own.into_iter().zip(fates).filter(|(_, fate)| *fate == Fate::Kept);
                return Ok(kept.map(|(candidate, _)| candidate).collect());
            }
            if sees_whole_tiles {
                let reason = "suppression did not end; this is an error of snake-rs".into();
                return Err(Error::Refused { what: "candidates", reason });
            }
            margin *= 2.0;
        }
    }
}

fn in_plane(candidate: &Candidate) -> [f64; 2] {
    [candidate.position[0].into(), candidate.position[1].into()]
}

fn contains([low, high]: &Rectangle, at: [f64; 2]) -> bool {
    (0..2).all(|axis| low[axis] <= at[axis] && at[axis] <= high[axis])
}

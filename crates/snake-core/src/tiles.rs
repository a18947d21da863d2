//! Detection of one tile of a cloud that is too large for memory. Tiles give the keypoints of the whole cloud, bit for bit.
//!
//! The windows of a cloud have their centres in the cells of a lattice. A tile owns whole columns of cells along x and y.
//! Its windows depend on the points of its own columns and of [`TileDetector::halo`] columns around them.
//! The candidates of all tiles are suppressed by [`suppress_seen`], which says where a tile must know more of its
//! neighbours.

use std::collections::{BTreeMap, HashSet};
use std::ops::Range;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::control::Control;
use crate::detect::{Candidates, Counts};
use crate::field::check_number_of_points;
use crate::length::Length;
use crate::model::Model;
use crate::network::Network;
use crate::nms::{Fate, suppress_seen};
use crate::options::{Options, check_radius};
use crate::points::{Point, check_points};
use crate::side_by_side::side_by_side;
use crate::window_cells::{Cell, REACH, SPACING, cell};
use crate::windows::{FEW_WINDOWS, Windows};
use crate::{Error, Result};

/// Columns along the side of a block. A tile is detected in blocks, so that few candidates wait in memory for suppression.
const BLOCK: i32 = 16;

/// A model with options for the tiles of a cloud. All points are relative to the origin of the whole cloud.
#[derive(Debug, Clone)]
pub struct TileDetector {
    network: Arc<Network>,
    options: Options,
    radius: f32,
    nms_radius: f32,
}

/// A refined query above the saliency threshold that suppression has not removed yet.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Candidate {
    /// Position in cloud units, relative to the origin of the whole cloud.
    pub position: Point,
    /// Saliency in [0, 1].
    pub saliency: f32,
    /// Occupancy in [0, 1] at the position.
    pub occupancy: f32,
    /// The cell of its window.
    pub cell: [i32; 3],
}

/// The candidates of a tile: window by window, the cells ascending.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TileCandidates {
    /// The candidates that other tiles may need or that are keypoints.
    pub candidates: Vec<Candidate>,
    /// Number of queries after each step, those of suppressed candidates included. Keypoints are not counted.
    pub counts: Counts,
}

/// The fingerprint of everything that decides the candidates of a tile, apart from its points.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TileSettings {
    /// The BLAKE3 digest of the model's weight file.
    pub model: String,
    /// The options.
    pub options: Options,
}

impl TileDetector {
    /// A detector of tiles. The lengths of the options must be in cloud units, because a multiple of the resolution depends
    /// on all points.
    ///
    /// # Errors
    /// [`Error::Option`] when an option is out of its range, or needs the whole cloud: a length in `r` or `%`,
    /// `max_points`, `mode_radius` or `snap`; or when there is no window radius.
    pub fn new(model: &Model, options: &Options) -> Result<Self> {
        options.check(model.config())?;
        let refused = |name, value: String, allowed| Err(Error::Option { name, value, allowed });
        let Some(radius) = options.window_radius else {
            let allowed = "a length in cloud units in tiles, such as `0.8`";
            return refused("window_radius", "none".into(), allowed);
        };
        if let Some(number) = options.encode.max_points {
            return refused("max_points", number.to_string(), "none in tiles");
        }
        if let Some(radius) = options.detect.mode_radius {
            return refused("mode_radius", radius.to_string(), "none in tiles");
        }
        if options.detect.snap {
            return refused("snap", "true".into(), "false in tiles");
        }
        let units = |name, length| match length {
            Length::Units(units) => Ok(units),
            other => Err(Error::Option { name, value: other.to_string(), allowed: "a length in cloud units in tiles" }),
        };
        let radius = units("window_radius", radius)?;
        check_radius(radius, || format!("{radius:e}"))?;
        let nms_radius = options.detect.nms_radius.map_or(Ok(0.0), |length| units("nms_radius", length))?;
        Ok(Self {
            network: model.network().clone(),
            options: *options,
            radius: radius as f32,
            nms_radius: nms_radius as f32,
        })
    }

    /// What decides the candidates of a tile, apart from its points.
    pub fn settings(&self) -> TileSettings {
        TileSettings { model: self.network.digest.clone(), options: self.options }
    }

    /// The options.
    pub fn options(&self) -> &Options {
        &self.options
    }

    /// The radius of suppression in cloud units; 0 for no suppression.
    pub fn nms_radius(&self) -> f32 {
        self.nms_radius
    }

    /// The side of a cell in cloud units.
    pub fn cell_side(&self) -> f64 {
        f64::from(SPACING * self.radius)
    }

    /// The cell of a finite point.
    ///
    /// # Errors
    /// [`Error::Input`] when the point is too far from the origin for the radius of the windows.
    pub fn cell(&self, point: &Point) -> Result<[i32; 3]> {
        narrow(cell(point, self.radius)).ok_or_else(|| Error::Input {
            what: "window_radius",
            reason: format!("radius {} is too small for the point {point:?}", self.radius),
        })
    }

    /// The number of columns around a tile whose points its windows depend on.
    ///
    /// A query lies at most the radius from the centre of its window along x and y, and at most `radius * 2 * z` along z,
    /// with the bounds ±z of the network's frame. A centre that is nearer to the query than its own lies, along x and y,
    /// at most the radius and the query's distance from the window's centre. That is more than the two columns that the
    /// points of a window reach into.
    pub fn halo(&self) -> i32 {
        let bounds = self.network.config.frame().map_or([0.0; 2], |frame| frame.z_bounds);
        let z = bounds.iter().fold(0.0, |z: f32, bound| z.max(bound.abs()));
        let distance = (2.0 + 4.0 * f64::from(z).powi(2)).sqrt();
        let columns = ((1.0 + distance) / f64::from(SPACING) + 1e-3).ceil();
        (columns as i32).max(REACH as i32)
    }

    /// The number of windows over points.
    ///
    /// # Errors
    /// As [`TileDetector::cell`].
    pub fn num_windows(&self, points: &[Point]) -> Result<usize> {
        let cells = points.iter().map(|point| self.cell(point));
        Ok(cells.collect::<Result<HashSet<_>>>()?.len())
    }

    /// Refuses more windows than half the points, as for a whole cloud: they would take hours, with almost no points each.
    ///
    /// # Errors
    /// [`Error::Input`].
    pub fn check_windows(&self, num_windows: usize, num_points: usize) -> Result<()> {
        if num_windows <= FEW_WINDOWS.max(num_points / 2) {
            return Ok(());
        }
        let reason = format!(
            "radius {} gives {num_windows} windows for {num_points} points, which is too many; choose a larger radius \
             (`window_radius`)",
            self.radius
        );
        Err(Error::Input { what: "window_radius", reason })
    }

    /// The candidates of the windows whose cells lie in the columns `[x, y]` of `tile`.
    ///
    /// `points` are all finite points in these columns and in [`TileDetector::halo`] columns around them, in the order of
    /// the whole cloud. More points do no harm.
    ///
    /// # Errors
    /// The errors of [`Model::detect_with`].
    pub fn detect(&self, points: &[Point], tile: &[Range<i32>; 2], control: &Control) -> Result<TileCandidates> {
        if points.is_empty() {
            return Ok(TileCandidates::default());
        }
        check_points("points", points)?;
        check_number_of_points(points.len())?;
        let windows = Windows::new(&self.network, points, points, self.radius, &self.options)?;
        // By the place of the block along x and y.
        let mut blocks: BTreeMap<[i32; 2], Vec<(usize, [i32; 3])>> = BTreeMap::new();
        let mut number = 0;
        for window in 0..windows.cells.centers.len() {
            let Some(cell) = narrow(windows.cells.cell_of(window)) else { continue };
            if (0..2).all(|axis| tile[axis].contains(&cell[axis])) {
                let place = [0, 1].map(|axis| (cell[axis] - tile[axis].start) / BLOCK);
                blocks.entry(place).or_default().push((window, cell));
                number += 1;
            }
        }
        let counter = control.begin("windows", number);
        let of_window = control.without_progress();
        let mut of_tile = TileCandidates::default();
        for (place, own) in blocks {
            let found = side_by_side(own.len(), |index| {
                let found = windows.detect(own[index].0, &of_window)?;
                counter.add(1);
                Ok(found)
            })?;
            let mut of_block = Vec::new();
            for ((_, cell), (Candidates { positions, scores, counts, .. }, occupancy)) in own.iter().zip(found) {
                of_tile.counts.add(&counts);
                let all = positions.iter().zip(scores.iter()).zip(occupancy);
                of_block.extend(all.map(|((&position, &saliency), occupancy)| Candidate {
                    position,
                    saliency,
                    occupancy,
                    cell: *cell,
                }));
            }
            let block = [0, 1].map(|axis: usize| {
                let start = tile[axis].start + place[axis] * BLOCK;
                start..tile[axis].end.min(start + BLOCK)
            });
            self.drop_suppressed(&mut of_block, &block)?;
            of_tile.candidates.extend(of_block);
        }
        of_tile.candidates.sort_by_key(|candidate| candidate.cell);
        self.drop_suppressed(&mut of_tile.candidates, tile)?;
        Ok(of_tile)
    }

    /// Drops the candidates of some columns that no candidate of other columns can save. Without refinement the candidates
    /// of other columns lie at most the radius of a window inside these.
    fn drop_suppressed(&self, candidates: &mut Vec<Candidate>, columns: &[Range<i32>; 2]) -> Result<()> {
        if self.options.detect.refine_steps > 0 || self.nms_radius <= 0.0 {
            return Ok(());
        }
        let reach = 1.01 * f64::from(self.radius) + self.suppression_reach();
        let is_inside = |candidate: &Candidate| {
            (0..2).all(|axis| {
                let at = f64::from(candidate.position[axis]);
                let reach = reach + 1e-6 * at.abs();
                let [low, high] =
                    [columns[axis].start, columns[axis].end].map(|cell| f64::from(cell) * self.cell_side());
                at - reach > low && at + reach < high
            })
        };
        let fates = self.fates(candidates, is_inside)?;
        let mut fates = fates.into_iter();
        candidates.retain(|_| fates.next() != Some(Fate::Suppressed));
        Ok(())
    }

    /// The distance along an axis beyond which no candidate suppresses another, in cloud units.
    pub fn suppression_reach(&self) -> f64 {
        f64::from(self.nms_radius) * (1.0 + 1e-5)
    }

    /// The fate of each candidate of a part of the cloud. `sees_all` says for a candidate whether the part has all
    /// candidates within [`TileDetector::suppression_reach`]. Candidates of equal saliency are ranked by their cells, and
    /// by their order within a cell.
    ///
    /// # Errors
    /// [`Error::Input`] for more candidates than [`u32::MAX`].
    pub fn fates(&self, candidates: &[Candidate], sees_all: impl Fn(&Candidate) -> bool) -> Result<Vec<Fate>> {
        let mut order: Vec<usize> = (0..candidates.len()).collect();
        order.sort_by(|&a, &b| by_rank(&candidates[a], &candidates[b]));
        let ranked: Vec<Point> = order.iter().map(|&index| candidates[index].position).collect();
        let of_ranked = suppress_seen(&ranked, self.nms_radius, |rank| sees_all(&candidates[order[rank]]))?;
        let mut fates = vec![Fate::Unknown; candidates.len()];
        order.iter().zip(of_ranked).for_each(|(&index, fate)| fates[index] = fate);
        Ok(fates)
    }
}

/// The rank of candidates, best first. A stable sort keeps the order within a cell.
pub fn by_rank(a: &Candidate, b: &Candidate) -> std::cmp::Ordering {
    b.saliency.total_cmp(&a.saliency).then(a.cell.cmp(&b.cell))
}

fn narrow(cell: Cell) -> Option<[i32; 3]> {
    let [x, y, z] = cell.map(|v| i32::try_from(v).ok());
    // Room for the columns around a tile.
    Some([x?, y?, z?]).filter(|cell| cell.iter().all(|v| v.unsigned_abs() < 1 << 30))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Builtin, DetectOptions, Keypoint};

    /// A floor of 4 by 3 with a wall and two posts.
    fn place() -> Vec<Point> {
        let floor = (0..4800).map(|i| [(i % 80) as f32 * 0.05 - 1.0, (i / 80) as f32 * 0.05, 0.0]);
        let wall = (0..1800).map(|i| [1.0 + 0.01 * (i % 9) as f32, (i % 60) as f32 * 0.05, (i / 60) as f32 * 0.05]);
        let post = |x: f32, y: f32| {
            (0..800).map(move |i| {
                let angle = i as f32 * 0.7;
                [x + 0.1 * angle.cos(), y + 0.1 * angle.sin(), i as f32 * 1e-3]
            })
        };
        floor.chain(wall).chain(post(-0.5, 1.0)).chain(post(2.2, 2.0)).collect()
    }

    fn options(refine_steps: usize) -> Options {
        let detect = DetectOptions::default()
            .with_query_resolution(14)
            .with_refine_steps(refine_steps)
            .with_saliency_threshold(0.0)
            .with_nms_radius(Some(0.1.into()))
            .with_max_keypoints(usize::MAX);
        Options::default().with_detect(detect).with_window_radius(Some(0.6.into()))
    }

    /// The tiles of `side` columns, the first of them at `offset`.
    fn tiles(side: i32, offset: i32) -> Vec<[Range<i32>; 2]> {
        let along = move || (-8..8).map(move |tile| tile * side + offset..(tile + 1) * side + offset);
        along().flat_map(|x| along().map(move |y| [x.clone(), y])).collect()
    }

    /// The keypoints by position, saliency and occupancy, and the number of candidates that were kept by tiles.
    fn by_tiles(
        detector: &TileDetector,
        points: &[Point],
        side: i32,
        offset: i32,
        halo: i32,
    ) -> (Vec<Candidate>, usize) {
        let mut all = TileCandidates::default();
        for tile in tiles(side, offset) {
            let is_near = |point: &&Point| {
                let cell = detector.cell(point).unwrap();
                (0..2).all(|axis| (tile[axis].start - halo..tile[axis].end + halo).contains(&cell[axis]))
            };
            let near: Vec<Point> = points.iter().filter(is_near).copied().collect();
            let found = detector.detect(&near, &tile, &Control::default()).unwrap();
            all.counts.add(&found.counts);
            all.candidates.extend(found.candidates);
        }
        let fates = detector.fates(&all.candidates, |_| true).unwrap();
        let mut kept: Vec<Candidate> =
            all.candidates.iter().zip(fates).filter(|(_, fate)| *fate == Fate::Kept).map(|(c, _)| *c).collect();
        kept.sort_by(by_rank);
        (kept, all.candidates.len())
    }

    fn is_equal(kept: &[Candidate], whole: &[Keypoint]) -> bool {
        kept.iter()
            .map(|c| (c.position, c.saliency, c.occupancy))
            .eq(whole.iter().map(|k| (k.position, k.saliency, k.occupancy)))
    }

    #[test]
    fn tiles_of_any_size_give_the_bits_of_the_whole_cloud() {
        let model = Model::builtin(Builtin::Compact);
        let points = place();
        for (refine_steps, tilings) in [(0, &[(2, 0), (3, 1), (5, -2), (64, -29)][..]), (2, &[(3, 0)])] {
            let options = options(refine_steps);
            let whole = model.detect(&points, &options).unwrap();
            assert!(whole.keypoints.len() > 50, "{}", whole.keypoints.len());
            let detector = TileDetector::new(&model, &options).unwrap();
            assert_eq!(detector.num_windows(&points).unwrap(), whole.counts.windows);
            for &(side, offset) in tilings {
                let (kept, num_candidates) = by_tiles(&detector, &points, side, offset, detector.halo());
                assert!(is_equal(&kept, &whole.keypoints), "{side} {offset}");
                let are_dropped = num_candidates < whole.counts.above_threshold;
                assert!(are_dropped || side < 64, "a tile of several blocks drops what is suppressed for certain");
                assert!(!are_dropped || refine_steps == 0, "refinement may move candidates far");
            }
        }
    }

    #[test]
    fn windows_need_points_of_other_tiles() {
        let model = Model::builtin(Builtin::Compact);
        let (points, options) = (place(), options(0));
        let detector = TileDetector::new(&model, &options).unwrap();
        // (1 + √3) · 1.25 columns for a frame within ±0.5.
        assert_eq!(detector.halo(), 4);
        let whole = model.detect(&points, &options).unwrap();
        assert!(!is_equal(&by_tiles(&detector, &points, 3, 1, 0).0, &whole.keypoints));
    }

    #[test]
    fn options_that_need_the_whole_cloud_are_refused_by_name() {
        let model = Model::builtin(Builtin::Compact);
        let refused = |change: fn(&mut Options)| {
            let mut options = options(0);
            change(&mut options);
            TileDetector::new(&model, &options).err().map(|error| error.to_string()).unwrap_or_default()
        };
        for (name, error) in [
            ("`window_radius` is none", refused(|options| options.window_radius = None)),
            ("`window_radius` is 40r", refused(|options| options.window_radius = Some(Length::Resolutions(40.0)))),
            ("`nms_radius` is 10%", refused(|options| options.detect.nms_radius = Some(Length::Percent(10.0)))),
            ("`mode_radius`", refused(|options| options.detect.mode_radius = Some(0.1.into()))),
            ("`max_points`", refused(|options| options.encode.max_points = Some(7))),
            ("`snap`", refused(|options| options.detect.snap = true)),
        ] {
            assert!(error.contains(name), "{name}: {error}");
        }
        let detector = TileDetector::new(&model, &options(0)).unwrap();
        assert!(detector.cell(&[1e30, 0.0, 0.0]).unwrap_err().to_string().contains("window_radius"));
        assert!(detector.check_windows(65, 100).is_err() && detector.check_windows(65, 130).is_ok());
    }
}

//! The detector for the tiles of one cloud.

use std::ops::Range;
use std::sync::Arc;

use super::candidate::by_place;
use super::{Candidate, TileCandidates, by_rank, column_side, voxels_of_column};
use crate::control::Control;
use crate::detect::localize::{Place, Surroundings, localize};
use crate::detect::modes::{SHIFT, modes_of};
use crate::detect::{Candidates, Counts, candidates};
use crate::field::{Field, check_number_of_points};
use crate::lattice::{Queries, from_corner};
use crate::network::Network;
use crate::options::{Options, Radii};
use crate::{Error, Result};
use snake_geometry::{Covariance, Fate, Normalization, Point, by_falling_score, check_points, suppress_seen};

/// Number of columns around a tile that contain all points on which its voxels depend.
///
/// The receptive field is 79 voxels in each direction, counting blocks that exist only because a neighbour has
/// points. That is less than five blocks of the coarsest level. The planes that localize a keypoint lie closer.
const HALO: i32 = 5;

/// A scene model with options for the tiles of one cloud. All points are relative to the origin of the whole cloud.
#[derive(Debug, Clone)]
pub struct PlacedDetector {
    pub(super) network: Arc<Network>,
    pub(super) options: Options,
    pub(super) voxel_size: f32,
    pub(super) lowest_corner: Point,
    pub(super) radii: Radii,
}

/// The result of [`PlacedDetector::detect`].
#[derive(Debug, Clone, PartialEq)]
pub enum TileOutcome {
    /// The candidates of the tile.
    Done(TileCandidates),
    /// Mode seeking depends on candidates beyond the margin: the tile must be detected again with this one.
    NeedsMargin(i32),
}

impl PlacedDetector {
    /// The lowest x and y of a column.
    pub fn corner_of_column(&self, column: [i32; 2]) -> [f64; 2] {
        let (start, side) = (self.normalization().center, column_side(&self.network, self.voxel_size));
        std::array::from_fn(|axis| f64::from(start[axis]) + f64::from(column[axis]) * side)
    }

    /// The options.
    pub fn options(&self) -> &Options {
        &self.options
    }

    fn normalization(&self) -> Normalization {
        from_corner(self.lowest_corner, self.voxel_size)
    }

    /// The voxel of a finite point.
    ///
    /// # Errors
    /// [`Error::Option`] when the point is too far from the lowest corner for the size of a voxel.
    fn voxel(&self, point: &Point) -> Result<[i32; 3]> {
        let voxel = self.normalization().to_network(*point).map(f32::floor);
        if voxel.iter().all(|v| v.abs() < (1 << 20) as f32) {
            return Ok(voxel.map(|v| v as i32));
        }
        let value = format!("{}, too small for the point {point:?}", self.voxel_size);
        let allowed = "at least a millionth of the cloud's extent";
        Err(Error::Option { name: "voxel_size", value, allowed })
    }

    /// The column of a finite point, along x and y.
    ///
    /// # Errors
    /// [`Error::Option`] when the point is too far from the lowest corner for the size of a voxel.
    pub fn column(&self, point: &Point) -> Result<[i32; 2]> {
        let [x, y, _] = self.voxel(point)?;
        Ok(self.column_of(&[x, y, 0]))
    }

    fn column_of(&self, voxel: &[i32; 3]) -> [i32; 2] {
        [0, 1].map(|axis: usize| voxel[axis].div_euclid(voxels_of_column(&self.network)))
    }

    /// Number of columns around a tile that contain all points on which its candidates depend.
    pub fn halo(&self) -> i32 {
        HALO
    }

    /// Number of columns around a tile whose candidates mode seeking needs. Long chains of
    /// candidates need more, see [`PlacedDetector::detect`].
    pub fn margin(&self) -> i32 {
        let columns =
            |radius: f32| (f64::from(SHIFT * radius) / column_side(&self.network, self.voxel_size)).ceil() as i32;
        self.radii.mode.map_or(0, |radius| columns(radius).max(1))
    }

    /// Finds the candidates of the voxels in the columns `[x, y]` of `tile`, unless mode seeking needs a larger margin: it
    /// moves the most salient candidates that are some distance apart, and each choice can depend on a chain of others.
    ///
    /// `points` are all finite points in these columns and in the `margin` and [`PlacedDetector::halo`] columns around them, in
    /// the order of the whole cloud; more points are allowed. `is_whole` says that the cloud has no points beyond the margin.
    ///
    /// # Errors
    /// The errors of [`Model::detect_with`](crate::Model::detect_with).
    pub fn detect(
        &self,
        points: &[Point],
        tile: &[Range<i32>; 2],
        margin: i32,
        is_whole: bool,
        control: &Control,
    ) -> Result<TileOutcome> {
        if points.is_empty() {
            return Ok(TileOutcome::Done(TileCandidates::default()));
        }
        check_points("points", points)?;
        check_number_of_points(points.len())?;
        let field = Field::normalized(self.network.clone(), points.to_vec(), self.normalization(), control);
        let field = field.map_err(advised)?;
        let near = tile.clone().map(|range| range.start.saturating_sub(margin)..range.end.saturating_add(margin));
        let owned_candidates = |is_own: bool| -> Result<(Vec<Candidate>, Counts)> {
            let owns = |point: &Point| self.is_in(point, &near) && self.is_in(point, tile) == is_own;
            let cells = field.lattice().cell_means().iter().copied();
            let cells: Vec<Point> = cells.filter(|cell| owns(&field.normalization().to_cloud(*cell))).collect();
            let queries = Queries::cells(cells.into_iter());
            let Candidates { positions, scores, counts, .. } =
                candidates(&field, &queries, &self.options.detect, control)?;
            let candidate = |(&position, &saliency)| {
                let cell = self.voxel(&position)?;
                let (covariance, rank, start) = (Covariance::UNKNOWN, saliency, saliency);
                let confidence =
                    self.network.confidence(saliency, [f32::INFINITY; 3], self.voxel_size, self.radii.reach);
                Ok(Candidate { position, saliency, occupancy: 0.0, confidence, covariance, rank, start, cell })
            };
            Ok((positions.iter().zip(scores.iter()).map(candidate).collect::<Result<_>>()?, counts))
        };
        let (mut candidates, counts) = owned_candidates(true)?;
        if let Some(radius) = self.radii.mode {
            candidates.extend(owned_candidates(false)?.0);
            candidates.sort_by_key(by_place);
            let Some(modes) = self.modes(&candidates, radius, tile, (!is_whole).then_some(&near))? else {
                return Ok(TileOutcome::NeedsMargin(margin.saturating_mul(2)));
            };
            let positions: Vec<Point> = modes.iter().map(|candidate| candidate.position).collect();
            let scores: Vec<f32> = modes.iter().map(|candidate| candidate.saliency).collect();
            let places =
                localize(&Surroundings::of(&field, self.options.detect.prefer)?.patches()?, &positions, &scores);
            let localized = |(candidate, place): (Candidate, Place)| {
                let Place { position, covariance, deviations, .. } = place;
                let rank = place.rank(candidate.saliency);
                let confidence =
                    self.network.confidence(candidate.saliency, deviations, self.voxel_size, self.radii.reach);
                Candidate { position, confidence, covariance, rank, ..candidate }
            };
            let drops_rows = self.options.detect.min_confidence.is_some();
            let stays = |(_, place): &(Candidate, Place)| !(drops_rows && place.is_one_of_many(self.voxel_size));
            candidates = modes.into_iter().zip(places).filter(stays).map(localized).collect();
        }
        let positions: Vec<Point> = candidates.iter().map(|candidate| candidate.position).collect();
        for (candidate, occupancy) in candidates.iter_mut().zip(field.occupancy(&positions)?) {
            candidate.occupancy = occupancy;
        }
        Ok(TileOutcome::Done(TileCandidates { candidates, counts }))
    }

    /// Whether a point lies in the columns.
    pub fn is_in(&self, point: &Point, columns: &[Range<i32>; 2]) -> bool {
        self.column(point).is_ok_and(|column| contain(columns, column))
    }

    /// The candidates of a tile after mode seeking; `None` if a choice depends on unseen candidates.
    /// `candidates` are those of the columns `seen`; without `seen`, those of the whole cloud.
    fn modes(
        &self,
        candidates: &[Candidate],
        radius: f32,
        tile: &[Range<i32>; 2],
        seen: Option<&[Range<i32>; 2]>,
    ) -> Result<Option<Vec<Candidate>>> {
        let positions: Vec<Point> = candidates.iter().map(|candidate| candidate.position).collect();
        let scores: Vec<f32> = candidates.iter().map(|candidate| candidate.start).collect();
        let order = by_falling_score(&scores);
        let ranked: Vec<Point> = order.iter().map(|&index| positions[index]).collect();
        let reach = f64::from(self.radii.starts) * (1.0 + 1e-5);
        let sees_all = |rank: usize| seen.is_none_or(|seen| self.is_inside(&ranked[rank], reach, seen));
        let fates = suppress_seen(&ranked, self.radii.starts, sees_all)?;
        let is_own = |index: usize| contain(tile, self.column_of(&candidates[index].cell));
        let own = || order.iter().zip(&fates).filter(|(index, _)| is_own(**index));
        if own().any(|(_, fate)| *fate == Fate::Unknown) {
            return Ok(None);
        }
        let starts: Vec<usize> = own().filter(|(_, fate)| **fate == Fate::Kept).map(|(index, _)| *index).collect();
        let (moved, mode_scores) = modes_of(&positions, &scores, radius, &starts)?;
        let modes = starts.iter().zip(moved.iter().zip(mode_scores.iter()));
        let mut modes: Vec<Candidate> = modes
            .map(|(&start, (&position, &saliency))| Candidate { position, saliency, ..candidates[start] })
            .collect();
        modes.sort_by_key(by_place);
        Ok(Some(modes))
    }

    /// Whether all points at most `reach` from a point along x and y lie in the columns.
    pub fn is_inside(&self, point: &Point, reach: f64, columns: &[Range<i32>; 2]) -> bool {
        (0..2).all(|axis| {
            let at = f64::from(point[axis]);
            let ends = [columns[axis].start, columns[axis].end];
            let [low, high] = ends.map(|column| self.corner_of_column([column; 2])[axis]);
            // The column of a point is computed in `f32`, so the reach includes its rounding error.
            let reach = reach + 1e-6 * at.abs();
            at - reach > low && at + reach < high
        })
    }

    /// The distance along an axis beyond which no candidate suppresses another, in cloud units.
    pub fn suppression_reach(&self) -> f64 {
        f64::from(self.radii.nms) * (1.0 + 1e-5)
    }

    /// What suppression does with each candidate of a part of the cloud. `sees_all` tells whether the part has all
    /// candidates within [`PlacedDetector::suppression_reach`] of a candidate. Candidates are ranked by [`by_rank`].
    ///
    /// # Errors
    /// [`Error::Input`] for more candidates than [`u32::MAX`].
    pub fn fates(&self, candidates: &[Candidate], sees_all: impl Fn(&Candidate) -> bool) -> Result<Vec<Fate>> {
        let mut order: Vec<usize> = (0..candidates.len()).collect();
        order.sort_by(|&a, &b| by_rank(&candidates[a], &candidates[b]));
        let ranked: Vec<Point> = order.iter().map(|&index| candidates[index].position).collect();
        let ranked_fates = suppress_seen(&ranked, self.radii.nms, |rank| sees_all(&candidates[order[rank]]))?;
        let mut fates = vec![Fate::Unknown; candidates.len()];
        order.iter().zip(ranked_fates).for_each(|(&index, fate)| fates[index] = fate);
        Ok(fates)
    }
}

fn contain(columns: &[Range<i32>; 2], [x, y]: [i32; 2]) -> bool {
    columns[0].contains(&x) && columns[1].contains(&y)
}

/// Adds the advice to use smaller tiles to the error about a volume that is too large.
fn advised(error: Error) -> Error {
    match error {
        Error::Option { name: "voxel_size", value, allowed } => {
            let reason = format!("`voxel_size` is {value}. Use a smaller tile, or {allowed}");
            Error::Input { what: "tile", reason }
        }
        other => other,
    }
}

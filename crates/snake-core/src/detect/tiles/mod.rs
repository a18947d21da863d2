//! Detection of one tile of a cloud that is too large for memory. Tiles give the keypoints of the whole cloud, bit for bit.
//!
//! The voxels of a scene lie on a lattice that begins below the lowest corner of the whole cloud. A tile owns whole columns along
//! x and y, as wide as a block of the network's coarsest level. The output of the network at a voxel depends on the points of its
//! column and of [`TileDetector::halo`] columns around it. Mode seeking looks at candidates of some columns more
//! ([`TileDetector::margin`]). The candidates of all tiles are suppressed together ([`TileDetector::fates`]), which says where a
//! tile must know more of its neighbours.

mod candidate;
#[cfg(test)]
mod tests;

pub use self::candidate::{Candidate, TileCandidates, by_rank};

use self::candidate::by_place;
use std::ops::Range;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::localize::{Place, Surroundings, localize};
use super::modes::{SHIFT, modes_of};
use super::{Candidates, Counts, candidates, diagonal};
use crate::cloud::UsedCloud;
use crate::control::Control;
use crate::field::{Field, check_number_of_points};
use crate::lattice::{Queries, from_corner, voxel_size};
use crate::network::Network;
use crate::options::{DetectOptions, Options, Preference, Radii};
use crate::{Error, Result};
use snake_geometry::{Covariance, Fate, Length, Normalization, Point, by_falling_score, check_points, suppress_seen};
use snake_kernels::BLOCK_SIDE;

/// The number of columns around a tile whose points its voxels depend on.
///
/// The receptive field is 79 voxels in each direction, counting blocks that exist only because a neighbour has points. That is
/// less than five blocks of the coarsest level. The planes that localize a keypoint are nearer.
const HALO: i32 = 5;

/// A scene model with options for the tiles of a cloud. All points are relative to the origin of the whole cloud.
#[derive(Debug, Clone)]
pub struct TileDetector {
    network: Arc<Network>,
    options: Options,
    /// 0 before [`TileDetector::choose_voxel_size`].
    voxel_size: f32,
    /// The origin before [`TileDetector::set_bounds`].
    lowest_corner: Point,
    /// Infinite before [`TileDetector::set_bounds`].
    diagonal: f32,
    /// Lengths in `r` are 0 before [`TileDetector::set_resolution`].
    radii: Radii,
}

/// The fingerprint of everything that decides the candidates of a tile, apart from the cloud.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TileSettings {
    /// The BLAKE3 digest of the model's weight file.
    pub model: String,
    /// The options.
    pub options: Options,
}

impl TileDetector {
    /// A detector of tiles of a network, see [`TileDetector::new`].
    pub(crate) fn for_network(network: Arc<Network>, options: &Options) -> Result<Self> {
        let name = network.metadata.get("name").map_or("a model of objects", String::as_str);
        network.config.volume.check_tiles(name)?;
        network.check(options)?;
        check_parts(&options.detect, options.encode.max_points)?;
        let voxel_size = match options.encode.voxel_size {
            None => 0.0,
            Some(length @ Length::Units(_)) => length.in_units("voxel_size", &[])? as f32,
            Some(other) => {
                let allowed = "a length in cloud units in tiles, such as `0.1`";
                return Err(Error::Option { name: "voxel_size", value: other.to_string(), allowed });
            }
        };
        let radii = Radii { nms: 0.0, mode: None, starts: 0.0 };
        let (lowest_corner, diagonal) = ([0.0; 3], f32::INFINITY);
        let mut detector = Self { network, options: *options, voxel_size, lowest_corner, diagonal, radii };
        detector.radii = detector.radii_of(0.0)?;
        Ok(detector)
    }

    /// Whether the options have no voxel size.
    pub fn needs_voxel_size(&self) -> bool {
        self.options.encode.voxel_size.is_none()
    }

    /// Chooses the voxel size for all finite points of the cloud, as [`Model::encode`](crate::Model::encode) does. It then stands in the options.
    ///
    /// # Errors
    /// [`Error::Input`] for a cloud without extent.
    pub fn choose_voxel_size(&mut self, points: &[Point]) -> Result<()> {
        self.voxel_size = voxel_size(None, &UsedCloud::new(points)?, &Control::default())?;
        self.options.encode.voxel_size = Some(Length::Units(self.voxel_size.into()));
        self.radii = self.radii_of(0.0)?;
        Ok(())
    }

    /// Sets the lowest and the highest coordinate of the finite points of the whole cloud along each axis. The lattice begins at
    /// the lowest corner, and with it the columns. The voxel size comes before, the resolution after.
    ///
    /// # Errors
    /// [`Error::Option`] for a length out of its range.
    pub fn set_bounds(&mut self, [low, high]: [Point; 2]) -> Result<()> {
        (self.lowest_corner, self.diagonal) = (low, diagonal(&[low, high]));
        self.radii = self.radii_of(0.0)?;
        Ok(())
    }

    /// The lowest x and y of a column.
    pub fn corner_of_column(&self, column: [i32; 2]) -> [f64; 2] {
        let start = self.normalization().center;
        std::array::from_fn(|axis| f64::from(start[axis]) + f64::from(column[axis]) * self.column_side())
    }

    /// Whether a length of the options is in resolutions of the cloud.
    pub fn needs_resolution(&self) -> bool {
        let lengths = [self.options.detect.nms_radius, self.options.detect.mode_radius];
        lengths.iter().any(|length| matches!(length, Some(Length::Resolutions(_))))
    }

    /// Gives lengths in `r` their value from the [resolution](snake_geometry::resolution) of the whole cloud.
    ///
    /// # Errors
    /// [`Error::Option`] for a resolution of 0.
    pub fn set_resolution(&mut self, resolution: f64) -> Result<()> {
        self.radii = self.radii_of(resolution)?;
        Ok(())
    }

    fn radii_of(&self, resolution: f64) -> Result<Radii> {
        let mut detect = self.options.detect;
        for (name, length) in [("nms_radius", &mut detect.nms_radius), ("mode_radius", &mut detect.mode_radius)] {
            if let Some(multiple @ Length::Resolutions(_)) = *length {
                let known = || multiple.resolve(name, || resolution).map(Length::Units);
                *length = (resolution > 0.0).then(known).transpose()?;
            }
        }
        detect.radii(&[], self.voxel_size, Some(self.diagonal))
    }

    /// The model and the options, which decide the candidates of a tile together with the cloud.
    pub fn settings(&self) -> TileSettings {
        TileSettings { model: self.network.digest.clone(), options: self.options }
    }

    /// The options.
    pub fn options(&self) -> &Options {
        &self.options
    }

    /// The radius of suppression in cloud units; 0 for no suppression.
    pub fn nms_radius(&self) -> f32 {
        self.radii.nms
    }

    /// Voxels along the side of a column: a block of the coarsest level.
    fn voxels_of_column(&self) -> i32 {
        (BLOCK_SIDE as i32) << (self.network.config.unet_levels - 1)
    }

    /// The side of a column in cloud units.
    pub fn column_side(&self) -> f64 {
        f64::from(self.voxels_of_column()) * f64::from(self.voxel_size)
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
        [0, 1].map(|axis: usize| voxel[axis].div_euclid(self.voxels_of_column()))
    }

    /// The number of columns around a tile whose points its candidates depend on.
    pub fn halo(&self) -> i32 {
        HALO
    }

    /// The number of columns around a tile with the candidates that mode seeking needs, unless chains of candidates are
    /// longer, see [`TileDetector::detect`].
    pub fn margin(&self) -> i32 {
        let columns = |radius: f32| (f64::from(SHIFT * radius) / self.column_side()).ceil() as i32;
        self.radii.mode.map_or(0, |radius| columns(radius).max(1))
    }

    /// The candidates of the voxels in the columns `[x, y]` of `tile`. `None` if mode seeking needs a larger margin: it moves the
    /// most salient candidates that are some distance apart, and each choice can depend on a chain of others.
    ///
    /// `points` are all finite points in these columns and in `margin` and [`TileDetector::halo`] columns around them, in the order
    /// of the whole cloud. More points do no harm. `is_whole` says that no points of the cloud are farther than the margin.
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
    ) -> Result<Option<TileCandidates>> {
        if points.is_empty() {
            return Ok(Some(TileCandidates::default()));
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
                let confidence = self.network.confidence(saliency, [f32::INFINITY; 3], self.voxel_size);
                Ok(Candidate { position, saliency, occupancy: 0.0, confidence, covariance, rank, start, cell })
            };
            Ok((positions.iter().zip(scores.iter()).map(candidate).collect::<Result<_>>()?, counts))
        };
        let (mut candidates, counts) = owned_candidates(true)?;
        if let Some(radius) = self.radii.mode {
            candidates.extend(owned_candidates(false)?.0);
            candidates.sort_by_key(by_place);
            let Some(modes) = self.modes(&candidates, radius, tile, (!is_whole).then_some(&near))? else {
                return Ok(None);
            };
            let positions: Vec<Point> = modes.iter().map(|candidate| candidate.position).collect();
            let places = localize(&Surroundings::of(&field).patches()?, &positions);
            let localized = |(candidate, place): (Candidate, Place)| {
                let Place { position, covariance, deviations, .. } = place;
                let rank = place.rank(candidate.saliency);
                let confidence = self.network.confidence(candidate.saliency, deviations, self.voxel_size);
                Candidate { position, confidence, covariance, rank, ..candidate }
            };
            candidates = modes.into_iter().zip(places).map(localized).collect();
        }
        let positions: Vec<Point> = candidates.iter().map(|candidate| candidate.position).collect();
        for (candidate, occupancy) in candidates.iter_mut().zip(field.occupancy(&positions)?) {
            candidate.occupancy = occupancy;
        }
        Ok(Some(TileCandidates { candidates, counts }))
    }

    fn is_in(&self, point: &Point, columns: &[Range<i32>; 2]) -> bool {
        let is_inside = |column: [i32; 2]| (0..2).all(|axis| columns[axis].contains(&column[axis]));
        self.column(point).is_ok_and(is_inside)
    }

    /// The candidates of a tile after mode seeking. `candidates` are those of the columns `seen`, or of the whole cloud.
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
        let is_own = |index: usize| {
            let column = self.column_of(&candidates[index].cell);
            (0..2).all(|axis| tile[axis].contains(&column[axis]))
        };
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
            // The column of a point is computed in `f32`.
            let reach = reach + 1e-6 * at.abs();
            at - reach > low && at + reach < high
        })
    }

    /// The distance along an axis beyond which no candidate suppresses another, in cloud units.
    pub fn suppression_reach(&self) -> f64 {
        f64::from(self.radii.nms) * (1.0 + 1e-5)
    }

    /// The fate of each candidate of a part of the cloud. `sees_all` tells whether the part has all candidates within
    /// [`TileDetector::suppression_reach`] of one. Candidates are ranked by [`by_rank`].
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

/// Refuses options that need the whole cloud.
fn check_parts(detect: &DetectOptions, max_points: Option<usize>) -> Result<()> {
    let refused = |name, value: String, allowed| Err(Error::Option { name, value, allowed });
    if let Some(number) = max_points {
        return refused("max_points", number.to_string(), "none in tiles");
    }
    if detect.refine_steps > 0 {
        return refused("refine_steps", detect.refine_steps.to_string(), "0 in tiles");
    }
    if detect.prefer != Preference::Salient {
        return refused("prefer", "corners".into(), "salient in tiles");
    }
    if detect.snap {
        return refused("snap", "true".into(), "false in tiles");
    }
    for (name, length) in [("nms_radius", detect.nms_radius), ("mode_radius", detect.mode_radius)] {
        if let Some(length @ Length::Percent(_)) = length {
            let allowed = "a length in cloud units, in voxels as in `6v` or in resolutions as in `3r` in tiles";
            return refused(name, length.to_string(), allowed);
        }
    }
    Ok(())
}

/// Adds to the error of a volume that is too large that smaller tiles help.
fn advised(error: Error) -> Error {
    match error {
        Error::Option { name: "voxel_size", value, allowed } => {
            let reason = format!("`voxel_size` is {value}. Use a smaller tile, or {allowed}");
            Error::Input { what: "tile", reason }
        }
        other => other,
    }
}

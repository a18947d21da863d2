//! Options of detection.

use serde::{Deserialize, Serialize};

use super::none_if_zero;
use crate::Result;
use snake_geometry::{Length, Point, one_a_cell, options, resolution};

/// The method that moves queries up the saliency field.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum RefineMethod {
    /// Adam on one minus the mean saliency of all queries, as in the released code. Because of its ε, steps where the
    /// saliency is nearly constant depend slightly on the number of queries.
    #[default]
    Adam,
    /// Algorithm 1 as printed, with each query's own gradient; the gradient of the mean would be far too small.
    GradientDescent,
}

/// The position and score of a refined query. A score is the saliency where the occupancy is above the surface
/// threshold, else 0.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Selection {
    /// The best score of the trajectory, from the start to the position after the last step, and its position.
    #[default]
    BestPosition,
    /// As in the released code: the position after the last step, with the best score before each of the steps.
    ReferenceFinalPosition,
}

/// Which keypoints come first. Those suppress the others that are near them, and are kept where there are too many.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Preference {
    /// The most salient ones, as in the paper. Most of them are found again.
    #[default]
    Salient,
    /// Those at corners, ends and tips, and no others. To the saliency is added the distance from the mean of the input points
    /// within three voxels, as a share of this radius, and how much of a corner the planes make.
    Corners,
}

options! {
    /// Options of [`Field::detect`](crate::Field::detect); the defaults are the paper's for ModelNet40.
    pub struct DetectOptions {
        /// Number of queries along each axis of the query grid.
        ///
        /// The grid covers the network's cube ±0.5. The number of queries times `refine_steps + 1` times
        /// [`EncodeOptions::rotations`] is at most 2^28.
        query_resolution, with_query_resolution: usize = 64, from 1 to 256;
        /// Largest distance of a query from a voxel with input points, in voxels along each axis; 0: all queries are
        /// evaluated. Farther queries are dropped without evaluation: there are many of them, and hardly ever a surface.
        query_band, with_query_band: usize = 0, from 0 to 1024 " (voxels)";
        /// Occupancy above which a query is refined.
        ///
        /// 1 − thr_o of the paper.
        occupancy_threshold, with_occupancy_threshold: f32 = 0.5, from 0 to 1;
        /// Number of refinement steps.
        ///
        /// J of the paper.
        refine_steps, with_refine_steps: usize = 10, from 0 to 10000;
        /// Step size of refinement.
        ///
        /// λ of the paper.
        refine_step_size, with_refine_step_size: f32 = 1e-3, from 0 to 1 " (network units)";
        /// Method that moves queries up the saliency field.
        refine_method, with_refine_method: RefineMethod = RefineMethod::Adam;
        /// Position and score of a refined query: the best of its trajectory, or those of the released code.
        selection, with_selection: Selection = Selection::BestPosition;
        /// Occupancy above which a position lies on the surface.
        ///
        /// The default is the released code's.
        surface_threshold, with_surface_threshold: f32 = 0.8, from 0 to 1;
        /// Saliency above which a position is a keypoint.
        ///
        /// thr_s of the paper.
        saliency_threshold, with_saliency_threshold: f32 = 0.7, from 0 to 1, flag "SALIENCY";
        /// Least confidence of a keypoint: the probability that another view finds it again, for models whose file has a map
        /// of it. On walls and along sharp edges another view finds any place: scenes then have none there.
        ///
        /// It is [`Keypoint::confidence`](crate::Keypoint::confidence).
        #[serde(deserialize_with = "none_if_zero")]
        min_confidence, with_min_confidence: Option<f32> = None, none "no limit", from 0 to 1, flag "PROBABILITY";
        /// Radius within which keypoints move to the mean of the candidates before suppression, which is more precise than the
        /// best single query.
        ///
        /// Three steps of mean shift move them to the weighted mean within this radius, then 0.85 and 0.7 of it. Keypoints of scenes,
        /// and corners, then move to the point nearest to the planes around them; those of objects onto the surface. In a scene,
        /// a multiple of the resolution is at least two voxels.
        #[serde(deserialize_with = "none_if_zero")]
        mode_radius, with_mode_radius: Option<Length> = None, none "keypoints stay, as in the paper",
            from 0 or more " (cloud units, or as in `3r` resolutions)";
        /// Least distance of keypoints: in cloud units, in multiples of the cloud's resolution, the mean distance between
        /// nearest points (`3r`), in per cent of the cloud's radius (`10%`), or in voxels (`4v`; in a scene at most a 32nd of the
        /// diagonal of its box). The best of those that are closer is kept.
        #[serde(deserialize_with = "none_if_zero")]
        nms_radius, with_nms_radius: Option<Length> = Some(Length::Units(0.01)), none "no suppression",
            from 0 or more " (cloud units, or as in `3r` resolutions)", flag "LENGTH";
        /// Which keypoints come first: the most salient ones, or those at corners, ends and tips of the cloud, and no others.
        ///
        /// Tiles have the most salient ones. Corners are narrower than what repeats best: they have half the `mode_radius`.
        prefer, with_prefer: Preference = Preference::Salient, flag "KEYPOINTS";
        /// Largest number of keypoints; the best by `prefer` are kept.
        ///
        /// `usize::MAX` is no limit.
        #[serde(deserialize_with = "most_if_null")]
        max_keypoints, with_max_keypoints: usize = 64, none "no limit", flag "NUMBER";
        /// Whether each keypoint moves to its nearest input point. Several keypoints can then coincide, as in the paper.
        snap, with_snap: bool = false;
    }
}

impl DetectOptions {
    /// The radii of suppression and of mode seeking in cloud units, of a cloud in voxels of this size. `diagonal` is that of a
    /// scene's box; objects have none.
    pub(crate) fn radii(&self, points: &[Point], voxel_size: f32, diagonal: Option<f32>) -> Result<Radii> {
        let units = |name, length: Length| match length {
            Length::Units(radius) => Ok(radius as f32),
            Length::Voxels(number) => Ok(number as f32 * voxel_size),
            multiple => multiple.in_units(name, points).map(|radius| radius as f32),
        };
        let width = if self.prefer == Preference::Corners { 0.5 } else { 1.0 };
        let mut nms = self.nms_radius.map_or(Ok(0.0), |length| units("nms_radius", length))?;
        if let (Some(diagonal), Some(Length::Voxels(_))) = (diagonal, self.nms_radius) {
            nms = nms.min(diagonal * MAX_SHARE_OF_SCENE);
        }
        let mode = match self.mode_radius {
            Some(multiple @ Length::Resolutions(number)) if diagonal.is_some() => {
                let resolution = resolution_from(LEAST_MODE * f64::from(voxel_size) / number.max(1.0), points)?;
                Some(mode_of_scene(multiple, resolution, voxel_size)? as f32)
            }
            length => length.map(|length| units("mode_radius", length)).transpose()?,
        };
        let mode = mode.map(|radius| radius * width).filter(|radius| *radius > 0.0);
        let starts_in_voxels = diagonal.map_or(0.0, |_| SCENE_STARTS * voxel_size);
        let reach = (REACH * voxel_size).min(diagonal.map_or(f32::INFINITY, |diagonal| diagonal * REACH_OF_SCENE));
        Ok(Radii { nms, mode, reach, starts: mode.map_or(0.0, |radius| starts_in_voxels.max(radius / 2.0)) })
    }
}

/// The smallest radius of modes of a scene, in voxels, if it is given in resolutions.
const LEAST_MODE: f64 = 2.0;

/// The radius of modes of a scene of a known resolution, in cloud units. Sparse or noisy points need a wider mean; in dense ones, the
/// field is no finer than its voxels.
pub(crate) fn mode_of_scene(multiple: Length, resolution: f64, voxel_size: f32) -> Result<f64> {
    Ok(multiple.resolve("mode_radius", || resolution)?.max(LEAST_MODE * f64::from(voxel_size)))
}

/// Cells with points are at most so many times as many as cells four times as wide, unless the points lie closer together than 1.2
/// sides of the smaller ones.
const COVERED: usize = 11;

/// The resolution of a cloud, or `least` if it is finer. Dense points take a quarter of the time.
pub(super) fn resolution_from(least: f64, points: &[Point]) -> Result<f64> {
    let side = least / 1.2;
    let cells = one_a_cell(points, side, 0.0)?;
    let is_covered = cells.len() > COVERED * one_a_cell(&cells, 4.0 * side, 0.0)?.len();
    if is_covered { Ok(least) } else { Ok(resolution("points", points)?.max(least)) }
}

/// Lengths of [`DetectOptions`] in cloud units.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Radii {
    /// 0 for no suppression.
    pub(crate) nms: f32,
    pub(crate) mode: Option<f32>,
    /// The distance within which another view finds a keypoint again, as confidences count.
    pub(crate) reach: f32,
    /// The least distance of the candidates that move to modes.
    pub(crate) starts: f32,
}

/// A keypoint is found again within so many voxels, and in a scene within this share of its diagonal, as in
/// `snake_training.confidence`.
const REACH: f32 = 2.0;
const REACH_OF_SCENE: f32 = 1.0 / 104.0;

/// Keypoints whose distance is in voxels need not lie farther apart than this share of the diagonal of their scene: sparse points
/// have large voxels, and the scene has the same corners.
const MAX_SHARE_OF_SCENE: f32 = 1.0 / 32.0;

/// Candidates of a scene that move to modes lie at least this many voxels apart.
const SCENE_STARTS: f32 = 2.0;

/// A number, or the largest for null.
fn most_if_null<'de, D: serde::Deserializer<'de>>(deserializer: D) -> std::result::Result<usize, D::Error> {
    Ok(Option::<usize>::deserialize(deserializer)?.unwrap_or(usize::MAX))
}

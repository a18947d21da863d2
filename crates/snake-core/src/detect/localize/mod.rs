//! Where exactly: the point nearest to the tangent planes of the points around a keypoint (Förstner and Gülch 1987).
//!
//! The field says where to look, and its voxels are coarser than the points. The place `x` minimises the sum of
//! `w (nᵀ(x - p))²` over the planar patches around it, with means `p` and normals `n`. A weight `w` falls with the distance from
//! the keypoint, with the uncertainty of the normal, and with the residual, so that a stray point cannot pull (Geman and McClure
//! 1985). The keypoint stays along directions that the patches leave open.
//!
//! The inverse of `A = sum of w n nᵀ`, times the variance of the residuals, is the covariance of the place. All of it depends on the
//! points near a keypoint alone: tiles have the same bits.

mod patches;
#[cfg(test)]
mod tests;

use std::borrow::Cow;

use nalgebra::{Matrix3, SymmetricEigen};
use rayon::prelude::*;

use self::patches::{Patches, first_of_cells};
use crate::Result;
use crate::field::Field;
use snake_geometry::{Covariance, Point, Vector, resolution, vector};

/// The radius in voxels: of a scene, whose voxels are about as wide as the distance of its points, and of an object.
const RADIUS: [f32; 2] = [5.0, 2.2];
/// Where fewer than this many patches are near, the radius grows, ...
const FEW_PATCHES: f32 = 80.0;
/// ... up to this many times.
const MAX_GROWTH: f32 = 1.6;
/// Patches lie this share of the radius apart, and have points within the second share.
const PATCHES: [f32; 2] = [0.2, 0.5];
/// The weight that holds a keypoint, as a share of all weights.
const HOLD: f64 = 0.02;
/// The residual, as a share of the radius, at which a patch counts a quarter, in each round: less and less of other surfaces.
const TOLERANCES: [f64; 5] = [0.5, 0.35, 0.25, 0.15, 0.15];
/// The uncertainty of a normal, in radians, at which a patch counts half.
const TILT: f64 = 0.1;
/// The ratio of the variances across and along a patch at which it counts a quarter: it lies across an edge.
const FLATNESS: f64 = 0.1;
/// Values of [`Place::corner`] that make a difference in rank.
const CORNERS: [f32; 2] = [0.005, 0.2];
/// A direction is open if less than this share of the weights is along it, ...
const OPEN: f64 = 0.005;
/// ... or if the planes know it worse than the field does: to this share of the radius, 0.3 voxels of a scene.
const FIELD_DEVIATION: f64 = 0.06;
/// Points of an object that are asked, at most.
const MANY: usize = 8_192;
/// Points are dense if nearest ones are closer than this many voxels, on average.
const DENSE: f64 = 0.35;
/// Points show the surface if more than this share of their patches is certain.
const SHOWN: f32 = 0.25;
/// Smallest standard deviation of the residuals, as a share of the radius: `f32` has no finer positions far from the origin.
const MIN_RESIDUAL: f64 = 1e-4;
/// Neighbouring patches have points in common: so many patches tell as much as one.
const PATCHES_OF_ONE: f64 = 6.0;

/// A position by the points around it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Place {
    pub(crate) position: Point,
    pub(crate) covariance: Covariance,
    /// The share of the weights along the direction that is known least: a third at the corner of a cube, about 0 where a
    /// direction is open.
    pub(crate) corner: f32,
}

impl Place {
    /// What a keypoint is ranked by: corners are found again more often than edges and walls of the same saliency. A place of which
    /// nothing is known ranks by its score.
    pub(crate) fn rank(&self, score: f32) -> f32 {
        let [least, most] = CORNERS;
        score * (self.corner.clamp(least, most) / least).sqrt()
    }

    /// A position of which nothing is known.
    pub(crate) fn unknown(position: Point) -> Self {
        Self { position, covariance: Covariance::UNKNOWN, corner: 0.0 }
    }
}

/// Where keypoints of a field lie exactly.
///
/// # Errors
/// [`crate::Error::Input`] for more points than [`u32::MAX`].
pub(crate) fn localize(field: &Field, keypoints: &[Point]) -> Result<Vec<Place>> {
    let (points, radius) = (asked(field), radius(field));
    by_planes(&points, &anchors(field, &points), keypoints, radius)
}

/// Whether the points of a field show its surface: they are dense, and enough patches are flat, with certain normals. Thin bodies
/// have patches with points of both sides, which are not flat; points with noise hardly have any that are.
///
/// # Errors
/// [`crate::Error::Input`] for more points than [`u32::MAX`].
pub(super) fn shows_surface(field: &Field) -> Result<bool> {
    let points = asked(field);
    if resolution("points", &points)? > DENSE * f64::from(field.voxel_size()) {
        return Ok(false);
    }
    let anchors = anchors(field, &points);
    let patches = Patches::new(&points, &anchors, radius(field))?;
    let is_certain = |anchor: &usize| patches.at(*anchor).is_some_and(|patch| patch.is_certain());
    let number = (0..anchors.len()).into_par_iter().filter(is_certain).count();
    Ok(number as f32 > SHOWN * anchors.len() as f32)
}

/// The points that are asked: all of a scene; of an object every second, third and so on if it has too many.
pub(super) fn asked(field: &Field) -> Cow<'_, [Point]> {
    let points = field.points();
    if field.lattice().is_scene() || points.len() <= MANY {
        return points.into();
    }
    points.iter().step_by(points.len().div_ceil(MANY)).copied().collect()
}

/// The radius within which planes determine a keypoint.
fn radius(field: &Field) -> f32 {
    let [scene, object] = RADIUS;
    field.voxel_size() * if field.lattice().is_scene() { scene } else { object }
}

/// Where patches lie: the first point of each cell. The cells lie in the frame of the network, so that a moved scene has the same.
fn anchors(field: &Field, points: &[Point]) -> Vec<Point> {
    let (normalization, side) = (field.normalization(), PATCHES[0] * radius(field));
    first_of_cells(points, |point| normalization.to_network(point).map(|v| v * normalization.scale / side))
}

fn by_planes(points: &[Point], anchors: &[Point], keypoints: &[Point], radius: f32) -> Result<Vec<Place>> {
    let patches = Patches::new(points, anchors, radius)?;
    Ok(keypoints.par_iter().map(|keypoint| place(&patches, *keypoint, radius)).collect())
}

fn place(patches: &Patches, keypoint: Point, radius: f32) -> Place {
    let mut number = 0_u32;
    patches.anchors.within(&keypoint, radius, |_| number += 1);
    let radius = radius * (FEW_PATCHES / number.max(1) as f32).sqrt().clamp(1.0, MAX_GROWTH);
    let mut place = Place::unknown(keypoint);
    let mut at = keypoint;
    for tolerance in TOLERANCES {
        let planes = Planes::near(patches, &at, radius, tolerance * f64::from(radius));
        let Some(nearest) = planes.nearest(&at) else { return Place::unknown(keypoint) };
        if (nearest - vector(keypoint)).norm() > f64::from(radius) {
            return Place::unknown(keypoint);
        }
        at = nearest.map(|v| v as f32).into();
        place = planes.place(vector(keypoint), nearest, radius);
    }
    place
}

/// Weighted sums over the patches near a position, relative to it.
#[derive(Default)]
struct Planes {
    weight: f64,
    squared_weight: f64,
    squared_residual: f64,
    normals: Matrix3<f64>,
    target: Vector,
}

impl Planes {
    fn near(patches: &Patches, at: &Point, radius: f32, tolerance: f64) -> Self {
        let mut sums = Self::default();
        let radius_squared = f64::from(radius).powi(2);
        patches.anchors.within(at, radius, |anchor| {
            let Some(patch) = patches.at(anchor) else { return };
            let anchor = vector(patches.anchors.points()[anchor]) - vector(*at);
            let mean = anchor + patch.mean;
            let residual = patch.normal.dot(&mean);
            let mut weight = (1.0 - anchor.norm_squared() / radius_squared).max(0.0);
            weight /= 1.0 + (patch.tilt / TILT).powi(2);
            weight /= ((1.0 + (patch.flatness / FLATNESS).powi(2)) * (1.0 + (residual / tolerance).powi(2))).powi(2);
            sums.weight += weight;
            sums.squared_weight += weight * weight;
            sums.squared_residual += weight * residual * residual;
            sums.normals += patch.normal * patch.normal.transpose() * weight;
            sums.target += patch.normal * (residual * weight);
        });
        sums
    }

    /// The position nearest to the planes, from the one that the sums are relative to; `None` without planes.
    fn nearest(&self, at: &Point) -> Option<Vector> {
        let system = self.normals / self.weight + Matrix3::identity() * HOLD;
        let inverse = system.try_inverse().filter(|_| self.weight > 0.0)?;
        Some(vector(*at) + inverse * (self.target / self.weight))
    }

    /// The place of a keypoint that moves to a position along the directions that the planes do not leave open.
    fn place(&self, keypoint: Vector, nearest: Vector, radius: f32) -> Place {
        let number = (self.weight.powi(2) / self.squared_weight / PATCHES_OF_ONE).max(1.0);
        let residual = (self.squared_residual / self.weight).sqrt().max(MIN_RESIDUAL * f64::from(radius));
        let normals = self.normals / self.weight;
        let information = normals * (number / residual.powi(2));
        let open = OPEN.max((residual / (FIELD_DEVIATION * f64::from(radius))).powi(2) / number);
        let SymmetricEigen { eigenvalues, eigenvectors } = normals.symmetric_eigen();
        let along = |axis: usize| {
            let direction: Vector = eigenvectors.column(axis).into();
            let moved = if eigenvalues[axis] > open { direction.dot(&(nearest - keypoint)) } else { 0.0 };
            direction * moved
        };
        Place {
            position: (keypoint + along(0) + along(1) + along(2)).map(|v| v as f32).into(),
            covariance: Covariance::from_information(&information, open),
            corner: if eigenvalues.min() > open { eigenvalues.min() as f32 } else { 0.0 },
        }
    }
}

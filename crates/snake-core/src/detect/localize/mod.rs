//! Where exactly: the point nearest to the tangent planes of the points around a keypoint (Förstner and Gülch 1987).
//!
//! The field says where to look, and its voxels are coarser than the points. The place `x` minimises the sum of
//! `w (nᵀ(x - p))²` over the planar patches around it, with means `p` and normals `n`. A weight `w` rises with the number of points, and
//! falls with the distance from the keypoint, with the uncertainty of the normal, and with the residual, so that a stray point cannot
//! pull (Geman and McClure 1985).
//!
//! The inverse of `A = sum of w n nᵀ`, times the variance of the residuals, is the covariance of that place. Along each of its axes the
//! keypoint moves as far as the planes are to be trusted beside the field, and not at all where they leave a direction open. What the
//! field's place adds to the covariance is known too. All of it depends on the points near a keypoint alone: tiles have the same bits.

mod patches;
#[cfg(test)]
mod tests;

use std::borrow::Cow;

use nalgebra::{Matrix3, SymmetricEigen};
use rayon::prelude::*;

pub(crate) use self::patches::Patches;
use self::patches::{Anchors, Sums, first_of_cells};
use crate::Result;
use crate::field::Field;
use crate::options::Preference;
use snake_geometry::{Covariance, Point, Vector, resolution, vector};

/// The radius in voxels: of a scene, whose voxels are about as wide as the distance of its points, and of an object.
const RADIUS: [f32; 2] = [5.0, 2.2];
/// Cells of patches are as wide as this share of the radius, by default and for corners of objects, ...
const SIDES: [f32; 2] = [0.25, 0.2];
/// ... and patches have points within this share.
const REACH: f32 = 0.5;
/// Where the cells near have less than this area, in squares of the radius, the radius grows, ...
const SMALL_AREA: f32 = 3.2;
/// ... up to this many times.
const MAX_GROWTH: f32 = 1.6;
/// Where a cell of patches of a scene has fewer points than this, as in a thinned sweep, they know nothing finer than the field.
const MIN_DENSITY: f64 = 1.9;
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
/// A direction is open if less than this share of the weights is along it.
const OPEN: f64 = 0.005;
/// A keypoint moves half the way along a direction that planes know to this share of the radius, 0.25 voxels of a scene and 0.09 of an
/// object: the field finds its own place again about as well.
const FIELD_DEVIATION: [f64; 2] = [0.05, 0.04];
/// The standard deviation of the field's place from the one that the planes mean, as a share of the radius.
const FIELD_BIAS: f64 = 0.3;
/// An edge is known to this many voxels across, and not to that many along.
const EDGE: [f32; 2] = [0.3, 0.6];
/// The ratio of the variances across and along the points within the radius below which they are a wall: at an edge it is 0.25.
const WALL: f32 = 0.19;
/// Points of an object that are asked, at most.
const MANY: usize = 8_192;
/// Points are dense if nearest ones are closer than this many voxels, on average.
const DENSE: f64 = 0.35;
/// Points show the surface if more than this share of their patches is certain.
const SHOWN: f32 = 0.25;
/// So many patches are asked, about.
const SURVEY: usize = 256;
/// Smallest standard deviation of the residuals, as a share of the radius: `f32` has no finer positions far from the origin.
const MIN_RESIDUAL: f64 = 1e-4;

/// A position by the points around it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Place {
    pub(crate) position: Point,
    pub(crate) covariance: Covariance,
    /// The standard deviations of the place that planes mean, along three directions, in cloud units; infinite along those that are
    /// open.
    pub(crate) deviations: [f32; 3],
    /// The share of the weights along the direction that is known least: a third at the corner of a cube, about 0 where a
    /// direction is open.
    pub(crate) corner: f32,
    /// The ratio of the variances of the points within the radius, across and along them.
    pub(crate) flatness: f32,
}

impl Place {
    /// What a keypoint is ranked by: corners are found again more often than edges and walls of the same saliency. A place of which
    /// nothing is known ranks by its score.
    pub(crate) fn rank(&self, score: f32) -> f32 {
        let [least, most] = CORNERS;
        score * (self.corner.clamp(least, most) / least).sqrt()
    }

    /// Whether the points leave open where it lies: on a wall, or along a straight edge. Another view finds it again by chance, as
    /// one of those that stand in a row.
    pub(crate) fn is_one_of_many(&self, voxel_size: f32) -> bool {
        let mut deviations = self.deviations.map(|deviation| deviation / voxel_size);
        deviations.sort_by(f32::total_cmp);
        self.flatness < WALL || deviations[1] < EDGE[0] && deviations[2] > EDGE[1]
    }

    /// A position of which nothing is known.
    pub(crate) fn unknown(position: Point) -> Self {
        Self { position, covariance: Covariance::UNKNOWN, deviations: [f32::INFINITY; 3], corner: 0.0, flatness: 1.0 }
    }
}

/// Points that show where keypoints lie.
pub(crate) struct Surroundings<'a> {
    points: Cow<'a, [Point]>,
    anchors: Anchors,
    /// The radius within which planes determine a keypoint.
    radius: f32,
}

impl<'a> Surroundings<'a> {
    /// All points of a scene; of an object every second, third and so on if it has too many.
    pub(crate) fn of(field: &'a Field, prefer: Preference) -> Self {
        let (points, normalization) = (field.points(), field.normalization());
        let is_scene = field.lattice().is_scene();
        let radius = field.voxel_size() * RADIUS[usize::from(!is_scene)];
        let side = radius * SIDES[usize::from(!is_scene && prefer == Preference::Corners)];
        let step = if is_scene { 1 } else { points.len().div_ceil(MANY).max(1) };
        let points: Cow<[Point]> =
            if step == 1 { points.into() } else { points.iter().step_by(step).copied().collect() };
        // The cells lie in the frame of the network, so that a moved scene has the same.
        let place = |point| normalization.to_network(point).map(|v| v * normalization.scale);
        let anchors = first_of_cells(&points, side, place);
        Self { anchors: Anchors { is_scene, ..anchors }, points, radius }
    }

    /// Their planar patches.
    ///
    /// # Errors
    /// [`crate::Error::Input`] for more points than [`u32::MAX`].
    pub(crate) fn patches(&self) -> Result<Patches<'_>> {
        Patches::new(&self.points, &self.anchors, self.radius)
    }
}

/// Whether points show the surface between voxels: they are dense, and enough patches are flat, with certain normals. Thin bodies
/// have patches with points of both sides, which are not flat; points with noise hardly have any that are.
///
/// # Errors
/// [`crate::Error::Input`] when a coordinate is not finite.
pub(super) fn shows_surface(patches: &Patches, voxel_size: f32) -> Result<bool> {
    if resolution("points", patches.points())? > DENSE * f64::from(voxel_size) {
        return Ok(false);
    }
    let number = patches.anchors.points().len();
    let is_certain = |anchor: &usize| patches.at(*anchor).is_some_and(|patch| patch.is_certain());
    let asked: Vec<usize> = (0..number).step_by(number.div_ceil(SURVEY).max(1)).collect();
    let certain = asked.par_iter().filter(|anchor| is_certain(anchor)).count();
    Ok(certain as f32 > SHOWN * asked.len() as f32)
}

/// Where keypoints lie exactly.
pub(crate) fn localize(patches: &Patches, keypoints: &[Point]) -> Vec<Place> {
    keypoints.par_iter().map(|keypoint| place(patches, *keypoint)).collect()
}

fn place(patches: &Patches, keypoint: Point) -> Place {
    let (mut around, mut points) = (Sums::default(), 0);
    patches.anchors.within(&keypoint, patches.radius, |anchor| {
        around.add(&(vector(patches.anchors.points()[anchor]) - vector(keypoint)));
        points += patches.counts[anchor];
    });
    let flatness = around.plane(0.0).map_or(1.0, |plane| plane.flatness as f32);
    let unknown = Place { flatness, ..Place::unknown(keypoint) };
    if patches.is_scene && f64::from(points) < MIN_DENSITY * around.count as f64 {
        return unknown;
    }
    let area = around.count.max(1) as f32 * (patches.side / patches.radius).powi(2);
    let radius = patches.radius * (SMALL_AREA / area).sqrt().clamp(1.0, MAX_GROWTH);
    let (mut at, mut last) = (keypoint, None);
    for tolerance in TOLERANCES {
        let planes = Planes::near(patches, &at, radius, tolerance * f64::from(radius));
        let is_near = |nearest: &Vector| (nearest - vector(keypoint)).norm() <= f64::from(radius);
        let Some(nearest) = planes.nearest(&at).filter(is_near) else { return unknown };
        at = nearest.map(|v| v as f32).into();
        last = Some((planes, nearest));
    }
    let radius = f64::from(radius);
    let field_deviation = FIELD_DEVIATION[usize::from(!patches.is_scene)] * radius;
    let place = |(planes, nearest): (Planes, Vector)| planes.place(vector(keypoint), nearest, radius, field_deviation);
    Place { flatness, ..last.map_or(unknown, place) }
}

/// Weighted sums over the patches near a position, relative to it.
#[derive(Default)]
struct Planes {
    weight: f64,
    squared_weight: f64,
    /// Weights times the shares of points that no other patch has.
    own_weight: f64,
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
            let count = f64::from(patches.counts[anchor]);
            let anchor = vector(patches.anchors.points()[anchor]) - vector(*at);
            let mean = anchor + patch.mean;
            let residual = patch.normal.dot(&mean);
            let mut weight = count * (1.0 - anchor.norm_squared() / radius_squared).max(0.0);
            weight /= 1.0 + (patch.tilt / TILT).powi(2);
            weight /= ((1.0 + (patch.flatness / FLATNESS).powi(2)) * (1.0 + (residual / tolerance).powi(2))).powi(2);
            sums.weight += weight;
            sums.squared_weight += weight * weight;
            sums.own_weight += weight * patch.own;
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
    fn place(&self, keypoint: Vector, nearest: Vector, radius: f64, field_deviation: f64) -> Place {
        let number = self.weight * self.own_weight / self.squared_weight;
        let residual = (self.squared_residual / self.weight).sqrt().max(MIN_RESIDUAL * radius);
        let SymmetricEigen { eigenvalues, eigenvectors } = (self.normals / self.weight).symmetric_eigen();
        let (mut position, mut variances, mut corner) = (keypoint, [f64::INFINITY; 3], f64::INFINITY);
        let mut deviations = [f32::INFINITY; 3];
        for (axis, direction) in eigenvectors.column_iter().enumerate() {
            let share = eigenvalues[axis];
            if share <= OPEN {
                corner = 0.0;
                continue;
            }
            let variance = residual.powi(2) / (number * share);
            let trust = (field_deviation.powi(2) / variance).powi(3);
            let gain = trust / (1.0 + trust);
            position += direction * (gain * direction.dot(&(nearest - keypoint)));
            variances[axis] = gain.powi(2) * variance + ((1.0 - gain) * FIELD_BIAS * radius).powi(2);
            deviations[axis] = variance.sqrt() as f32;
            corner = corner.min(share * gain);
        }
        Place {
            position: position.map(|v| v as f32).into(),
            covariance: Covariance::along(&eigenvectors, variances),
            deviations,
            corner: corner as f32,
            flatness: 1.0,
        }
    }
}

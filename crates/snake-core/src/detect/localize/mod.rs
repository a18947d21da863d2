//! Localization: a keypoint moves to the point nearest to the tangent planes of the points around it (Förstner and Gülch 1987).
//!
//! The field gives only an approximate position, because its voxels are coarser than the points. The position `x` minimises
//! the sum of `w (nᵀ(x - p))²` over the planar patches around it, where `p` is the mean of a patch and `n` its normal. The
//! weight `w` rises with the number of points. It falls with the distance from the keypoint, the uncertainty of the normal,
//! the thickness of the patch and the residual, so that outliers have little influence (Geman and McClure 1985).
//!
//! The covariance of `x` is the inverse of `A = sum of w n nᵀ`, times the variance of the residuals. Along each eigenvector the
//! keypoint moves by a gain that weighs the planes against the field; along an open direction it stays. The covariance includes
//! the error of the field's position. The result depends only on the points near the keypoint, so tiles give the same bits.

mod noise;
mod patches;
#[cfg(test)]
mod tests;

use std::borrow::Cow;

use nalgebra::{Matrix3, SymmetricEigen};

use self::noise::{noise_across, noise_of_plane};
pub(crate) use self::patches::Patches;
use self::patches::{Anchors, Sums};
use crate::Result;
use crate::field::Field;
use crate::options::Preference;
use snake_geometry::{Covariance, Point, Vector, drawn, in_parallel, some_in_parallel, vector};

/// Radius of the neighbourhood in voxels, for scenes and objects. Voxels of a scene are about as wide as its point spacing.
const RADIUS: [f32; 2] = [5.0, 2.2];
/// Side of a cell of patches as a share of the radius: by default, and for objects if corners are preferred.
const SIDES: [f32; 2] = [0.25, 0.2];
/// A patch takes points within this share of the radius.
const REACH: f32 = 0.5;
/// The radius grows where the occupied cells within it cover less than this area, in squares of the radius.
const SMALL_AREA: f32 = 3.2;
/// Largest factor by which the radius grows.
const MAX_GROWTH: f32 = 1.6;
/// The points around a keypoint of a scene are sparse if nearby cells have fewer points on average, as in a thinned sweep.
const MIN_DENSITY: f64 = 1.9;
/// Sparse points localize only keypoints of at most this score: the field knows others better.
const FAINT: f32 = 0.5;
/// Weight of the regularization that holds a keypoint in place, as a share of all weights.
const HOLD: f64 = 0.02;
/// Residual at which a patch's weight falls to a quarter, by round, as a share of the radius. It shrinks to exclude other surfaces.
/// It also shrinks to some deviations of the residuals, down to the last value.
const TOLERANCES: [f64; 5] = [0.5, 0.3, 0.2, 0.15, 0.15];
const DEVIATIONS: f64 = 3.0;
const MIN_TOLERANCE: f64 = 0.03;
/// Standard deviation of a normal, in radians, at which the weight of its patch is halved.
const TILT: f64 = 0.1;
/// Ratio of the variances across and along a patch at which its weight falls to a quarter: such a patch lies across an edge.
const FLATNESS: f64 = 0.1;
/// Range within which [`Place::corner`] affects the rank.
const CORNERS: [f32; 2] = [0.005, 0.2];
/// A direction is open if its eigenvalue is at most this share of the weights.
const OPEN: f64 = 0.005;
/// Standard deviation of the planes' position at which a keypoint moves half the way, as a share of the radius:
/// 0.25 voxels of a scene and 0.09 of an object. The field repeats its own position about as precisely.
const FIELD_DEVIATION: [f64; 2] = [0.05, 0.04];
/// Standard deviation of the field's position relative to that of the planes, as a share of the radius.
const FIELD_BIAS: f64 = 0.3;
/// At an edge, two standard deviations are below the first value and the third, along the edge, is above the second, in voxels.
const EDGE: [f32; 2] = [0.3, 0.6];
/// The points within the radius form a wall if the ratio of their variances across and along is below this. An edge has 0.25.
const WALL: f64 = 0.19;
/// So few cells do not tell. The radius grows by these factors until there are more.
const MIN_ANCHORS: usize = 12;
const GROWTHS: [f32; 4] = [1.0, 1.6, 2.5, 4.0];
/// Largest ratio of the variances across a plane within the radius and farther away if both are the same noise; a thing on a wall has more.
const ALIKE: f64 = 1.25;
/// The smallest such variance in squares of the radius: thinner planes are visible within it.
const THICK: f64 = 0.03;
/// Number of points of an object that are used, at most.
const MANY: usize = 8_192;
/// Points are dense if a cell of patches has more than this many on average: their resolution is then about 0.35 voxels.
const DENSE: f32 = 1.25;
/// Points show the surface if more than this share of their patches is certain.
const SHOWN: f32 = 0.25;
/// Number of patches that are checked, at most.
const SURVEY: usize = 256;
/// Smallest standard deviation of the residuals, as a share of the radius: `f32` has no finer positions far from the origin.
const MIN_RESIDUAL: f64 = 1e-4;

/// A keypoint's position as the points around it determine it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Place {
    pub(crate) position: Point,
    pub(crate) covariance: Covariance,
    /// Standard deviations of the planes' position along three directions, in cloud units; infinite
    /// along open directions.
    pub(crate) deviations: [f32; 3],
    /// Share of the weights along the least determined direction, times its gain: about a third at
    /// the corner of a cube, 0 where a direction is open.
    pub(crate) corner: f32,
    /// Whether the points within the radius form a wall.
    pub(crate) is_wall: bool,
}

impl Place {
    /// The rank of a keypoint. Corners rank higher, because they are found again more often than edges
    /// and walls of the same saliency. A place that the points do not determine ranks by its score.
    pub(crate) fn rank(&self, score: f32) -> f32 {
        let [least, most] = CORNERS;
        score * (self.corner.clamp(least, most) / least).sqrt()
    }

    /// Whether the points do not fix the position, as on a wall or along a straight edge. Such
    /// keypoints stand in a row, and another view finds the same one only by chance.
    pub(crate) fn is_one_of_many(&self, voxel_size: f32) -> bool {
        let mut deviations = self.deviations.map(|deviation| deviation / voxel_size);
        deviations.sort_by(f32::total_cmp);
        self.is_wall || deviations[1] < EDGE[0] && deviations[2] > EDGE[1]
    }

    /// A position that the points do not determine.
    pub(crate) fn unknown(position: Point) -> Self {
        Self { position, covariance: Covariance::UNKNOWN, deviations: [f32::INFINITY; 3], corner: 0.0, is_wall: false }
    }
}

/// The points that localize keypoints, and the anchors of their patches.
pub(crate) struct Surroundings<'a> {
    points: Cow<'a, [Point]>,
    anchors: Anchors,
    /// The radius within which planes determine a keypoint.
    radius: f32,
}

impl<'a> Surroundings<'a> {
    /// Takes all points of a scene, and a sample of an object that has too many. A point that is
    /// stored several times was measured once.
    ///
    /// # Errors
    /// [`crate::Error::Input`] for more points than [`u32::MAX`].
    pub(crate) fn of(field: &'a Field, prefer: Preference) -> Result<Self> {
        let (points, normalization) = (field.points(), field.normalization());
        let is_scene = field.lattice().is_scene();
        let radius = field.voxel_size() * RADIUS[usize::from(!is_scene)];
        let side = radius * SIDES[usize::from(!is_scene && prefer == Preference::Corners)];
        let mut points: Cow<[Point]> = points.into();
        if !is_scene && points.len() > MANY {
            points = drawn(&points, MANY).into();
        }
        // The cells are aligned with the network's frame, so they move with the scene.
        let place = |point| normalization.to_network(point).map(|v| v * normalization.scale);
        let (mut anchors, copies) = Anchors::of(&points, side, is_scene, place)?;
        if !copies.is_empty() {
            let once = (0..).zip(points.iter()).filter(|(index, _)| !copies.contains(index));
            points = once.map(|(_, point)| *point).collect();
            anchors = Anchors::of(&points, side, is_scene, place)?.0;
        }
        Ok(Self { anchors, points, radius })
    }

    /// The planar patches of the points.
    ///
    /// # Errors
    /// [`crate::Error::Input`] for more points than [`u32::MAX`].
    pub(crate) fn patches(&self) -> Result<Patches<'_>> {
        Patches::new(&self.points, &self.anchors, self.radius)
    }
}

/// Whether the points show the surface more finely than voxels do: they are dense, and enough patches are flat with certain
/// normals. On thin bodies, patches contain points of both sides and are not flat. Noisy points have hardly any flat patches.
pub(super) fn shows_surface(patches: &Patches) -> bool {
    let number = patches.anchors.points().len();
    if (patches.points().len() as f32) < DENSE * number as f32 {
        return false;
    }
    let asked = (0..number).step_by(number.div_ceil(SURVEY).max(1));
    let certain = some_in_parallel(asked.clone(), |anchor| patches.at(anchor).filter(|patch| patch.is_certain()));
    certain.len() as f32 > SHOWN * asked.len() as f32
}

/// Localizes keypoints, which have these scores, on the planar patches around them.
pub(crate) fn localize(patches: &Patches, keypoints: &[Point], scores: &[f32]) -> Vec<Place> {
    in_parallel(0..keypoints.len(), |index| place(patches, keypoints[index], scores[index]))
}

fn place(patches: &Patches, keypoint: Point, score: f32) -> Place {
    let place = located(patches, keypoint, score);
    // Beside a corner, or where some points of a corner are missing, the surroundings look flat.
    let is_wall = is_wall(patches, &keypoint) && is_wall(patches, &place.position);
    Place { is_wall, ..place }
}

fn located(patches: &Patches, keypoint: Point, score: f32) -> Place {
    let unknown = Place::unknown(keypoint);
    let (mut cells, mut points) = (0, 0);
    patches.anchors.within(&keypoint, patches.radius, |anchor| {
        cells += 1;
        points += patches.counts[anchor];
    });
    let is_sparse = patches.is_scene && f64::from(points) < MIN_DENSITY * f64::from(cells);
    if is_sparse && score > FAINT {
        return unknown;
    }
    let area = cells.max(1) as f32 * (patches.side / patches.radius).powi(2);
    let radius = patches.radius * (SMALL_AREA / area).sqrt().clamp(1.0, MAX_GROWTH);
    let (mut at, mut last, mut residual) = (keypoint, None, f64::INFINITY);
    for tolerance in TOLERANCES {
        let length = f64::from(radius);
        let tolerance = (tolerance * length).min((DEVIATIONS * residual).max(MIN_TOLERANCE * length));
        let planes = Planes::near(patches, &at, radius, tolerance);
        residual = planes.residual();
        let is_near = |nearest: &Vector| (nearest - vector(keypoint)).norm() <= f64::from(radius);
        let Some(nearest) = planes.nearest(&at).filter(is_near) else { return unknown };
        at = nearest.map(|v| v as f32).into();
        last = Some((planes, nearest));
    }
    let radius = f64::from(radius);
    let field_deviation = FIELD_DEVIATION[usize::from(!patches.is_scene)] * radius;
    let place = |(planes, nearest): (Planes, Vector)| planes.place(vector(keypoint), nearest, radius, field_deviation);
    let place = last.map_or(unknown, place);
    Place { corner: if is_sparse { 0.0 } else { place.corner }, ..place }
}

/// Whether the points around a position form a wall, or something that looks like a corner only because of its noise.
fn is_wall(patches: &Patches, at: &Point) -> bool {
    let mut around = Sums::default();
    for growth in GROWTHS {
        around = Sums::default();
        patches.anchors.within(at, growth * patches.radius, |anchor| {
            around.add(&(vector(patches.anchors.points()[anchor]) - vector(*at)));
        });
        if around.count >= MIN_ANCHORS {
            break;
        }
    }
    let is_noisy = |radius| noise_of_plane(&patches.samples_near(at, radius), radius).is_some();
    // The same noise as a little farther away hides the plane within the radius, where it is as thick as wide.
    let is_thick_noise = |growth: &f32| {
        let mut points = patches.samples_near(at, growth * patches.radius);
        let Some((axes, far)) = noise_of_plane(&points, growth * patches.radius) else { return false };
        points.retain(|point| (point - axes[0] * axes[0].dot(point)).norm() < f64::from(patches.radius));
        let least = THICK * f64::from(patches.radius).powi(2);
        let near = noise_across(&points, patches.radius, &axes);
        near.is_some_and(|near| near > least && far < ALIKE * near && near < ALIKE * far)
    };
    around.plane(0.0).is_some_and(|plane| plane.flatness < WALL)
        || patches.is_scene
            && (is_noisy(patches.radius)
                || patches.noisy_radius(at).is_some_and(is_noisy)
                || GROWTHS[1..3].iter().any(is_thick_noise))
}

/// Weighted sums over the patches near a position, relative to it.
#[derive(Default)]
struct Planes {
    weight: f64,
    squared_weight: f64,
    /// Sum of the weights times the share of a patch's points that no other patch has.
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

    /// The standard deviation of the residuals.
    fn residual(&self) -> f64 {
        (self.squared_residual / self.weight).sqrt()
    }

    /// The position nearest to the planes, where `at` is the origin of the sums; `None` without planes.
    fn nearest(&self, at: &Point) -> Option<Vector> {
        let system = self.normals / self.weight + Matrix3::identity() * HOLD;
        let inverse = system.try_inverse().filter(|_| self.weight > 0.0)?;
        Some(vector(*at) + inverse * (self.target / self.weight))
    }

    /// The place of a keypoint after it moved towards `nearest` along the directions that the planes fix.
    fn place(&self, keypoint: Vector, nearest: Vector, radius: f64, field_deviation: f64) -> Place {
        let number = self.weight * self.own_weight / self.squared_weight;
        let residual = self.residual().max(MIN_RESIDUAL * radius);
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
            is_wall: false,
        }
    }
}

//! Planar patches of a cloud, of as many points as make the normal certain.

use std::collections::HashSet;
use std::sync::OnceLock;

use nalgebra::Matrix3;

use super::{MAX_GROWTH, PATCHES};
use crate::Result;
use snake_geometry::{Point, RadiusCells, Vector, eigen, vector};

/// Numbers of nearest points of a patch. The first one that is flat and whose normal is certain is taken: points with noise need more
/// of them, and so do points on beams, whose nearest neighbours lie on a line.
const SIZES: [usize; 4] = [12, 24, 48, 96];

/// A normal is certain if its standard deviation is below this, in radians.
const MAX_TILT: f64 = 0.1;

/// A patch is flat if the variance across it is below this share of the smaller one along it. At an edge it is about a quarter.
const MAX_FLATNESS: f64 = 0.15;

/// Fewer points have no plane.
const MIN_POINTS: usize = 6;

/// Smallest ratio of the variances along a patch: points on one beam have no plane.
const MIN_WIDTH: f64 = 0.05;

/// The first search takes points within this share of the reach.
const FIRST_REACH: f32 = 0.4;

/// The plane through some points, relative to a point of the cloud.
#[derive(Debug, Clone, Copy)]
pub(super) struct Patch {
    pub(super) mean: Vector,
    /// The unit normal, without a sign.
    pub(super) normal: Vector,
    /// The standard deviation of the normal in radians.
    pub(super) tilt: f64,
    /// The ratio of the variance across the patch to the smaller one along it.
    pub(super) flatness: f64,
}

impl Patch {
    /// Whether it is flat, and its normal certain.
    pub(super) fn is_certain(&self) -> bool {
        self.tilt < MAX_TILT && self.flatness < MAX_FLATNESS
    }
}

/// The first point of each cubic cell of a cloud, by coordinates in cells.
pub(super) fn first_of_cells(points: &[Point], cell: impl Fn(Point) -> Point) -> Vec<Point> {
    let mut taken = HashSet::new();
    points.iter().filter(|point| taken.insert(cell(**point).map(|v| v.floor() as i64))).copied().collect()
}

/// The patches at some points of a cloud, each computed when it is first needed.
pub(super) struct Patches<'a> {
    points: RadiusCells<'a>,
    pub(super) anchors: RadiusCells<'a>,
    patches: Vec<OnceLock<Option<Patch>>>,
}

impl<'a> Patches<'a> {
    /// The patches at anchors, for places that planes within `radius` determine.
    pub(super) fn new(points: &'a [Point], anchors: &'a [Point], radius: f32) -> Result<Self> {
        Ok(Self {
            points: RadiusCells::new(points, PATCHES[1] * radius)?,
            anchors: RadiusCells::new(anchors, MAX_GROWTH * radius)?,
            patches: anchors.iter().map(|_| OnceLock::new()).collect(),
        })
    }

    /// The patch at an anchor; `None` where too few points are near.
    pub(super) fn at(&self, anchor: usize) -> Option<Patch> {
        *self.patches[anchor].get_or_init(|| self.fitted(&self.anchors.points()[anchor]))
    }

    fn fitted(&self, at: &Point) -> Option<Patch> {
        let mut reach = FIRST_REACH * self.points.radius();
        let mut near = self.near(at, reach);
        let mut patch = None;
        for size in SIZES {
            if near.len() < size && reach < self.points.radius() {
                reach = self.points.radius();
                near = self.near(at, reach);
            }
            patch = fit(&near[..size.min(near.len())]);
            if patch.is_some_and(|patch: Patch| patch.is_certain()) || size >= near.len() {
                break;
            }
        }
        patch
    }

    /// Offsets of the points near a place, nearest first.
    fn near(&self, at: &Point, reach: f32) -> Vec<Vector> {
        let mut near = Vec::new();
        self.points.within(at, reach, |index| {
            let offset = vector(self.points.points()[index]) - vector(*at);
            near.push((offset.norm_squared(), index, offset));
        });
        near.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        near.into_iter().map(|(_, _, offset)| offset).collect()
    }
}

/// The plane of least squares; `None` for few points, and for points on a line.
fn fit(points: &[Vector]) -> Option<Patch> {
    let count = points.len() as f64;
    let mean = points.iter().sum::<Vector>() / count;
    let scatter: Matrix3<f64> = points.iter().map(|point| (point - mean) * (point - mean).transpose()).sum();
    let ([across, width, length], normal) = eigen(scatter / count);
    let is_plane = points.len() >= MIN_POINTS && width > MIN_WIDTH * length;
    let flatness = across.max(0.0) / width;
    is_plane.then(|| Patch { mean, normal, tilt: (flatness / count).sqrt(), flatness })
}

//! Planar patches of a cloud, of as many points as make the normal certain.

use std::collections::HashMap;
use std::sync::OnceLock;

use nalgebra::Matrix3;

use super::{MAX_GROWTH, PATCHES};
use crate::Result;
use snake_geometry::{Point, RadiusCells, Vector, eigen, vector};

/// Numbers of nearest points of a patch. The one whose normal is most certain is taken: dense points and points with noise need more
/// of them, and so do points on beams, whose nearest neighbours lie on a line. Edges need fewer.
const SIZES: [usize; 5] = [12, 24, 48, 96, 192];

/// A normal is certain if its standard deviation is below this, in radians.
const MAX_TILT: f64 = 0.1;

/// No more points are tried for a flat patch whose normal has this standard deviation, in radians.
const ENOUGH: f64 = 0.03;

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
    /// The share of its points that lie in the anchor's cell, at most 1: neighbouring patches have the others too.
    pub(super) own: f64,
}

impl Patch {
    /// Whether it is flat, and its normal certain.
    pub(super) fn is_certain(&self) -> bool {
        self.tilt < MAX_TILT && self.flatness < MAX_FLATNESS
    }
}

/// Where patches lie.
#[derive(Default)]
pub(super) struct Anchors {
    pub(super) points: Vec<Point>,
    /// How many points of the cloud are in the cell of each.
    counts: Vec<u32>,
}

/// The first point of each cubic cell of a cloud, by coordinates in cells.
pub(super) fn first_of_cells(points: &[Point], cell: impl Fn(Point) -> Point) -> Anchors {
    let (mut cells, mut anchors) = (HashMap::new(), Anchors::default());
    for point in points {
        let index = *cells.entry(cell(*point).map(|v| v.floor() as i64)).or_insert(anchors.points.len());
        if index == anchors.points.len() {
            anchors.points.push(*point);
            anchors.counts.push(0);
        }
        anchors.counts[index] += 1;
    }
    anchors
}

/// The patches at some points of a cloud, each computed when it is first needed.
pub(super) struct Patches<'a> {
    points: RadiusCells<'a>,
    pub(super) anchors: RadiusCells<'a>,
    counts: &'a [u32],
    patches: Vec<OnceLock<Option<Patch>>>,
}

impl<'a> Patches<'a> {
    /// The patches at anchors, for places that planes within `radius` determine.
    pub(super) fn new(points: &'a [Point], anchors: &'a Anchors, radius: f32) -> Result<Self> {
        Ok(Self {
            points: RadiusCells::new(points, PATCHES[1] * radius)?,
            anchors: RadiusCells::new(&anchors.points, MAX_GROWTH * radius)?,
            counts: &anchors.counts,
            patches: anchors.points.iter().map(|_| OnceLock::new()).collect(),
        })
    }

    /// The patch at an anchor; `None` where too few points are near.
    pub(super) fn at(&self, anchor: usize) -> Option<Patch> {
        *self.patches[anchor]
            .get_or_init(|| self.fitted(&self.anchors.points()[anchor], f64::from(self.counts[anchor])))
    }

    fn fitted(&self, at: &Point, in_cell: f64) -> Option<Patch> {
        let mut reach = FIRST_REACH * self.points.radius();
        let mut near = self.near(at, reach);
        let mut patch: Option<Patch> = None;
        for size in SIZES {
            if near.len() < size && reach < self.points.radius() {
                reach = self.points.radius();
                near = self.near(at, reach);
            }
            let next = fit(&near[..size.min(near.len())], in_cell);
            let is_steadier = |patch: &Patch| next.is_none_or(|next| next.tilt > patch.tilt);
            patch = patch.filter(is_steadier).or(next);
            let is_enough = |patch: Patch| patch.tilt < ENOUGH && patch.flatness < MAX_FLATNESS;
            if patch.is_some_and(is_enough) || size >= near.len() {
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

/// The plane of least squares, at an anchor with so many points in its cell; `None` for few points, and for points on a line.
fn fit(points: &[Vector], in_cell: f64) -> Option<Patch> {
    let count = points.len() as f64;
    let mean = points.iter().sum::<Vector>() / count;
    let scatter: Matrix3<f64> = points.iter().map(|point| (point - mean) * (point - mean).transpose()).sum();
    let ([across, width, length], normal) = eigen(scatter / count);
    let is_plane = points.len() >= MIN_POINTS && width > MIN_WIDTH * length;
    let flatness = across.max(0.0) / width;
    is_plane.then(|| Patch { mean, normal, tilt: (flatness / count).sqrt(), flatness, own: (in_cell / count).min(1.0) })
}

//! Planar patches of a cloud, of as many points as make the normal certain.

use std::collections::HashMap;
use std::sync::OnceLock;

use nalgebra::Matrix3;

use super::{MAX_GROWTH, REACH};
use crate::Result;
use snake_geometry::{Point, RadiusCells, Vector, eigen, vector};

/// Numbers of nearest points of a patch. The one whose normal is most certain is taken: dense points and points with noise need more
/// of them, and so do points on beams, whose nearest neighbours lie on a line. Edges need fewer.
const SIZES: [usize; 4] = [12, 24, 48, 96];

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

/// The first and the second search take about so many points; the last one all that are within reach.
const SEARCHED: [f32; 2] = [36.0, 144.0];

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
    /// The side of a cell.
    pub(super) side: f32,
    /// How many points of the cloud are in the cell of each.
    pub(super) counts: Vec<u32>,
    pub(super) is_scene: bool,
}

/// The first point of each cubic cell of a cloud, by where points lie in the frame of the cells.
pub(super) fn first_of_cells(points: &[Point], side: f32, place: impl Fn(Point) -> Point) -> Anchors {
    let (mut cells, mut anchors) = (HashMap::new(), Anchors { side, ..Anchors::default() });
    for point in points {
        let cell = place(*point).map(|v| (v / side).floor() as i64);
        let index = *cells.entry(cell).or_insert(anchors.points.len());
        if index == anchors.points.len() {
            anchors.points.push(*point);
            anchors.counts.push(0);
        }
        anchors.counts[index] += 1;
    }
    anchors
}

/// The patches at some points of a cloud, each computed when it is first needed.
pub(crate) struct Patches<'a> {
    points: RadiusCells<'a>,
    /// Rising radii of searches for points.
    searches: Vec<f32>,
    /// The radius within which they determine a place.
    pub(super) radius: f32,
    /// The side of a cell.
    pub(super) side: f32,
    pub(super) anchors: RadiusCells<'a>,
    pub(super) counts: &'a [u32],
    pub(super) is_scene: bool,
    patches: Vec<OnceLock<Option<Patch>>>,
}

impl<'a> Patches<'a> {
    /// The patches at anchors, for places that planes within `radius` determine.
    pub(super) fn new(points: &'a [Point], anchors: &'a Anchors, radius: f32) -> Result<Self> {
        let (side, reach) = (anchors.side, REACH * radius);
        let in_cell = points.len() as f32 / anchors.points.len().max(1) as f32;
        let searches = SEARCHED.map(|number| side * (number / (std::f32::consts::PI * in_cell)).sqrt());
        let searches: Vec<f32> = searches.into_iter().filter(|radius| *radius < reach).chain([reach]).collect();
        Ok(Self {
            radius,
            side,
            points: RadiusCells::new(points, searches[0])?,
            searches,
            anchors: RadiusCells::new(&anchors.points, MAX_GROWTH * radius)?,
            counts: &anchors.counts,
            is_scene: anchors.is_scene,
            patches: anchors.points.iter().map(|_| OnceLock::new()).collect(),
        })
    }

    /// The points.
    pub(crate) fn points(&self) -> &[Point] {
        self.points.points()
    }

    /// The patch at an anchor; `None` where too few points are near.
    pub(super) fn at(&self, anchor: usize) -> Option<Patch> {
        *self.patches[anchor]
            .get_or_init(|| self.fitted(&self.anchors.points()[anchor], f64::from(self.counts[anchor])))
    }

    fn fitted(&self, at: &Point, in_cell: f64) -> Option<Patch> {
        let mut searches = self.searches.iter();
        let mut near = Vec::new();
        let (mut sums, mut best) = (Sums::default(), None::<Patch>);
        for size in SIZES {
            while near.len() < size
                && let Some(radius) = searches.next()
            {
                near = self.near(at, *radius);
                put_nearest_first(&mut near, sums.count);
            }
            let rest = &mut near[sums.count..];
            let number = (size - sums.count).min(rest.len());
            put_nearest_first(rest, number);
            rest[..number].sort_unstable();
            rest[..number].iter().for_each(|&number| sums.add(&self.offset(at, number as u32)));
            let patch = sums.plane(in_cell);
            best = patch.filter(|patch| best.is_none_or(|best| patch.tilt <= best.tilt)).or(best);
            let is_enough = |patch: Patch| patch.tilt < ENOUGH && patch.flatness < MAX_FLATNESS;
            if patch.is_some_and(is_enough) || size > sums.count {
                break;
            }
        }
        best
    }

    /// The squared distances of the points within a radius, and their indices, as numbers that rise with the distance.
    fn near(&self, at: &Point, radius: f32) -> Vec<u64> {
        let mut near = Vec::new();
        self.points.within(at, radius, |index| {
            let point = self.points()[index];
            let squared: f32 = (0..3).map(|axis| (point[axis] - at[axis]).powi(2)).sum();
            near.push(u64::from(squared.to_bits()) << 32 | index as u64);
        });
        near
    }

    fn offset(&self, at: &Point, index: u32) -> Vector {
        vector(self.points()[index as usize]) - vector(*at)
    }
}

/// Moves so many of the nearest points to the front.
fn put_nearest_first(near: &mut [u64], number: usize) {
    if number < near.len() {
        near.select_nth_unstable(number);
    }
}

/// Sums over points, relative to the anchor.
#[derive(Default)]
pub(super) struct Sums {
    pub(super) count: usize,
    offsets: Vector,
    products: Matrix3<f64>,
}

impl Sums {
    pub(super) fn add(&mut self, offset: &Vector) {
        self.count += 1;
        self.offsets += offset;
        self.products += offset * offset.transpose();
    }

    /// The plane of least squares, at an anchor with so many points in its cell; `None` for few points, and for points on a line.
    pub(super) fn plane(&self, in_cell: f64) -> Option<Patch> {
        let count = self.count as f64;
        let mean = self.offsets / count;
        let ([across, width, length], normal) = eigen(self.products / count - mean * mean.transpose());
        let is_plane = self.count >= MIN_POINTS && width > MIN_WIDTH * length;
        let flatness = across.max(0.0) / width;
        let tilt = (flatness / count).sqrt();
        is_plane.then(|| Patch { mean, normal, tilt, flatness, own: (in_cell / count).min(1.0) })
    }
}

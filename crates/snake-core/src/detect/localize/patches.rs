//! Planar patches of a cloud. Each patch takes the number of points that makes its normal most certain.

use std::collections::HashMap;
use std::sync::OnceLock;

use nalgebra::Matrix3;

use super::{MAX_GROWTH, REACH};
use crate::Result;
use snake_geometry::{Point, RadiusCells, Vector, eigen, vector};

/// Numbers of nearest points that are tried for a patch; the one with the most certain normal is taken. Dense points,
/// noisy points and points on beams, whose nearest neighbours lie on a line, need more points. Edges need fewer.
const SIZES: [usize; 4] = [12, 24, 48, 96];

/// A normal is certain if its standard deviation is below this, in radians.
const MAX_TILT: f64 = 0.1;

/// No more points are tried once a flat patch has a normal of a smaller standard deviation than this, in radians.
const ENOUGH: f64 = 0.03;

/// A patch is flat if the variance across it is below this share of the smaller variance along it. An edge has about a quarter.
const MAX_FLATNESS: f64 = 0.15;

/// Smallest number of points that determine a plane.
const MIN_POINTS: usize = 6;

/// Smallest ratio of the two variances along a patch. Points on one beam have less and do not determine a plane.
const MIN_WIDTH: f64 = 0.05;

/// The first and the second search find about these numbers of points; the last search finds all points within reach.
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
    /// Share of its points that lie in the anchor's cell, at most 1. Neighbouring patches share the other points.
    pub(super) own: f64,
}

impl Patch {
    /// Whether it is flat, and its normal certain.
    pub(super) fn is_certain(&self) -> bool {
        self.tilt < MAX_TILT && self.flatness < MAX_FLATNESS
    }
}

/// The points around which patches are fitted.
#[derive(Default)]
pub(super) struct Anchors {
    pub(super) points: Vec<Point>,
    /// The side of a cell.
    pub(super) side: f32,
    /// Number of points of the cloud in the cell of each anchor.
    pub(super) counts: Vec<u32>,
    /// Whether the cloud has a point several times that is an anchor.
    pub(super) are_repeated: Vec<bool>,
    pub(super) is_scene: bool,
}

impl Anchors {
    /// The anchors that the cloud has several times.
    pub(super) fn repeated(&self) -> impl Iterator<Item = Point> {
        self.points.iter().zip(&self.are_repeated).filter(|(_, is_repeated)| **is_repeated).map(|(point, _)| *point)
    }
}

/// The cell of a place in the frame of the cells.
pub(super) fn cell_of(place: Point, side: f32) -> [i64; 3] {
    place.map(|v| (v / side).floor() as i64)
}

/// The first point of each cubic cell of a cloud. `place` maps a point to the frame of the cells.
pub(super) fn first_of_cells(points: &[Point], side: f32, place: impl Fn(Point) -> Point) -> Anchors {
    let (mut cells, mut anchors) = (HashMap::new(), Anchors { side, ..Anchors::default() });
    for point in points {
        let index = *cells.entry(cell_of(place(*point), side)).or_insert(anchors.points.len());
        if index == anchors.points.len() {
            anchors.points.push(*point);
            anchors.counts.push(0);
            anchors.are_repeated.push(false);
        } else if anchors.points[index] == *point {
            anchors.are_repeated[index] = true;
        }
        anchors.counts[index] += 1;
    }
    anchors
}

/// The patches at some points of a cloud, each computed when it is first needed.
pub(crate) struct Patches<'a> {
    points: RadiusCells<'a>,
    /// Radii of the searches for points, ascending.
    searches: Vec<f32>,
    /// The radius within which patches determine a place.
    pub(super) radius: f32,
    /// The side of a cell.
    pub(super) side: f32,
    pub(super) anchors: RadiusCells<'a>,
    pub(super) counts: &'a [u32],
    pub(super) is_scene: bool,
    patches: Vec<OnceLock<Option<Patch>>>,
}

impl<'a> Patches<'a> {
    /// The patches at the anchors. Planes within `radius` determine a place.
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

    /// The patch at an anchor; `None` where too few points are near, or where they lie on a line.
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

    /// The squared distance and the index of each point within a radius, packed into a number that rises with the distance.
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

/// Moves the `number` nearest points to the front.
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

    /// The least-squares plane, for an anchor with `in_cell` points in its cell; `None` for few points, and for points on a line.
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

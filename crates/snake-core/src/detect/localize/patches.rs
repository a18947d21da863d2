//! Planar patches of a cloud. Each patch takes the number of points that makes its normal most certain.

use std::cmp::Ordering;
use std::collections::HashSet;
use std::sync::OnceLock;

use nalgebra::Matrix3;

use super::{MAX_GROWTH, REACH};
use crate::Result;
use crate::cloud::quantile;
use snake_geometry::{CellGroups, Point, RadiusCells, Vector, eigen, floor, vector};

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

/// Number of points of a cell that show how noisy a wall is, at most.
const SAMPLES: usize = 4;

/// Side of a block, in cells: two radii. Its smallest variance shows how noisy the points are.
const BLOCK: i64 = 8;

/// Fewer points of a block do not show the noise.
const MIN_SAMPLES: usize = 12;

/// The noise near a position is a low quantile of the standard deviations of the blocks within this many radii.
const AROUND: f32 = 8.0;
const QUIET: f64 = 0.1;

/// Noise above this share of the radius makes walls look like corners within the radius.
const NOISY: f32 = 0.05;

/// Largest radius within which noise is asked for, in radii.
const MAX_NOISY: f32 = 5.0;

/// Newton's steps for an eigenvalue. About five are enough, unless two eigenvalues nearly coincide.
const MAX_STEPS: usize = 20;

/// Newton's steps end at a step of this share of the sum of the eigenvalues: the next would be below the precision of `f64`.
const NEAR: f64 = 1e-10;

/// The smallest eigenvalue is alone if its distances to the two others, as shares of the sum, have more than about this product.
const APART: f64 = 1e-3;

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
    /// Up to [`SAMPLES`] points of each cell.
    pub(super) samples: Vec<Point>,
    /// Means of the samples in each block of a scene, and their standard deviations across the plane through them.
    pub(super) blocks: Vec<Point>,
    pub(super) deviations: Vec<f32>,
    pub(super) is_scene: bool,
}

impl Anchors {
    /// The point nearest to the mean of each cubic cell of a cloud. The order of the points does not count. `place` maps a point to
    /// the frame of the cells. The indices of copies of other points are returned, too.
    ///
    /// # Errors
    /// [`crate::Error::Input`] for more points than [`u32::MAX`].
    pub(super) fn of(
        points: &[Point],
        side: f32,
        is_scene: bool,
        place: impl Fn(Point) -> Point,
    ) -> Result<(Self, HashSet<u32>)> {
        let cell = |point: &Point| place(*point).map(|v| floor(f64::from(v / side)));
        let cells = CellGroups::new(points.iter().map(cell))?;
        let mut anchors = Self { side, is_scene, ..Self::default() };
        let (mut sorted, mut copies) = (Vec::new(), HashSet::new());
        for (_, members) in cells.iter() {
            sorted.clear();
            sorted.extend(members.iter().map(|&index| (points[index as usize], index)));
            // By coordinates, so that the order of the points does not count.
            sorted.sort_unstable_by(|a, b| a.partial_cmp(b).unwrap_or(Ordering::Equal));
            let places = sorted.iter().map(|(point, _)| *point);
            let mean = places.clone().map(vector).sum::<Vector>() / sorted.len() as f64;
            let distance = |point: &Point| (vector(*point) - mean).norm_squared();
            anchors.points.extend(places.clone().min_by(|a, b| distance(a).total_cmp(&distance(b))));
            anchors.counts.push(members.len() as u32);
            anchors.samples.extend(places.step_by(members.len().div_ceil(SAMPLES)));
            copies.extend(sorted.windows(2).filter(|pair| pair[0].0 == pair[1].0).map(|pair| pair[1].1));
        }
        if is_scene {
            let blocks = CellGroups::new(anchors.samples.iter().map(|point| cell(point).map(|v| v.div_euclid(BLOCK))))?;
            for (_, members) in blocks.iter().filter(|(_, members)| members.len() >= MIN_SAMPLES) {
                let (mut sums, start) = (Sums::default(), vector(anchors.samples[members[0] as usize]));
                members.iter().for_each(|&index| sums.add(&(vector(anchors.samples[index as usize]) - start)));
                let (mean, covariance) = sums.moments();
                anchors.blocks.push((start + mean).map(|v| v as f32).into());
                anchors.deviations.push(eigen_of_plane(covariance).0[0].max(0.0).sqrt() as f32);
            }
        }
        Ok((anchors, copies))
    }
}

/// The patches at some points of a cloud, each computed when it is first needed.
pub(crate) struct Patches<'a> {
    points: RadiusCells<'a>,
    /// Points of scenes that show how noisy walls are.
    samples: RadiusCells<'a>,
    blocks: RadiusCells<'a>,
    deviations: &'a [f32],
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
            samples: RadiusCells::new(if anchors.is_scene { &anchors.samples } else { &[] }, radius)?,
            blocks: RadiusCells::new(&anchors.blocks, AROUND * radius)?,
            deviations: &anchors.deviations,
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

    /// The radius within which walls near a position do not look like corners, if the noise makes it larger than usual.
    /// The noise is that of the quietest blocks: bushes are as thick as noisy walls, but stand on ground.
    pub(super) fn noisy_radius(&self, at: &Point) -> Option<f32> {
        let mut near = Vec::new();
        self.blocks.within(at, AROUND * self.radius, |index| near.push(f64::from(self.deviations[index])));
        let radius = quantile((!near.is_empty()).then_some(near)?, QUIET) as f32 / NOISY;
        (radius > self.radius).then_some(radius.min(MAX_NOISY * self.radius))
    }

    /// Some points within a radius of a position, relative to it.
    pub(super) fn samples_near(&self, at: &Point, radius: f32) -> Vec<Vector> {
        let mut near = Vec::new();
        self.samples.within(at, radius, |index| near.push(vector(self.samples.points()[index]) - vector(*at)));
        near
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

    /// The mean and the covariance.
    fn moments(&self) -> (Vector, Matrix3<f64>) {
        let mean = self.offsets / self.count as f64;
        (mean, self.products / self.count as f64 - mean * mean.transpose())
    }

    /// The least-squares plane, for an anchor with `in_cell` points in its cell; `None` for few points, and for points on a line.
    pub(super) fn plane(&self, in_cell: f64) -> Option<Patch> {
        let count = self.count as f64;
        let (mean, covariance) = self.moments();
        let ([across, width, length], normal) = eigen_of_plane(covariance);
        let is_plane = self.count >= MIN_POINTS && width > MIN_WIDTH * length;
        let flatness = across.max(0.0) / width;
        let tilt = (flatness / count).sqrt();
        is_plane.then(|| Patch { mean, normal, tilt, flatness, own: (in_cell / count).min(1.0) })
    }
}

/// The eigenvalues of a covariance, ascending, and the eigenvector of the smallest one.
///
/// The smallest one is the first root of the characteristic polynomial, to which Newton's steps rise from 0. This takes a fourth of
/// the time of [`eigen`], which serves where the two smallest ones nearly coincide. The two largest ones are less
/// precise where they coincide: to a hundred-millionth.
fn eigen_of_plane(covariance: Matrix3<f64>) -> ([f64; 3], Vector) {
    let trace = covariance.trace();
    let matrix = covariance / trace;
    let (minors, determinant) = (0.5 * (1.0 - matrix.norm_squared()), matrix.determinant());
    let (mut least, mut step) = (0.0, f64::INFINITY);
    for _ in 0..MAX_STEPS {
        if step.abs() > NEAR {
            let value = ((1.0 - least) * least - minors) * least + determinant;
            step = value / ((2.0 - 3.0 * least) * least - minors);
            least -= step;
        }
    }
    // Two rows span the plane across the eigenvector.
    let [x, y, z] = [0, 1, 2].map(|axis| matrix.column(axis) - Vector::ith(axis, least));
    let across = [x.cross(&y), y.cross(&z), z.cross(&x)];
    let longest = across.into_iter().max_by(|a, b| a.norm_squared().total_cmp(&b.norm_squared())).unwrap_or_default();
    if longest.norm() > APART {
        let (half, product) = (0.5 * (1.0 - least), minors - least * (1.0 - least));
        let most = half + (half * half - product).max(0.0).sqrt();
        return ([least, product / most, most].map(|value| value * trace), longest.normalize());
    }
    eigen(covariance)
}

#[cfg(test)]
mod tests {
    use nalgebra::Rotation3;

    use super::*;

    #[test]
    fn eigenvalues_are_those_of_turned_diagonal_matrices() {
        let shapes = [[0.3, 0.9, 1.0], [0.0, 1.0, 1.0], [0.0, 0.01, 1.0], [1e-6, 0.8, 1.0], [0.0, 0.0, 1.0], [1.0; 3]];
        for (turn, shape) in (1..5).flat_map(|turn| shapes.map(|shape| (turn, shape))) {
            for scale in [1e-70, 1.0, 1e70] {
                let turn = Rotation3::from_scaled_axis(Vector::new(0.3, 0.7, -0.5) * f64::from(turn)).into_inner();
                let matrix = turn * Matrix3::from_diagonal(&shape.into()) * turn.transpose() * scale;
                let (values, normal) = eigen_of_plane(matrix);
                for (rank, error) in [1e-13, 1e-7, 1e-7].into_iter().enumerate() {
                    assert!((values[rank] / scale - shape[rank]).abs() < error, "{shape:?}: {values:?}");
                }
                let residual = (matrix * normal - normal * values[0]).norm() / scale;
                assert!((normal.norm() - 1.0).abs() < 1e-13 && residual < 1e-13, "{shape:?}: {residual}");
            }
        }
        assert_eq!(eigen_of_plane(Matrix3::zeros()).0, [0.0; 3]);
    }
}

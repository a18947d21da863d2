//! Finds the place of a cloud's sensor from its points.
//!
//! The rays of a sensor have about equal angles, so the number of its points per area of a surface is `k |cos| / r²`: it falls
//! with the squared distance r from the sensor and with the angle between ray and normal. A model is instead sampled evenly,
//! and merged or fused scans have the densities of several sensors. A place is the sensor's if it explains the densities much
//! better than even sampling does, and if its residuals are noise and not regions that another sensor also saw. Surfaces are
//! too coarse to give the exact place, so it is refined by counting rays in bundles of points that are neighbours in view.
//!
//! The beams of a LiDAR or a scanner rotate about an axis. Neighbours of one beam have the same elevation, which tells the place
//! to centimetres, however few the beams are.
//!
//! The frame's origin is taken if the densities lead to it. It is also taken, as the place of a camera whose images were fused, if
//! the densities do not tell, the cloud lies along its z axis, and most of the cloud is in view.

use std::collections::HashMap;
use std::f64::consts::SQRT_2;
use std::num::NonZeroUsize;
use std::ops::Range;

use nalgebra::{Matrix3, SMatrix, SVector, SymmetricEigen};
use serde::{Deserialize, Serialize};

use crate::{Neighbors, Point, Vector, eigen, vector};

/// Maximum number of points among which neighbours are searched. With fewer, neighbourhoods are wider than furniture.
const MAX_POINTS: usize = 16_384;
/// Maximum number of densities.
const MAX_DENSITIES: usize = 1500;
/// Minimum number of densities; fewer do not tell anything.
const MIN_DENSITIES: usize = 100;
/// Number of nearest points for a density and a normal.
const NEIGHBORS: NonZeroUsize = NonZeroUsize::new(16).unwrap();
/// Largest ratio of the variance across a neighbourhood to the smaller variance along it.
const MAX_THICKNESS: f64 = 0.1;
/// Smallest ratio of the two variances along a neighbourhood; a single beam has less.
const MIN_WIDTH: f64 = 0.1;
/// Residuals of log densities up to about this count fully. In random samples they have a standard deviation of 0.25.
const SCALE: f64 = 0.35;
/// Cosines below this are smoothed, because a ray along a surface hits its roughness.
const MIN_COSINE: f64 = 0.03;
/// A neighbourhood is parallel to a plane if the cosine of their normals is above this.
const PARALLEL: f64 = 0.95;
/// Number of places along each axis of the grid at which the search starts.
const PLACES: i32 = 9;
/// The grid extends to this many times the median distance of the points from their middle.
const REACH: f64 = 2.0;
/// Number of densities for comparing the places of the grid.
const FEW_DENSITIES: usize = 200;
/// Number of places of the grid that are refined.
const STARTS: usize = 5;
/// Largest ratio of the costs with and without pixels. Cameras have 0.06, others 0.8.
const LATTICE_COST: f64 = 0.6;
/// Maximum number of bundles of rays that refine the place, and number of rays in each.
const MAX_BUNDLES: usize = 700;
const RAYS: NonZeroUsize = NonZeroUsize::new(16).unwrap();
/// Upper limit of the cost of bundles. Those of scanners and cameras have up to 0.17, those of single beams 0.22 and more.
const MAX_BUNDLE_COST: f64 = 0.2;
/// Side of a part of the view, in radians, and number of nearest points to which steps are made, with the point itself.
const PART: f64 = 0.06;
const STEPS: NonZeroUsize = NonZeroUsize::new(3).unwrap();
/// Steps at an angle to a beam up to about this sine count fully.
const MAX_SINE: f64 = 0.15;
/// Steps along beams are below these sines, steps between beams above. Largest share of the others: of sweeps 0 to 0.13, of merged
/// ones 0.15 and more.
const OBLIQUE: Range<f64> = 0.26..0.97;
const MAX_OBLIQUE: f64 = 0.14;
/// Largest standard deviation of the place of beams, relative to the cloud's radius: sweeps have up to 0.014, images, for whose
/// rows it is any place, 0.04 and more.
const MAX_DEVIATION: f64 = 0.015;
/// Beams are the sensor's where it explains the densities and the view at least so well.
const MAX_UNEXPLAINED_BY_BEAMS: f64 = 0.8;
const MIN_VISIBLE: f64 = 0.62;
/// Rays at a smaller cosine to the normal graze the surface.
const GRAZING: f64 = 0.3;
/// Number of times that bundles are formed.
const ROUNDS: usize = 3;
/// Maximum number of steps of a search, and of one round.
const MAX_STEPS: usize = 20;
const FEW_STEPS: usize = 5;
/// Largest unexplained share with a sensor: of the cost of even sampling, and of that plus the share of hidden points.
/// Synthetic scans have up to 0.47, merged scans and models 0.53 and more.
const MAX_UNEXPLAINED: f64 = 0.5;
/// A place this close to the frame's origin is the origin. Unit: median distances of the points from the origin, or from their
/// middle for a place of beams.
const AT_ORIGIN: f64 = 0.15;
const AT_ORIGIN_BY_BEAMS: f64 = 0.01;
/// Largest excess of residuals on surfaces, relative to the differences between neighbours; and largest product of it and the
/// excess in view. Merged scans, whose parts were seen by one sensor or by two, have 1.4 and 1.62 and more. The last value is
/// added to each cost.
const MAX_EXCESS: f64 = 1.4;
const MAX_EXCESS_IN_VIEW: f64 = 1.6;
const EXCESS_NOISE: f64 = 0.05;
/// Added to the cost of a fit, because that of a perfect lattice is near 0.
const MIN_NOISE: f64 = 0.02;
/// Neighbours of this rank among the densities share few points with each other.
const APART: NonZeroUsize = NonZeroUsize::new(5).unwrap();
/// Side of a pixel for visibility, as the tangent of an angle, for a sensor within the cloud.
const PIXEL: f64 = 0.05;
/// All points lie ahead of a camera, which looks along the z axis of its frame: the mean of the unit vectors to them has more of it.
/// Fused images have 0.84 and more.
const MIN_AHEAD: f64 = 0.75;
/// Nor are they far away: the median point is at most this many median distances from the camera. Fused images have 1.9 to 4.
const MAX_AWAY: f64 = 4.5;
/// Smallest visible share of fused images; the camera moved, so it does not see all. They have 0.59 and more. Merged scans, seen
/// from a corner of their room, have 0.52 and less.
const MIN_FUSED: f64 = 0.56;
/// No plane is closer than the points at this quantile of the inverse distance.
const NEAREST: f64 = 0.95;

/// The place of a cloud's sensor.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Sensor {
    /// The position, in the cloud's frame and units.
    pub position: [f64; 3],
    /// Share of the points, 0 to 1, that nothing hides from the sensor.
    pub visible: f64,
}

impl Sensor {
    /// Finds the sensor of a cloud that was seen from one place. Returns `None` for models, merged scans and undecided cases.
    /// Points that are not finite do not count.
    pub fn find(all: &[Point]) -> Option<Self> {
        let points = sample(all);
        if points.len() < MIN_DENSITIES {
            return None;
        }
        let cloud = Neighbors::new(points).ok()?;
        let densities = Density::measure(&cloud);
        if densities.len() < MIN_DENSITIES {
            return None;
        }
        let best = search(&densities, &cloud.points).above(&densities, &cloud.points);
        let unexplained = (best.cost + MIN_NOISE) / cost_of_even(&densities);
        let has_beams = unexplained < MAX_UNEXPLAINED_BY_BEAMS;
        if let Some(place) = has_beams.then(|| best.by_beams(&axes(&densities), all, &cloud.points)).flatten() {
            return Some(Self { position: place.into(), visible: visible_share(&cloud.points, &place) });
        }
        if unexplained > MAX_UNEXPLAINED {
            return Self::before_fused(&cloud.points);
        }
        let distance = median(cloud.points.iter().map(Vector::norm).collect());
        let is_origin = best.place.norm() < AT_ORIGIN * distance;
        let in_view = if is_origin { None } else { best.by_bundles(&cloud.points, &densities) };
        let place = if is_origin { Vector::zeros() } else { in_view.map_or(best.place, |(fit, _)| fit.place) };
        let visible = visible_share(&cloud.points, &place);
        if unexplained + 1.0 - visible > MAX_UNEXPLAINED {
            return None;
        }
        let on_surfaces = densities.iter().map(|density| (density.point, best.residual(&density))).collect();
        let on_surfaces = excess(on_surfaces, &best.place)?;
        let in_view = on_surfaces * in_view.map_or(1.0, |(_, excess)| excess);
        (on_surfaces <= MAX_EXCESS && in_view <= MAX_EXCESS_IN_VIEW).then(|| Self { position: place.into(), visible })
    }

    /// The frame's origin, if a camera there may have taken the fused images, whose densities do not tell.
    fn before_fused(points: &[Vector]) -> Option<Self> {
        let ahead = points.iter().filter_map(|point| point.try_normalize(0.0)).sum::<Vector>() / points.len() as f64;
        let (center, radius) = middle(points);
        let visible = visible_share(points, &Vector::zeros());
        let is_near = ahead.z.abs() > MIN_AHEAD && center.norm() < MAX_AWAY * radius;
        (is_near && visible > MIN_FUSED).then_some(Self { position: [0.0; 3], visible })
    }

    /// A sensor whose position is known.
    pub fn at(position: [f64; 3], points: &[Point]) -> Self {
        let points = sample(points);
        let visible = if points.is_empty() { 0.0 } else { visible_share(&points, &position.into()) };
        Self { position, visible }
    }
}

/// One finite point of each of [`MAX_POINTS`] stretches of the cloud, at a random place in it. A fixed step would take the same
/// columns in each row of a scan.
fn sample(points: &[Point]) -> Vec<Vector> {
    let step = points.len().div_ceil(MAX_POINTS).max(1);
    let random = |(index, stretch): (usize, &[Point])| vector(stretch[mixed(index as u64) as usize % stretch.len()]);
    let finite = |point: &Vector| point.iter().all(|v| v.is_finite());
    points.chunks(step).enumerate().map(random).filter(finite).collect()
}

/// A random number for a number: SplitMix64 by Steele, Lea and Flood.
fn mixed(number: u64) -> u64 {
    let mixed = number.wrapping_mul(0x9E37_79B9_7F4A_7C15);
    let mixed = (mixed ^ mixed >> 30).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    let mixed = (mixed ^ mixed >> 27).wrapping_mul(0x94D0_49BB_1331_11EB);
    mixed ^ mixed >> 31
}

/// A planar neighbourhood.
struct Density {
    point: Vector,
    normal: Vector,
    /// The logarithm of the number of points per area, up to a constant.
    log: f64,
}

impl Density {
    fn measure(cloud: &Neighbors) -> Vec<Self> {
        let measured = |point: &Vector| {
            let near: Vec<usize> = cloud.nearest(point, NEIGHBORS).into_iter().map(|(index, _)| index).collect();
            let ([across, width, length], normal) = eigen(cloud.covariance(&near));
            let is_planar = across < MAX_THICKNESS * width && width > MIN_WIDTH * length;
            is_planar.then(|| Self { point: *point, normal, log: -0.5 * (width * length).ln() })
        };
        let step = cloud.points.len().div_ceil(MAX_DENSITIES);
        cloud.points.iter().step_by(step).filter_map(measured).collect()
    }
}

/// Points that lie close together.
trait Patch {
    /// The logarithm of the number of rays per solid angle, or per cell of a lattice, that a sensor at a place would have
    /// here, and its gradients with respect to the place and the lattice's axis.
    fn density(&self, place: &Vector, lattice: Lattice, axis: &Vector) -> (f64, Vector, Vector);
}

impl Patch for &Density {
    fn density(&self, place: &Vector, lattice: Lattice, axis: &Vector) -> (f64, Vector, Vector) {
        let offset = self.point - place;
        let distance = offset.norm().max(f64::MIN_POSITIVE);
        let ray = offset / distance;
        let cosine = ray.dot(&self.normal);
        let smooth = cosine * cosine + MIN_COSINE * MIN_COSINE;
        let log = self.log + 2.0 * distance.ln() - 0.5 * smooth.ln();
        let slope = cosine / smooth * (self.normal - cosine * ray) - 2.0 * ray;
        let height = ray.dot(axis);
        let (cell, by_height) = lattice.cell(height);
        let by_place = (slope - by_height * (axis - height * ray)) / distance;
        (log + cell, by_place, by_height * (ray - height * axis))
    }
}

/// Points that are neighbours as seen from the sensor, on any surface.
struct Bundle(Vec<Vector>);

impl Bundle {
    /// The bundles of a cloud as seen from a place, around neighbourhoods that the rays do not graze: many of those rays are lost.
    fn seen(points: &[Vector], densities: &[Density], place: &Vector) -> Option<Vec<Self>> {
        let direction = |point: &Vector| (point - place).try_normalize(f64::MIN_POSITIVE).unwrap_or(Vector::z());
        let directions = Neighbors::new(points.iter().map(direction).collect()).ok()?;
        let bundle = |at: &Vector| directions.nearest(at, RAYS).into_iter().map(|(index, _)| points[index]).collect();
        let is_grazed = |density: &&Density| direction(&density.point).dot(&density.normal).abs() < GRAZING;
        let seen: Vec<&Density> = densities.iter().filter(|density| !is_grazed(density)).collect();
        let seen = seen.iter().step_by(seen.len().div_ceil(MAX_BUNDLES).max(1));
        Some(seen.map(|density| Self(bundle(&direction(&density.point)))).collect())
    }

    /// The directions and inverse distances of the points from a place, and the mean direction.
    fn directions(&self, place: &Vector) -> (Vec<(Vector, f64)>, Vector) {
        let offsets = self.0.iter().map(|point| (point - place, (point - place).norm().max(f64::MIN_POSITIVE).recip()));
        let rays: Vec<_> = offsets.map(|(offset, nearness)| (nearness * offset, nearness)).collect();
        let mean = rays.iter().map(|(ray, _)| ray).sum::<Vector>() / rays.len() as f64;
        (rays, mean)
    }
}

impl Patch for Bundle {
    fn density(&self, place: &Vector, lattice: Lattice, axis: &Vector) -> (f64, Vector, Vector) {
        let (rays, mean) = self.directions(place);
        let (count, middle) = (rays.len() as f64, mean.try_normalize(f64::MIN_POSITIVE).unwrap_or(*axis));
        let across = |ray: &Vector| ray - mean - middle.dot(&(ray - mean)) * middle;
        // The determinant is that of the spread perpendicular to the middle ray.
        let mut spread = middle * middle.transpose();
        for (ray, _) in &rays {
            let across = across(ray);
            spread += across * across.transpose() / count;
        }
        let inverse = spread.try_inverse().unwrap_or_default();
        let (mut by_place, mut mean_nearness) = (Vector::zeros(), 0.0);
        for (ray, nearness) in &rays {
            let pull = inverse * across(ray);
            by_place += nearness / count * (pull - ray.dot(&pull) * ray);
            mean_nearness += nearness / count;
        }
        let height = middle.dot(axis);
        let (cell, by_height) = lattice.cell(height);
        let log = cell - 0.5 * spread.determinant().max(f64::MIN_POSITIVE).ln();
        let by_place = by_place - by_height * mean_nearness * (axis - height * middle);
        (log, by_place, by_height * (middle - height * axis))
    }
}

/// A step between neighbours in view. Points of a beam that rotates about the axis have one elevation, however far away they are.
struct Step {
    middle: Vector,
    along: Vector,
}

impl Step {
    /// Steps to the nearest others, in parts of the view from a place that keep all of their points.
    fn seen(points: &[Point], place: &Vector) -> Option<Vec<Self>> {
        let most = u64::MAX / points.len().div_ceil(MAX_POINTS) as u64;
        let is_in_part = |point: &Vector| {
            let cell = (point - place).try_normalize(0.0).unwrap_or_default().map(|v| (v / PART).floor() as i64 as u64);
            mixed(mixed(mixed(cell[0]) ^ cell[1]) ^ cell[2]) <= most
        };
        let is_finite = |point: &Vector| point.iter().all(|v| v.is_finite());
        let kept = points.iter().map(|point| vector(*point)).filter(|point| is_finite(point) && is_in_part(point));
        let cloud = Neighbors::new(kept.collect()).ok()?;
        let step =
            |from: &Vector, to: usize| Self { middle: 0.5 * (from + cloud.points[to]), along: cloud.points[to] - from };
        let steps = cloud.points.iter().step_by(cloud.points.len().div_ceil(MAX_DENSITIES).max(1)).flat_map(|from| {
            let others = cloud.nearest(from, STEPS).into_iter().filter(|(_, distance)| *distance > 0.0);
            others.map(|(to, _)| step(from, to)).collect::<Vec<_>>()
        });
        Some(steps.collect())
    }
}

impl Patch for Step {
    /// In place of a density, the sine of the angle between the step and the circle of its elevation about the axis, over
    /// [`MAX_SINE`].
    fn density(&self, place: &Vector, _: Lattice, axis: &Vector) -> (f64, Vector, Vector) {
        let offset = self.middle - place;
        let distance = offset.norm().max(f64::MIN_POSITIVE);
        let ray = offset / distance;
        let [up, along] = [axis, &self.along].map(|of| of - of.dot(&ray) * ray);
        let scale = SCALE / MAX_SINE / (along.norm() * up.norm()).max(f64::MIN_POSITIVE);
        let by_place = (axis.dot(&ray) * along + self.along.dot(&ray) * up) / distance;
        (scale * along.dot(&up), scale * by_place, scale * (along - along.dot(axis) * axis))
    }
}

/// How the rays of a sensor are arranged about its axis.
#[derive(Clone, Copy)]
enum Lattice {
    /// Equal angles in all directions.
    None,
    /// The pixels of an image perpendicular to the axis.
    Image,
}

impl Lattice {
    /// The logarithm of a cell's solid angle at this cosine to the axis, and its derivative.
    fn cell(self, height: f64) -> (f64, f64) {
        match self {
            Self::None => (0.0, 0.0),
            Self::Image => {
                let height = height.max(MIN_COSINE);
                (3.0 * height.ln(), 3.0 / height)
            }
        }
    }
}

/// The robust cost of a residual, 0 to 1, and its weight in least squares (Geman and McClure).
fn robust(residual: f64) -> (f64, f64) {
    let squared = (residual / (2.0 * SCALE)).powi(2);
    (squared / (1.0 + squared), (1.0 + squared).powi(-2))
}

fn mean_cost(residuals: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = residuals.len() as f64;
    residuals.fold(0.0, |sum, residual| sum + robust(residual).0) / count
}

fn median(mut values: Vec<f64>) -> f64 {
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// The median of the points, and their median distance from it.
fn middle(points: &[Vector]) -> (Vector, f64) {
    let center = Vector::from_fn(|axis, _| median(points.iter().map(|point| point[axis]).collect()));
    (center, median(points.iter().map(|point| (point - center).norm()).collect()))
}

/// The cost of the hypothesis that the points are spread evenly over the surfaces.
fn cost_of_even(densities: &[Density]) -> f64 {
    let usual = median(densities.iter().map(|density| density.log).collect());
    mean_cost(densities.iter().map(|density| density.log - usual))
}

/// A hypothesis about the sensor.
#[derive(Clone, Copy)]
struct Fit {
    place: Vector,
    lattice: Lattice,
    axis: Vector,
    /// The logarithm of the number of rays per solid angle or cell.
    log: f64,
    cost: f64,
}

impl Fit {
    fn at(patches: &[impl Patch], place: Vector, lattice: Lattice, axis: Vector) -> Self {
        let rays: Vec<f64> = patches.iter().map(|patch| patch.density(&place, lattice, &axis).0).collect();
        let log = median(rays.clone());
        Self { place, lattice, axis, log, cost: mean_cost(rays.iter().map(|rays| rays - log)) }
    }

    fn residual(&self, patch: &impl Patch) -> f64 {
        patch.density(&self.place, self.lattice, &self.axis).0 - self.log
    }

    /// This fit, or the one near its mirror image in the plane that faces most densities, such as the ground: the plane has the
    /// same densities for both, but only the right one sees what stands on the plane.
    fn above(self, densities: &[Density], points: &[Vector]) -> Self {
        let [normal, ..] = axes(densities);
        let on_it = densities.iter().filter(|density| density.normal.dot(&normal).abs() > PARALLEL);
        let heights = on_it.map(|density| density.point.dot(&normal)).chain([self.place.dot(&normal)]);
        let place = self.place + 2.0 * (median(heights.collect()) - self.place.dot(&normal)) * normal;
        let few: Vec<&Density> = densities.iter().step_by(densities.len().div_ceil(FEW_DENSITIES)).collect();
        let near = Self::at(&few, place, self.lattice, self.axis).improved(&few, MAX_STEPS);
        let unexplained = |fit: &Self| fit.cost / cost_of_even(densities) - visible_share(points, &fit.place);
        if unexplained(&near) > unexplained(&self) {
            return self;
        }
        let all: Vec<&Density> = densities.iter().collect();
        Self::at(&all, near.place, near.lattice, near.axis).improved(&all, MAX_STEPS)
    }

    /// The best fit near this one to the bundles that are seen from there, and its excess; `None` if the bundles are rays of
    /// single beams, which have no width.
    fn by_bundles(mut self, points: &[Vector], densities: &[Density]) -> Option<(Self, f64)> {
        let mut bundles = Vec::new();
        for _ in 0..ROUNDS {
            bundles = Bundle::seen(points, densities, &self.place).filter(|bundles| bundles.len() >= MIN_DENSITIES)?;
            self = Self::at(&bundles, self.place, self.lattice, self.axis).improved(&bundles, FEW_STEPS);
        }
        let rays = |bundle: &Bundle| (bundle.directions(&self.place).1, self.residual(bundle));
        let left = excess(bundles.iter().map(rays).collect(), &Vector::zeros())?;
        (self.cost < MAX_BUNDLE_COST).then_some((self, left))
    }

    /// The place of the sensor of whose rotating beams the points consist, if they show it.
    fn by_beams(&self, axes: &[Vector], all: &[Point], points: &[Vector]) -> Option<Vector> {
        let steps = Step::seen(all, &self.place).filter(|steps| steps.len() >= MIN_DENSITIES)?;
        let fit = |axis: &Vector| Self::at(&steps, self.place, Lattice::None, *axis).improved(&steps, MAX_STEPS);
        let fit = axes.iter().map(fit).min_by(|a, b| a.cost.total_cmp(&b.cost))?;
        let (_, radius) = middle(points);
        let sine = |step: &Step| (fit.residual(step) * MAX_SINE / SCALE).abs();
        let oblique = steps.iter().filter(|step| OBLIQUE.contains(&sine(step))).count();
        let is_sensor = (oblique as f64) < MAX_OBLIQUE * steps.len() as f64
            && fit.deviation(&steps) < MAX_DEVIATION * radius
            && visible_share(points, &fit.place) > MIN_VISIBLE;
        let is_origin = fit.place.norm() < AT_ORIGIN_BY_BEAMS * radius;
        is_sensor.then_some(if is_origin { Vector::zeros() } else { fit.place })
    }

    /// The largest standard deviation of the place along any direction.
    fn deviation(&self, patches: &[impl Patch]) -> f64 {
        let (squares, _) = self.normal_equations(patches);
        let weights = patches.iter().map(|patch| (self.residual(patch), robust(self.residual(patch)).1));
        let [sum, weight] =
            weights.fold([0.0; 2], |[sum, all], (residual, weight)| [sum + weight * residual * residual, all + weight]);
        let covariance =
            squares.try_inverse().unwrap_or_else(|| SMatrix::repeat(f64::INFINITY)).fixed_view::<3, 3>(0, 0)
                * (sum / weight);
        covariance.symmetric_eigenvalues().max().sqrt()
    }

    /// The weighted squares and the gradient of the residuals.
    fn normal_equations(&self, patches: &[impl Patch]) -> (SMatrix<f64, 7, 7>, SVector<f64, 7>) {
        let (mut squares, mut gradient) = (SMatrix::identity() * 1e-9, SVector::zeros());
        for patch in patches {
            let (rays, by_place, by_axis) = patch.density(&self.place, self.lattice, &self.axis);
            let row: SVector<f64, 7> = SVector::from_iterator(by_place.iter().chain(&by_axis).copied().chain([-1.0]));
            let weight = robust(rays - self.log).1;
            squares += weight * row * row.transpose();
            gradient += weight * (rays - self.log) * row;
        }
        (squares, gradient)
    }

    /// The best fit near this one, by the Levenberg–Marquardt method.
    fn improved(&self, patches: &[impl Patch], max_steps: usize) -> Self {
        let (mut best, mut damping) = (*self, 1e-3);
        for _ in 0..max_steps {
            let (squares, gradient) = best.normal_equations(patches);
            let before = best.cost;
            while best.cost == before && damping < 1e6 {
                let damped = squares + SMatrix::from_diagonal(&(damping * squares.diagonal()));
                let step = damped.cholesky().map(|factors| factors.solve(&-gradient)).unwrap_or_default();
                let axis = (best.axis + step.fixed_rows::<3>(3)).normalize();
                let next = Self { place: best.place + step.fixed_rows::<3>(0), axis, log: best.log + step[6], ..best };
                let cost = mean_cost(patches.iter().map(|patch| next.residual(patch)));
                if cost < before {
                    best = Self { cost, ..next };
                }
                damping *= if cost < before { 0.1 } else { 10.0 };
            }
            if before - best.cost < 1e-6 {
                break;
            }
        }
        best
    }
}

/// The best place. The search starts from a grid around the cloud with some densities and ends with all.
fn search(densities: &[Density], points: &[Vector]) -> Fit {
    let (center, radius) = middle(points);
    let reach = REACH * radius;
    let all: Vec<&Density> = densities.iter().collect();
    let few: Vec<&Density> = all.iter().step_by(all.len().div_ceil(FEW_DENSITIES)).copied().collect();
    let offset = |at: i32| reach * f64::from(2 * (at % PLACES) - (PLACES - 1)) / f64::from(PLACES - 1);
    let place = |at: i32| center + Vector::new(offset(at), offset(at / PLACES), offset(at / PLACES / PLACES));
    let by_cost = |a: &Fit, b: &Fit| a.cost.total_cmp(&b.cost);
    let start = |at| Fit::at(&few, place(at), Lattice::None, Vector::z());
    let mut starts: Vec<Fit> = (0..PLACES.pow(3)).map(start).collect();
    starts.sort_by(by_cost);
    let fits = starts[..STARTS].iter().map(|start| start.improved(&few, MAX_STEPS));
    let best = fits.min_by(by_cost).unwrap_or(starts[0]);
    let ahead = (center - best.place).normalize();
    let image = Fit::at(&few, best.place, Lattice::Image, ahead).improved(&few, MAX_STEPS);
    let best = if image.cost < LATTICE_COST * best.cost { image } else { best };
    Fit::at(&all, best.place, best.lattice, best.axis).improved(&all, MAX_STEPS)
}

/// The principal axes of the normals; most densities face the first.
fn axes(densities: &[Density]) -> [Vector; 3] {
    let normals: Matrix3<f64> = densities.iter().map(|density| density.normal * density.normal.transpose()).sum();
    let SymmetricEigen { eigenvalues, eigenvectors } = SymmetricEigen::new(normals);
    let mut order = [0, 1, 2];
    order.sort_by(|&a, &b| eigenvalues[b].total_cmp(&eigenvalues[a]));
    order.map(|axis| eigenvectors.column(axis).into())
}

/// The residuals of a fit relative to the differences between neighbours. A smooth change with the direction does not count: a
/// LiDAR has more rays per solid angle at some elevations.
fn excess(patches: Vec<(Vector, f64)>, place: &Vector) -> Option<f64> {
    let (points, mut residuals): (Vec<Vector>, Vec<f64>) = patches.into_iter().unzip();
    let near = Neighbors::new(points).ok()?;
    let directions: Vec<_> = near.points.iter().map(|point| smooth_functions(&(point - place))).collect();
    for _ in 0..4 {
        let (mut squares, mut sums) = (SMatrix::<f64, 10, 10>::identity() * 1e-3, SVector::<f64, 10>::zeros());
        for (row, residual) in directions.iter().zip(&residuals) {
            let weight = robust(*residual).1;
            squares += weight * row * row.transpose();
            sums += weight * *residual * row;
        }
        let change = squares.cholesky()?.solve(&sums);
        residuals.iter_mut().zip(&directions).for_each(|(residual, row)| *residual -= change.dot(row));
    }
    let neighbor = |point: &Vector| near.nearest(point, APART).last().map_or(0, |(index, _)| *index);
    let differences = near.points.iter().zip(&residuals);
    let differences = differences.map(|(point, residual)| (residual - residuals[neighbor(point)]) / SQRT_2);
    Some((mean_cost(residuals.iter().copied()) + EXCESS_NOISE) / (mean_cost(differences) + EXCESS_NOISE))
}

/// The monomials of a direction up to degree 2: a basis of smooth functions.
fn smooth_functions(direction: &Vector) -> SVector<f64, 10> {
    let [x, y, z] = (direction / direction.norm().max(f64::MIN_POSITIVE)).into();
    SVector::from([1.0, x, y, z, x * x, y * y, z * z, x * y, y * z, z * x])
}

/// The share of the points that no other point hides from a place, in pixels on the faces of a cube around it.
fn visible_share(points: &[Vector], place: &Vector) -> f64 {
    let center = points.iter().sum::<Vector>() / points.len() as f64;
    let radius = points.iter().map(|point| (point - center).norm()).fold(0.0, f64::max);
    // A cloud that is seen from afar appears small, so its pixels are smaller.
    let side = PIXEL * (radius / (center - place).norm().max(f64::MIN_POSITIVE)).min(1.0);
    let pixel = |point: &Vector| {
        let offset = point - place;
        let face = offset.iamax();
        let depth = offset[face].abs().max(f64::MIN_POSITIVE);
        let at = |axis: usize| (offset[(face + axis) % 3] / depth / side).floor() as i64;
        (face, offset[face] < 0.0, at(1), at(2))
    };
    let nearness = |point: &Vector| (point - place).norm().max(f64::MIN_POSITIVE).recip();
    let seen: Vec<_> = points.iter().map(|point| (pixel(point), nearness(point))).collect();
    let mut nearest = HashMap::with_capacity(points.len());
    for (pixel, nearness) in &seen {
        nearest.entry(pixel).and_modify(|most: &mut f64| *most = nearness.max(*most)).or_insert(*nearness);
    }
    // Within a pixel, the inverse distance of a plane varies by the pixel's side divided by the plane's distance.
    let mut sorted: Vec<f64> = seen.iter().map(|(_, nearness)| *nearness).collect();
    let at = (NEAREST * (sorted.len() - 1) as f64) as usize;
    let tolerance = side * *sorted.select_nth_unstable_by(at, f64::total_cmp).1;
    let visible = seen.iter().filter(|(pixel, nearness)| *nearness >= nearest[pixel] - tolerance);
    visible.count() as f64 / points.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    const EYES: [[f64; 3]; 2] = [[2.0, 1.5, 1.4], [4.5, 3.0, 1.2]];
    const SITE: Vector = Vector::new(30.0, -20.0, 5.0);

    /// What a scanner sees of a room of 6 x 4.5 x 2.6 m, in site coordinates.
    fn scan(eye: [f64; 3]) -> Vec<Point> {
        let seen = |index: u32| {
            let (elevation, azimuth) = (f64::from(index / 300) * 0.02 - 1.0, f64::from(index % 300) * 0.020_944);
            let ray = [elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin()];
            let wall =
                |axis: usize| (if ray[axis] > 0.0 { [6.0, 4.5, 2.6][axis] } else { 0.0 } - eye[axis]) / ray[axis];
            let range = (0..3).map(wall).fold(f64::INFINITY, f64::min);
            (SITE + Vector::from(eye) + range * Vector::from(ray)).map(|v| v as f32).into()
        };
        (0..300 * 100).map(seen).collect()
    }

    #[test]
    fn the_sensor_of_a_scan_is_found_in_any_frame_and_that_of_merged_scans_is_not() {
        for eye in EYES {
            let sensor = Sensor::find(&scan(eye)).unwrap();
            let off = Vector::from(sensor.position) - Vector::from(eye) - SITE;
            assert!(off.norm() < 0.03 && sensor.visible > 0.95, "{sensor:?}");
        }
        assert_eq!(Sensor::find(&EYES.map(scan).concat()), None);
    }

    #[test]
    fn few_beams_tell_where_they_rotate() {
        let sweep = |eye| scan(eye).chunks(300).step_by(6).flatten().copied().collect::<Vec<Point>>();
        let sensor = Sensor::find(&sweep(EYES[0])).unwrap();
        let off = Vector::from(sensor.position) - Vector::from(EYES[0]) - SITE;
        assert!(off.norm() < 1e-3, "{sensor:?}");
        assert_eq!(Sensor::find(&EYES.map(sweep).concat()), None);
    }

    #[test]
    fn a_sensor_stands_on_the_side_of_the_ground_from_which_it_sees_the_walls() {
        let is_open = |point: &Point| point[2] < 5.01 || (point[1] > -15.51 || point[0] > 35.99) && point[2] < 5.6;
        let open: Vec<Point> = scan(EYES[0]).into_iter().filter(is_open).collect();
        let off = Vector::from(Sensor::find(&open).unwrap().position) - Vector::from(EYES[0]) - SITE;
        assert!(off.norm() < 0.1, "{off:?}");
    }

    #[test]
    fn what_is_sampled_evenly_has_no_sensor_even_about_the_origin() {
        let unit = |index: usize, step: f64| (index as f64 * step).fract() as f32 - 0.5;
        let cube = |index: usize| {
            let mut point = [unit(index, 0.618_034), unit(index, 0.754_878), unit(index, 0.569_840)];
            point[index % 3] = point[index % 3].signum();
            point
        };
        let ball = |index: usize| {
            let (z, angle) = (2.0 * unit(index, 0.754_878), std::f32::consts::TAU * unit(index, 0.618_034));
            let ring = (1.0 - z * z).sqrt();
            [ring * angle.cos(), ring * angle.sin(), z]
        };
        let [cube, ball]: [Vec<Point>; 2] = [(0..20_000).map(cube).collect(), (0..20_000).map(ball).collect()];
        for points in [&cube[..], &ball, &[], &[[1.0; 3]; 500], &[[f32::NAN; 3]; 500]] {
            assert_eq!(Sensor::find(points), None);
        }
    }
}

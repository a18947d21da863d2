//! Finds the place of a cloud's sensor from its points.
//!
//! The rays of a sensor have about equal angles, so the number of its points per area of a surface is `k |cos| / r²`: it falls
//! with the squared distance r from the sensor and with the angle between ray and normal. A model is instead sampled evenly,
//! and merged or fused scans have the densities of several sensors. A place is the sensor's if it explains the densities much
//! better than even sampling does, and if its residuals are noise and not regions that another sensor also saw. Surfaces are
//! too coarse to give the exact place, so it is refined by counting rays in bundles of points that are neighbours in view. The
//! frame's origin is taken if the densities lead to it. It is also taken, as the place of a camera whose images were fused, if
//! the densities do not tell, the cloud lies ahead of it, and most of the cloud is in view.

use std::collections::HashMap;
use std::f64::consts::SQRT_2;
use std::num::NonZeroUsize;

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
/// Largest ratio of the costs with and without a lattice of rays. Scanners have 0.4 and less, cameras 0.06, others 0.8.
const LATTICE_COST: f64 = 0.6;
/// The same ratio of the costs of bundles. Tripods on open ground have 0.64.
const BUNDLES_COST: f64 = 0.8;
/// Maximum number of bundles of rays that refine the place, and number of rays in each.
const MAX_BUNDLES: usize = 700;
const RAYS: NonZeroUsize = NonZeroUsize::new(16).unwrap();
/// Upper limit of the cost of bundles. Those of scanners and cameras have up to 0.17, those of single beams 0.22 and more.
const MAX_BUNDLE_COST: f64 = 0.2;
/// Number of times that bundles are formed.
const ROUNDS: usize = 3;
/// Maximum number of steps of a search, and of one round.
const MAX_STEPS: usize = 20;
const FEW_STEPS: usize = 5;
/// Largest unexplained share with a sensor: of the cost of even sampling, and of that plus the share of hidden points.
/// Synthetic scans have up to 0.47, merged scans and models 0.53 and more.
const MAX_UNEXPLAINED: f64 = 0.5;
/// A place this close to the frame's origin is the origin. Unit: median distances of the points from the origin.
const AT_ORIGIN: f64 = 0.15;
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
/// All points lie ahead of a camera: the mean of the unit vectors to them is longer than this. Fused images have 0.89 and more,
/// sectors of 140 degrees 0.77. A model around its origin has 0 to 0.1; one beside it, 0.6 to 0.94, is not told apart.
const MIN_AHEAD: f64 = 0.5;
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
    pub fn find(points: &[Point]) -> Option<Self> {
        let points = sample(points);
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
        if unexplained > MAX_UNEXPLAINED {
            return Self::before_fused(&cloud.points);
        }
        let distance = median(cloud.points.iter().map(Vector::norm).collect());
        let is_origin = best.place.norm() < AT_ORIGIN * distance;
        // Few densities do not show a lattice that many rays show.
        let turning = Fit { lattice: Lattice::Turning, axis: axes(&densities)[0], ..best };
        let by_bundles = |fit: Fit| if is_origin { None } else { fit.by_bundles(&cloud.points) };
        let turning = (best.lattice == Lattice::None).then_some(turning).and_then(by_bundles);
        let in_view = by_bundles(best);
        let is_turning = |(fit, _): &(Fit, f64)| in_view.is_none_or(|(none, _)| fit.cost < BUNDLES_COST * none.cost);
        let in_view = turning.filter(is_turning).or(in_view);
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
        let is_near = ahead.norm() > MIN_AHEAD && center.norm() < MAX_AWAY * radius;
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
    let random = |(index, stretch): (usize, &[Point])| {
        // SplitMix64 by Steele, Lea and Flood.
        let mixed = (index as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        let mixed = (mixed ^ mixed >> 30).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let mixed = (mixed ^ mixed >> 27).wrapping_mul(0x94D0_49BB_1331_11EB);
        vector(stretch[(mixed ^ mixed >> 31) as usize % stretch.len()])
    };
    let finite = |point: &Vector| point.iter().all(|v| v.is_finite());
    points.chunks(step).enumerate().map(random).filter(finite).collect()
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
    /// The bundles of a cloud as seen from a place.
    fn seen(points: &[Vector], place: &Vector) -> Option<Vec<Self>> {
        let direction = |point: &Vector| (point - place).try_normalize(f64::MIN_POSITIVE).unwrap_or(Vector::z());
        let directions = Neighbors::new(points.iter().map(direction).collect()).ok()?;
        let seen = directions.points.iter().step_by(points.len().div_ceil(MAX_BUNDLES));
        let bundle = |at: &Vector| directions.nearest(at, RAYS).into_iter().map(|(index, _)| points[index]).collect();
        Some(seen.map(|at| Self(bundle(at))).collect())
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

/// How the rays of a sensor are arranged about its axis.
#[derive(Clone, Copy, PartialEq)]
enum Lattice {
    /// Equal angles in all directions.
    None,
    /// Equal steps of elevation and azimuth: a scanner that rotates about the axis.
    Turning,
    /// The pixels of an image perpendicular to the axis.
    Image,
}

impl Lattice {
    /// The logarithm of a cell's solid angle at this cosine to the axis, and its derivative.
    fn cell(self, height: f64) -> (f64, f64) {
        match self {
            Self::None => (0.0, 0.0),
            Self::Turning => {
                let squared = (1.0 - height * height).max(0.0) + MIN_COSINE * MIN_COSINE;
                (0.5 * squared.ln(), -height / squared)
            }
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
    fn by_bundles(mut self, points: &[Vector]) -> Option<(Self, f64)> {
        let mut bundles = Vec::new();
        for _ in 0..ROUNDS {
            bundles = Bundle::seen(points, &self.place)?;
            self = Self::at(&bundles, self.place, self.lattice, self.axis).improved(&bundles, FEW_STEPS);
        }
        let rays = |bundle: &Bundle| (bundle.directions(&self.place).1, self.residual(bundle));
        let left = excess(bundles.iter().map(rays).collect(), &Vector::zeros())?;
        (self.cost < MAX_BUNDLE_COST).then_some((self, left))
    }

    /// The best fit near this one, by the Levenberg–Marquardt method.
    fn improved(&self, patches: &[impl Patch], max_steps: usize) -> Self {
        let (mut best, mut damping) = (*self, 1e-3);
        for _ in 0..max_steps {
            let (mut squares, mut gradient) = (SMatrix::<f64, 7, 7>::identity() * 1e-9, SVector::<f64, 7>::zeros());
            for patch in patches {
                let (rays, by_place, by_axis) = patch.density(&best.place, best.lattice, &best.axis);
                let row: SVector<f64, 7> =
                    SVector::from_iterator(by_place.iter().chain(&by_axis).copied().chain([-1.0]));
                let weight = robust(rays - best.log).1;
                squares += weight * row * row.transpose();
                gradient += weight * (rays - best.log) * row;
            }
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

/// The best place. The search starts from a grid around the cloud with some densities and ends with all. A scanner rotates about
/// a principal axis of its surroundings, mostly the vertical.
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
    let turning = axes(densities).map(|axis| (Lattice::Turning, axis));
    let lattices = turning.into_iter().chain([(Lattice::Image, (center - best.place).normalize())]);
    let fits = lattices.map(|(lattice, axis)| Fit::at(&few, best.place, lattice, axis).improved(&few, MAX_STEPS));
    let best = fits.filter(|fit| fit.cost < LATTICE_COST * best.cost).min_by(by_cost).unwrap_or(best);
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

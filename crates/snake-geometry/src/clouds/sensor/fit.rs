//! Hypotheses about a sensor, the search for the best one, and what its residuals say.

use std::f64::consts::SQRT_2;
use std::num::NonZeroUsize;
use std::ops::Range;

use nalgebra::{Matrix3, SMatrix, SVector, SymmetricEigen};

use super::patches::{Bundle, Density, Lattice, MAX_SINE, Patch, SCALE, Step};
use super::{MIN_DENSITIES, median, middle, visible_share};
use crate::{Neighbors, Point, Vector};

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
/// Upper limit of the cost of bundles. Those of scanners and cameras have up to 0.17, those of single beams 0.22 and more.
const MAX_BUNDLE_COST: f64 = 0.2;
/// Steps along beams are below these sines, steps between beams above. Largest share of the others: of sweeps 0 to 0.13, of merged
/// ones 0.15 and more.
const OBLIQUE: Range<f64> = 0.26..0.97;
const MAX_OBLIQUE: f64 = 0.14;
/// Largest standard deviation of the place of beams, relative to the cloud's radius: sweeps have up to 0.014, images, for whose
/// rows it is any place, 0.04 and more.
const MAX_DEVIATION_OF_BEAMS: f64 = 0.015;
/// Smallest share of the points in view of the place of beams.
const MIN_VISIBLE: f64 = 0.62;
/// Number of times that bundles are formed.
const ROUNDS: usize = 3;
/// Maximum number of steps of a search, and of one round.
const MAX_STEPS: usize = 20;
const FEW_STEPS: usize = 5;
/// A place of beams this close to the frame's origin is the origin. Unit: median distances of the points from their middle.
const AT_ORIGIN: f64 = 0.01;
/// Added to each cost of an excess.
const EXCESS_NOISE: f64 = 0.05;
/// Neighbours of this rank among the densities share few points with each other.
const APART: NonZeroUsize = NonZeroUsize::new(5).unwrap();

/// The robust cost of a residual, 0 to 1, and its weight in least squares (Geman and McClure).
fn robust(residual: f64) -> (f64, f64) {
    let squared = (residual / (2.0 * SCALE)).powi(2);
    (squared / (1.0 + squared), (1.0 + squared).powi(-2))
}

fn mean_cost(residuals: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = residuals.len() as f64;
    residuals.fold(0.0, |sum, residual| sum + robust(residual).0) / count
}

/// The cost of the hypothesis that the points are spread evenly over the surfaces.
pub(super) fn cost_of_even(densities: &[Density]) -> f64 {
    let usual = median(densities.iter().map(|density| density.log).collect());
    mean_cost(densities.iter().map(|density| density.log - usual))
}

/// A hypothesis about the sensor.
#[derive(Clone, Copy)]
pub(super) struct Fit {
    pub(super) place: Vector,
    pub(super) lattice: Lattice,
    pub(super) axis: Vector,
    /// The logarithm of the number of rays per solid angle or cell.
    pub(super) log: f64,
    pub(super) cost: f64,
}

impl Fit {
    fn at(patches: &[impl Patch], place: Vector, lattice: Lattice, axis: Vector) -> Self {
        let rays: Vec<f64> = patches.iter().map(|patch| patch.density(&place, lattice, &axis).0).collect();
        let log = median(rays.clone());
        Self { place, lattice, axis, log, cost: mean_cost(rays.iter().map(|rays| rays - log)) }
    }

    pub(super) fn residual(&self, patch: &impl Patch) -> f64 {
        patch.density(&self.place, self.lattice, &self.axis).0 - self.log
    }

    /// This fit, or the one near its mirror image in the plane that faces most densities, such as the ground: the plane has the
    /// same densities for both, but only the right one sees what stands on the plane.
    pub(super) fn above(self, densities: &[Density], points: &[Vector]) -> Self {
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
    pub(super) fn by_bundles(mut self, points: &[Vector], densities: &[Density]) -> Option<(Self, f64)> {
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
    pub(super) fn by_beams(&self, axes: &[Vector], all: &[Point], points: &[Vector]) -> Option<Vector> {
        let steps = Step::seen(all, &self.place).filter(|steps| steps.len() >= MIN_DENSITIES)?;
        let fit = |axis: &Vector| Self::at(&steps, self.place, Lattice::None, *axis).improved(&steps, MAX_STEPS);
        let fit = axes.iter().map(fit).min_by(|a, b| a.cost.total_cmp(&b.cost))?;
        let (_, radius) = middle(points);
        let sine = |step: &Step| (fit.residual(step) * MAX_SINE / SCALE).abs();
        let oblique = steps.iter().filter(|step| OBLIQUE.contains(&sine(step))).count();
        let is_sensor = (oblique as f64) < MAX_OBLIQUE * steps.len() as f64
            && fit.deviation(&steps) < MAX_DEVIATION_OF_BEAMS * radius
            && visible_share(points, &fit.place) > MIN_VISIBLE;
        let is_origin = fit.place.norm() < AT_ORIGIN * radius;
        is_sensor.then_some(if is_origin { Vector::zeros() } else { fit.place })
    }

    /// The largest standard deviation of the place along any direction; infinite where the patches leave one open.
    pub(super) fn deviation(&self, patches: &[impl Patch]) -> f64 {
        let (squares, _) = self.normal_equations(patches);
        let weights = patches.iter().map(|patch| (self.residual(patch), robust(self.residual(patch)).1));
        let [sum, weight] =
            weights.fold([0.0; 2], |[sum, all], (residual, weight)| [sum + weight * residual * residual, all + weight]);
        let covariance = squares.try_inverse().map(|inverse| inverse.fixed_view::<3, 3>(0, 0) * (sum / weight));
        // The eigenvalues of a matrix that is not finite are never found.
        let covariance = covariance.filter(|covariance| covariance.iter().all(|value| value.is_finite()));
        covariance.map_or(f64::INFINITY, |covariance| covariance.symmetric_eigenvalues().max().sqrt())
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
pub(super) fn search(densities: &[Density], points: &[Vector]) -> Fit {
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
pub(super) fn axes(densities: &[Density]) -> [Vector; 3] {
    let normals: Matrix3<f64> = densities.iter().map(|density| density.normal * density.normal.transpose()).sum();
    let SymmetricEigen { eigenvalues, eigenvectors } = SymmetricEigen::new(normals);
    let mut order = [0, 1, 2];
    order.sort_by(|&a, &b| eigenvalues[b].total_cmp(&eigenvalues[a]));
    order.map(|axis| eigenvectors.column(axis).into())
}

/// The residuals of a fit relative to the differences between neighbours. A smooth change with the direction does not count: a
/// LiDAR has more rays per solid angle at some elevations.
pub(super) fn excess(patches: Vec<(Vector, f64)>, place: &Vector) -> Option<f64> {
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

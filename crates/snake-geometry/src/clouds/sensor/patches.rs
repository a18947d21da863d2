//! What tells the place of a sensor: densities on surfaces, bundles of rays, and steps along beams.

use std::num::NonZeroUsize;

use super::MAX_POINTS;
use crate::subset::mixed;
use crate::{Neighbors, Point, Vector, eigen, vector};

/// Residuals of log densities up to about this count fully. In random samples they have a standard deviation of 0.25.
pub(super) const SCALE: f64 = 0.35;
/// Maximum number of densities.
const MAX_DENSITIES: usize = 1500;
/// Number of nearest points for a density and a normal.
const NEIGHBORS: NonZeroUsize = NonZeroUsize::new(16).unwrap();
/// Largest ratio of the variance across a neighbourhood to the smaller variance along it.
const MAX_THICKNESS: f64 = 0.1;
/// Smallest ratio of the two variances along a neighbourhood; a single beam has less.
const MIN_WIDTH: f64 = 0.1;
/// Cosines below this are smoothed, because a ray along a surface hits its roughness.
const MIN_COSINE: f64 = 0.03;
/// Maximum number of bundles of rays that refine the place, and number of rays in each.
const MAX_BUNDLES: usize = 700;
const RAYS: NonZeroUsize = NonZeroUsize::new(16).unwrap();
/// Side of a part of the view, in radians, and number of nearest points to which steps are made, with the point itself.
const PART: f64 = 0.06;
const STEPS: NonZeroUsize = NonZeroUsize::new(3).unwrap();
/// Steps at an angle to a beam up to about this sine count fully.
pub(super) const MAX_SINE: f64 = 0.15;
/// Rays at a smaller cosine to the normal graze the surface.
const GRAZING: f64 = 0.3;

/// A planar neighbourhood.
pub(super) struct Density {
    pub(super) point: Vector,
    pub(super) normal: Vector,
    /// The logarithm of the number of points per area, up to a constant.
    pub(super) log: f64,
}

impl Density {
    pub(super) fn measure(cloud: &Neighbors) -> Vec<Self> {
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
pub(super) trait Patch {
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
pub(super) struct Bundle(Vec<Vector>);

impl Bundle {
    /// The bundles of a cloud as seen from a place, around neighbourhoods that the rays do not graze: many of those rays are lost.
    pub(super) fn seen(points: &[Vector], densities: &[Density], place: &Vector) -> Option<Vec<Self>> {
        let direction = |point: &Vector| (point - place).try_normalize(f64::MIN_POSITIVE).unwrap_or(Vector::z());
        let directions = Neighbors::new(points.iter().map(direction).collect()).ok()?;
        let bundle = |at: &Vector| directions.nearest(at, RAYS).into_iter().map(|(index, _)| points[index]).collect();
        let is_grazed = |density: &&Density| direction(&density.point).dot(&density.normal).abs() < GRAZING;
        let seen: Vec<&Density> = densities.iter().filter(|density| !is_grazed(density)).collect();
        let seen = seen.iter().step_by(seen.len().div_ceil(MAX_BUNDLES).max(1));
        Some(seen.map(|density| Self(bundle(&direction(&density.point)))).collect())
    }

    /// The directions and inverse distances of the points from a place, and the mean direction.
    pub(super) fn directions(&self, place: &Vector) -> (Vec<(Vector, f64)>, Vector) {
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
pub(super) struct Step {
    middle: Vector,
    along: Vector,
}

impl Step {
    /// Steps to the nearest others, in parts of the view from a place that keep all of their points.
    pub(super) fn seen(points: &[Point], place: &Vector) -> Option<Vec<Self>> {
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
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Lattice {
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

//! Pairs of points and planes: their information about a transform, and the least-squares step onto the planes.

use nalgebra::{IsometryMatrix3, Matrix3, Matrix6, Rotation3, Translation3, Vector6};

use crate::cloud::surface::Surface;
use crate::rigid::moved;
use snake_geometry::{Vector, some_in_parallel};

/// A direction is open if the mean squared cosine between it and the normals is below this. Half and twice change no
/// outcome.
const OPEN_DIRECTION: f64 = 1e-3;

/// A source point in the target frame and the plane it is matched to.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PlanePair {
    pub(crate) point: Vector,
    pub(crate) normal: Vector,
    /// Signed distance from the point to the plane along the normal.
    pub(crate) distance: f64,
}

/// Source points, each with the tangent plane of the nearest target point.
pub(crate) fn plane_pairs(source: &[Vector], target: &Surface, transform: &IsometryMatrix3<f64>) -> Vec<PlanePair> {
    let pair = |point: &Vector| {
        let point = moved(transform, point);
        let (index, _) = target.grid.nearest(&point)?;
        let normal = target.normals[index];
        Some(PlanePair { point, normal, distance: normal.dot(&(target.points[index] - point)) })
    };
    some_in_parallel(source.iter(), pair)
}

/// Every `step`-th point of source and target, each with the nearest point of the other cloud;
/// pairs whose normals do not agree are left out.
pub(crate) fn symmetric_pairs(
    [source, target]: [&Surface; 2],
    transform: &IsometryMatrix3<f64>,
    step: usize,
) -> Vec<PlanePair> {
    let inverse = transform.inverse();
    // The signs of normals count only if both surfaces have them.
    let signed = if source.is_signed() { target } else { source };
    let pair = |point: Vector, [source_index, target_index]: [usize; 2]| {
        let rotated = transform.rotation * source.normals[source_index];
        let normal = signed.common_normal(&rotated, &target.normals[target_index])?;
        Some(PlanePair { point, normal, distance: normal.dot(&(target.points[target_index] - point)) })
    };
    let forth = |index: usize| {
        let point = moved(transform, &source.points[index]);
        let (nearest, _) = target.grid.nearest(&point)?;
        pair(point, [index, nearest])
    };
    let back = |index: usize| {
        let (nearest, _) = source.grid.nearest(&moved(&inverse, &target.points[index]))?;
        pair(moved(transform, &source.points[nearest]), [nearest, index])
    };
    let indices = |surface: &Surface| (0..surface.points.len()).step_by(step);
    let mut pairs = some_in_parallel(indices(source), forth);
    pairs.extend(some_in_parallel(indices(target), back));
    pairs
}

/// The sum of the pairs' information matrices.
pub(crate) fn information<'a>(pairs: impl Iterator<Item = &'a PlanePair>) -> Matrix6<f64> {
    let rows = pairs.map(|pair| twist(&pair.point, &pair.normal));
    rows.fold(Matrix6::zeros(), |sum, row| sum + row * row.transpose())
}

/// The derivative of a point's distance to a plane with respect to a rotation about the origin and a translation.
pub(crate) fn twist(point: &Vector, normal: &Vector) -> Vector6<f64> {
    let lever = point.cross(normal);
    Vector6::new(lever.x, lever.y, lever.z, normal.x, normal.y, normal.z)
}

/// The normal equations of pairs, about the mean of their points. Rotations are scaled to lengths by
/// the pairs' extent, so that their eigenvalues are comparable with those of translations.
pub(crate) struct NormalEquations {
    pub(crate) information: Matrix6<f64>,
    residuals: Vector6<f64>,
    count: f64,
    pub(crate) center: Vector,
    pub(crate) extent: f64,
}

impl NormalEquations {
    /// Returns `None` without pairs or if all pairs share one point.
    pub(crate) fn new(pairs: &[PlanePair]) -> Option<Self> {
        let count = pairs.len() as f64;
        let center = pairs.iter().map(|pair| pair.point).sum::<Vector>() / count;
        let extent = (pairs.iter().map(|pair| (pair.point - center).norm_squared()).sum::<f64>() / count).sqrt();
        if pairs.is_empty() || extent == 0.0 {
            return None;
        }
        let (mut information, mut residuals) = (Matrix6::zeros(), Vector6::zeros());
        for PlanePair { point, normal, distance } in pairs {
            let row = twist(&((point - center) / extent), normal);
            information += row * row.transpose();
            residuals += row * *distance;
        }
        Some(Self { information, residuals, count, center, extent })
    }

    /// Allows only rotations about this axis.
    fn about(mut self, axis: &Vector) -> Self {
        let mut allowed = Matrix6::identity();
        allowed.fixed_view_mut::<3, 3>(0, 0).copy_from(&Matrix3::from(axis * axis.transpose()));
        self.information = allowed * self.information * allowed;
        self.residuals = allowed * self.residuals;
        self
    }

    /// The least-squares step, without movement along open directions.
    fn step(&self) -> IsometryMatrix3<f64> {
        let eigen = self.information.symmetric_eigen();
        let constrained = |value: &f64| *value > OPEN_DIRECTION * self.count;
        let directions = eigen.eigenvectors.column_iter().zip(eigen.eigenvalues.iter());
        let steps = directions.filter(|(_, value)| constrained(value));
        let step: Vector6<f64> =
            steps.map(|(direction, value)| direction * (direction.dot(&self.residuals) / value)).sum();
        let rotation = Rotation3::new(step.fixed_rows::<3>(0) / self.extent);
        let translation = self.center - rotation * self.center + step.fixed_rows::<3>(3);
        IsometryMatrix3::from_parts(Translation3::from(translation), rotation)
    }
}

/// The least-squares step onto the planes; `None` without pairs.
pub(crate) fn plane_step(pairs: &[PlanePair], gravity: Option<Vector>) -> Option<IsometryMatrix3<f64>> {
    let equations = NormalEquations::new(pairs)?;
    Some(match gravity {
        Some(axis) => equations.about(&axis).step(),
        None => equations.step(),
    })
}

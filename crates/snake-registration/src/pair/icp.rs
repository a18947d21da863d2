//! Point-to-plane ICP.

use nalgebra::{IsometryMatrix3, Matrix3, Matrix6, Rotation3, Translation3, Vector6};
use rayon::prelude::*;

use crate::pair::surface::Surface;
use crate::parts::rigid::{moved, rotation_vector};
use snake_core::{Counter, Result};
use snake_geometry::Vector;

/// The iteration ends when the translation is below this share of the pair distance and the rotation below this angle
/// in radians.
const TOLERANCE: f64 = 1e-5;
/// The mean squared cosine to the normals below which the pairs do not constrain a direction.
const OPEN_DIRECTION: f64 = 1e-3;

/// Refines a rough transform by point-to-plane ICP (Chen and Medioni 1991, linearised).
///
/// Each source point is paired with its nearest target point and moved towards that point's tangent plane. Pairs
/// farther apart than the target's grid finds are ignored. Directions that the geometry does not constrain, as with a
/// single plane, are not changed. With `gravity`, the rotation is about this axis only.
pub(crate) fn icp(
    source: &[Vector],
    target: &Surface,
    rough: IsometryMatrix3<f64>,
    gravity: Option<Vector>,
    max_iterations: usize,
    counter: &Counter,
) -> Result<IsometryMatrix3<f64>> {
    let pairs = |transform: &_| plane_pairs(source, target, transform);
    iterate(pairs, rough, gravity, (max_iterations, target.grid.distance()), counter)
}

/// [`icp`] with pairs in both directions whose normals agree, and with the mean of their normals (as in Rusinkiewicz 2019).
/// It is closer to the truth and takes twice the time.
pub(crate) fn symmetric_icp(
    surfaces: &[Surface; 2],
    rough: IsometryMatrix3<f64>,
    gravity: Option<Vector>,
    max_iterations: usize,
    counter: &Counter,
) -> Result<IsometryMatrix3<f64>> {
    let pairs = |transform: &_| symmetric_pairs(surfaces.each_ref(), transform, 1);
    iterate(pairs, rough, gravity, (max_iterations, surfaces[1].grid.distance()), counter)
}

/// Steps to the planes of the pairs until they no longer move, or at most so many; tolerances are relative to a distance.
pub(crate) fn iterate(
    pairs: impl Fn(&IsometryMatrix3<f64>) -> Vec<PlanePair>,
    rough: IsometryMatrix3<f64>,
    gravity: Option<Vector>,
    (max_iterations, distance): (usize, f64),
    counter: &Counter,
) -> Result<IsometryMatrix3<f64>> {
    let mut transform = rough;
    for _ in 0..max_iterations {
        counter.check()?;
        let Some(step) = plane_step(&pairs(&transform), gravity) else { break };
        transform = step * transform;
        if step.translation.vector.norm() < TOLERANCE * distance && rotation_vector(&step.rotation).norm() < TOLERANCE {
            break;
        }
    }
    Ok(transform)
}

/// A source point in the target frame that should come to a plane.
pub(crate) struct PlanePair {
    pub(crate) point: Vector,
    pub(crate) normal: Vector,
    /// The distance of the plane in front of the point.
    pub(crate) distance: f64,
}

/// Source points and the tangent planes of the nearest target points.
pub(crate) fn plane_pairs(source: &[Vector], target: &Surface, transform: &IsometryMatrix3<f64>) -> Vec<PlanePair> {
    let pair = |point: &Vector| {
        let point = moved(transform, point);
        let (index, _) = target.grid.nearest(&point)?;
        let normal = target.normals[index];
        Some(PlanePair { point, normal, distance: normal.dot(&(target.points[index] - point)) })
    };
    source.par_iter().filter_map(pair).collect()
}

/// Every `step`-th point of source and target, each with the nearest of the other, where their normals agree.
fn symmetric_pairs([source, target]: [&Surface; 2], transform: &IsometryMatrix3<f64>, step: usize) -> Vec<PlanePair> {
    let inverse = transform.inverse();
    // Signs count if both have them.
    let judge = if source.is_signed() { target } else { source };
    let pair = |point: Vector, [of_source, of_target]: [usize; 2]| {
        let turned = transform.rotation * source.normals[of_source];
        let normal = judge.common_normal(&turned, &target.normals[of_target])?;
        Some(PlanePair { point, normal, distance: normal.dot(&(target.points[of_target] - point)) })
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
    let indices = |surface: &Surface| (0..surface.points.len()).into_par_iter().step_by(step);
    let mut pairs: Vec<PlanePair> = indices(source).filter_map(forth).collect();
    pairs.par_extend(indices(target).filter_map(back));
    pairs
}

/// The transform after one step of [`symmetric_icp`] with every `step`-th point, and the information matrix of its pairs, of
/// a small rotation and then translation in the target frame; `None` without pairs.
pub(crate) fn remeasure(
    surfaces: [&Surface; 2],
    transform: &IsometryMatrix3<f64>,
    gravity: Option<Vector>,
    step: usize,
) -> Option<(IsometryMatrix3<f64>, Matrix6<f64>)> {
    let pairs = symmetric_pairs(surfaces, transform, step);
    Some((plane_step(&pairs, gravity)? * transform, information(pairs.iter())))
}

/// The sum of the pairs' information.
pub(crate) fn information<'a>(pairs: impl Iterator<Item = &'a PlanePair>) -> Matrix6<f64> {
    let rows = pairs.map(|pair| twist(&pair.point, &pair.normal));
    rows.fold(Matrix6::zeros(), |sum, row| sum + row * row.transpose())
}

/// The gradient of a point's distance to a plane by a rotation about the origin and a translation.
fn twist(point: &Vector, normal: &Vector) -> Vector6<f64> {
    let lever = point.cross(normal);
    Vector6::new(lever.x, lever.y, lever.z, normal.x, normal.y, normal.z)
}

/// The normal equations of pairs, about their mean. Rotations are scaled to lengths by the pairs' extent, so that their
/// eigenvalues are comparable with those of translations.
pub(crate) struct Normal {
    pub(crate) information: Matrix6<f64>,
    residuals: Vector6<f64>,
    count: f64,
    pub(crate) center: Vector,
    pub(crate) extent: f64,
}

impl Normal {
    /// `None` for no pairs or a single point.
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

    /// Removes rotations about other axes.
    fn about(mut self, axis: &Vector) -> Self {
        let mut allowed = Matrix6::identity();
        allowed.fixed_view_mut::<3, 3>(0, 0).copy_from(&Matrix3::from(axis * axis.transpose()));
        self.information = allowed * self.information * allowed;
        self.residuals = allowed * self.residuals;
        self
    }

    /// The least-squares step; directions that are not constrained stay.
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

fn plane_step(pairs: &[PlanePair], gravity: Option<Vector>) -> Option<IsometryMatrix3<f64>> {
    let normal = Normal::new(pairs)?;
    Some(match gravity {
        Some(axis) => normal.about(&axis).step(),
        None => normal.step(),
    })
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::parts::cloud::{Orientation, normals};
    use crate::parts::rigid::tests::random_points;
    use snake_core::Control;
    use snake_geometry::{Neighbors, vector};

    /// Random points on `sides` faces of the cube ±1.
    fn faces(sides: usize, seed: u64) -> Vec<Vector> {
        let points = random_points(&mut ChaCha8Rng::seed_from_u64(seed), 3000).into_iter().enumerate();
        points
            .map(|(i, mut p)| {
                p[i % sides] = 1.0;
                vector(p)
            })
            .collect()
    }

    fn refined(source: &[Vector], target: Vec<Vector>, rough: IsometryMatrix3<f64>) -> IsometryMatrix3<f64> {
        refined_about(None, source, target, rough)
    }

    fn refined_about(
        gravity: Option<Vector>,
        source: &[Vector],
        target: Vec<Vector>,
        rough: IsometryMatrix3<f64>,
    ) -> IsometryMatrix3<f64> {
        let target = Neighbors::new(target).unwrap();
        let normals = normals(&target, 0.2, Orientation::Mean, &Control::default()).unwrap();
        let target = Surface::new(&target.points, &normals, None, 0.3);
        icp(source, &target, rough, gravity, 30, &Counter::default()).unwrap()
    }

    #[test]
    fn a_rough_transform_becomes_exact() {
        let truth = IsometryMatrix3::new(Vector::new(2.0, -1.0, 0.5), Vector::new(0.4, 1.1, -0.3));
        let error = IsometryMatrix3::new(Vector::new(0.06, -0.05, 0.08), Vector::new(0.05, 0.04, -0.06));
        // The two clouds are different samples of the same faces.
        let source: Vec<Vector> = faces(3, 1).iter().map(|p| moved(&truth.inverse(), p)).collect();
        let found = refined(&source, faces(3, 2), error * truth);
        let left = found * truth.inverse();
        assert!(left.translation.vector.norm() < 5e-3 && left.rotation.angle() < 5e-3, "{left}");
    }

    /// A surface with the normals of the faces ±1, which point to the middle of the cube.
    fn with_normals(points: &[Vector]) -> Vec<Vector> {
        let normal = |p: &Vector| Vector::from_fn(|axis, _| if p[axis].abs() == 1.0 { -p[axis] } else { 0.0 });
        points.iter().map(|p| normal(p).normalize()).collect()
    }

    #[test]
    fn symmetric_pairs_leave_surfaces_with_other_normals_alone() {
        let room = faces(3, 1);
        let outside: Vec<Vector> = faces(3, 2).iter().map(|p| p + 0.1 * Vector::repeat(1.0)).collect();
        let normals = [with_normals(&room), with_normals(&faces(3, 2)).iter().map(|n| -n).collect()];
        let truth = IsometryMatrix3::new(Vector::new(2.0, -1.0, 0.5), Vector::new(0.4, 1.1, -0.3));
        let moved_by = |motion: &IsometryMatrix3<f64>, points: &[Vector]| -> Vec<Vector> {
            points.iter().map(|p| moved(motion, p)).collect()
        };
        let turned = |normals: &[Vector]| -> Vec<Vector> { normals.iter().map(|n| truth.rotation * n).collect() };
        // The target has the walls of the room and, 0.1 behind them, the walls of the next rooms.
        let other = faces(3, 3);
        let points = [moved_by(&truth, &other), moved_by(&truth, &outside)].concat();
        let target_normals = [turned(&with_normals(&other)), turned(&normals[1])].concat();
        let viewpoint = Some(moved(&truth, &Vector::zeros()));
        let source = Surface::new(&room, &normals[0], Some(Vector::zeros()), 0.3);
        let surfaces = [source, Surface::new(&points, &target_normals, viewpoint, 0.3)];
        let rough = IsometryMatrix3::new(Vector::repeat(0.08), Vector::zeros()) * truth;
        let left = |found: IsometryMatrix3<f64>| (found * truth.inverse()).translation.vector.norm();
        let found = symmetric_icp(&surfaces, rough, None, 30, &Counter::default()).unwrap();
        assert!(left(found) < 5e-3, "{found}");
        // Without the normals, the walls of both count.
        assert!(left(icp(&room, &surfaces[1], rough, None, 30, &Counter::default()).unwrap()) > 0.02);
        // One step from the truth stays there, and each of the pairs counts.
        let (stays, information) = remeasure(surfaces.each_ref(), &truth, None, 1).unwrap();
        assert!(left(stays) < 5e-3 && information.fixed_view::<3, 3>(3, 3).trace() > 5000.0);
    }

    #[test]
    fn a_known_axis_is_kept() {
        let truth = IsometryMatrix3::new(Vector::new(2.0, -1.0, 0.5), Vector::new(0.0, 0.0, 1.1));
        let error = IsometryMatrix3::new(Vector::new(0.06, -0.05, 0.08), Vector::new(0.0, 0.0, -0.06));
        let source: Vec<Vector> = faces(3, 1).iter().map(|p| moved(&truth.inverse(), p)).collect();
        let found = refined_about(Some(Vector::z()), &source, faces(3, 2), error * truth);
        let left = found * truth.inverse();
        assert!(left.translation.vector.norm() < 5e-3 && left.rotation.angle() < 5e-3, "{left}");
        assert!((found.rotation * Vector::z() - Vector::z()).norm() < 1e-9);
    }

    #[test]
    fn directions_that_a_plane_leaves_open_stay() {
        let rough = IsometryMatrix3::translation(0.05, 0.0, 0.1);
        let found = refined(&faces(1, 1), faces(1, 2), rough);
        // The plane is x = 1.
        assert!((found.translation.vector - Vector::new(0.0, 0.0, 0.1)).norm() < 1e-6, "{found}");
    }

    #[test]
    fn without_pairs_the_rough_transform_stays() {
        let far = IsometryMatrix3::translation(0.0, 0.0, 99.0);
        assert_eq!(refined(&faces(3, 1), faces(3, 2), far), far);
        assert_eq!(
            refined(&[Vector::zeros()], vec![Vector::zeros()], IsometryMatrix3::identity()),
            IsometryMatrix3::identity()
        );
    }
}

//! Point-to-plane ICP.

use nalgebra::{IsometryMatrix3, Matrix6};

use crate::cloud::planes::{PlanePair, information, plane_pairs, plane_step, symmetric_pairs};
use crate::cloud::surface::Surface;
use crate::rigid::rotation_vector;
use snake_core::{Counter, Result};
use snake_geometry::Vector;

/// ICP ends when the translation is below this share of the distance between pairs, and the rotation below this angle.
/// Unit: share of the distance, and radians. Half and twice change no outcome.
const TOLERANCE: f64 = 1e-5;

/// Refines a rough transform by point-to-plane ICP (Chen and Medioni 1991, linearised).
///
/// Each source point is paired with its nearest target point and moved towards that point's tangent plane. Pairs
/// beyond the distance of the target's grid are ignored. Directions that the geometry does not constrain, as on a
/// single plane, do not change. With `gravity`, only rotations about this axis are allowed.
pub(crate) fn one_way_icp(
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

/// [`one_way_icp`] with pairs in both directions whose normals agree, and with the mean of the two
/// normals (as in Rusinkiewicz 2019). It is more accurate and takes twice the time.
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

/// Repeats least-squares steps onto the planes of the pairs until the transform converges, at most
/// `max_iterations` times. The tolerance of the translation is relative to `distance`.
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

/// The transform after one step of [`symmetric_icp`] with every `step`-th point, and the
/// information matrix of its pairs; `None` without pairs. The matrix is that of a small rotation
/// and then a small translation in the target frame.
pub(crate) fn remeasure(
    surfaces: [&Surface; 2],
    transform: &IsometryMatrix3<f64>,
    step: usize,
) -> Option<(IsometryMatrix3<f64>, Matrix6<f64>)> {
    let pairs = symmetric_pairs(surfaces, transform, step);
    Some((plane_step(&pairs, None)? * transform, information(pairs.iter())))
}

#[cfg(test)]
mod tests {
    use chacha20::ChaCha8Rng;
    use rand::SeedableRng;

    use super::*;
    use crate::cloud::normals::{Orientation, normals};
    use crate::rigid::moved;
    use crate::rigid::tests::random_points;
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

    fn refined(
        gravity: Option<Vector>,
        source: &[Vector],
        target: Vec<Vector>,
        rough: IsometryMatrix3<f64>,
    ) -> IsometryMatrix3<f64> {
        let target = Neighbors::new(target).unwrap();
        let normals = normals(&target, 0.2, Orientation::Mean, &Control::default()).unwrap();
        let target = Surface::new(&target.points, &normals, None, 0.3);
        one_way_icp(source, &target, rough, gravity, 30, &Counter::default()).unwrap()
    }

    /// The normals of points on the faces ±1, which point to the centre of the cube.
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
        let rotated = |normals: &[Vector]| -> Vec<Vector> { normals.iter().map(|n| truth.rotation * n).collect() };
        // The target has the walls of the room and, 0.1 behind them, the walls of the next rooms.
        let other = faces(3, 3);
        let points = [moved_by(&truth, &other), moved_by(&truth, &outside)].concat();
        let target_normals = [rotated(&with_normals(&other)), rotated(&normals[1])].concat();
        let viewpoint = Some(moved(&truth, &Vector::zeros()));
        let source = Surface::new(&room, &normals[0], Some(Vector::zeros()), 0.3);
        let surfaces = [source, Surface::new(&points, &target_normals, viewpoint, 0.3)];
        let rough = IsometryMatrix3::new(Vector::repeat(0.08), Vector::zeros()) * truth;
        let left = |result: IsometryMatrix3<f64>| (result * truth.inverse()).translation.vector.norm();
        let result = symmetric_icp(&surfaces, rough, None, 30, &Counter::default()).unwrap();
        assert!(left(result) < 5e-3, "{result}");
        // If the normals do not select the pairs, the walls of both rooms count.
        assert!(left(one_way_icp(&room, &surfaces[1], rough, None, 30, &Counter::default()).unwrap()) > 0.02);
        // One step from the truth stays there, and each of the pairs counts.
        let (stays, information) = remeasure(surfaces.each_ref(), &truth, 1).unwrap();
        assert!(left(stays) < 5e-3 && information.fixed_view::<3, 3>(3, 3).trace() > 5000.0);
    }

    #[test]
    fn a_known_axis_is_kept() {
        let truth = IsometryMatrix3::new(Vector::new(2.0, -1.0, 0.5), Vector::new(0.0, 0.0, 1.1));
        let error = IsometryMatrix3::new(Vector::new(0.06, -0.05, 0.08), Vector::new(0.0, 0.0, -0.06));
        let source: Vec<Vector> = faces(3, 1).iter().map(|p| moved(&truth.inverse(), p)).collect();
        let result = refined(Some(Vector::z()), &source, faces(3, 2), error * truth);
        let left = result * truth.inverse();
        assert!(left.translation.vector.norm() < 5e-3 && left.rotation.angle() < 5e-3, "{left}");
        assert!((result.rotation * Vector::z() - Vector::z()).norm() < 1e-9);
    }

    #[test]
    fn directions_that_a_plane_leaves_open_stay() {
        let rough = IsometryMatrix3::translation(0.05, 0.0, 0.1);
        let result = refined(None, &faces(1, 1), faces(1, 2), rough);
        // The plane is x = 1.
        assert!((result.translation.vector - Vector::new(0.0, 0.0, 0.1)).norm() < 1e-6, "{result}");
    }

    #[test]
    fn without_pairs_the_rough_transform_stays() {
        let far = IsometryMatrix3::translation(0.0, 0.0, 99.0);
        assert_eq!(refined(None, &faces(3, 1), faces(3, 2), far), far);
        let still = IsometryMatrix3::identity();
        assert_eq!(refined(None, &[Vector::zeros()], vec![Vector::zeros()], still), still);
    }
}

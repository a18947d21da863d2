//! Point-to-plane ICP.

use nalgebra::{IsometryMatrix3, Matrix6, Rotation3, Translation3, Vector6};
use rayon::prelude::*;

use super::rigid::moved;
use snake_core::Control;
use snake_core::Result;
use snake_core::space::{Neighbors, Vector};

/// The iteration ends when the translation is below this share of the pair distance and the rotation below this angle
/// in radians.
const TOLERANCE: f64 = 1e-5;
/// The mean squared cosine to the normals below which the pairs do not constrain a direction.
const OPEN_DIRECTION: f64 = 1e-3;

/// Refines a rough transform by point-to-plane ICP (Chen and Medioni 1991, linearised).
///
/// Each source point is paired with its nearest target point and moved towards that point's tangent plane. Pairs
/// farther apart than `max_distance` are ignored. Directions that the geometry does not constrain, as with a single
/// plane, are not changed.
pub(super) fn icp(
    source: &[Vector],
    target: &Neighbors,
    target_normals: &[Vector],
    rough: IsometryMatrix3<f64>,
    max_distance: f64,
    max_iterations: usize,
    control: &Control,
) -> Result<IsometryMatrix3<f64>> {
    let mut transform = rough;
    let counter = control.begin("ICP", max_iterations);
    for _ in 0..max_iterations {
        counter.check()?;
        counter.add(1);
        let pair = |point: &Vector| {
            let point = moved(&transform, point);
            let (index, distance) = target.nearest(&point, std::num::NonZeroUsize::MIN)[0];
            (distance < max_distance).then_some((point, index))
        };
        let pairs: Vec<_> = source.par_iter().filter_map(pair).collect();
        let Some(step) = plane_step(&pairs, target, target_normals) else { break };
        transform = step * transform;
        if step.translation.vector.norm() < TOLERANCE * max_distance && step.rotation.angle() < TOLERANCE {
            break;
        }
    }
    Ok(transform)
}

/// The quality of a transform, as in Open3D's `evaluate_registration`: the share of source points closer than
/// `max_distance` to the target, and the root mean square distance of these points; 0 without any.
pub(super) fn fitness(
    source: &[Vector],
    target: &Neighbors,
    transform: &IsometryMatrix3<f64>,
    max_distance: f64,
) -> (f64, f64) {
    let distance = |point: &Vector| target.nearest(&moved(transform, point), std::num::NonZeroUsize::MIN)[0].1;
    let distances: Vec<f64> = source.par_iter().map(distance).filter(|distance| *distance < max_distance).collect();
    let count = distances.len() as f64;
    let sum: f64 = distances.iter().map(|distance| distance.powi(2)).sum();
    (count / source.len().max(1) as f64, (sum / count.max(1.0)).sqrt())
}

/// The least-squares step of pairs (source point in the target frame, index of its partner); `None` for no pairs or a
/// single point.
fn plane_step(pairs: &[(Vector, usize)], target: &Neighbors, normals: &[Vector]) -> Option<IsometryMatrix3<f64>> {
    let count = pairs.len() as f64;
    let center = pairs.iter().map(|(point, _)| point).sum::<Vector>() / count;
    let extent = (pairs.iter().map(|(point, _)| (point - center).norm_squared()).sum::<f64>() / count).sqrt();
    if pairs.is_empty() || extent == 0.0 {
        return None;
    }
    let (mut information, mut residuals) = (Matrix6::zeros(), Vector6::zeros());
    for (point, index) in pairs {
        let normal = &normals[*index];
        // Rotations are scaled to lengths, so that their eigenvalues are comparable with those of translations.
        let lever = (point - center).cross(normal) / extent;
        let row = Vector6::new(lever.x, lever.y, lever.z, normal.x, normal.y, normal.z);
        information += row * row.transpose();
        residuals += row * normal.dot(&(target.points[*index] - point));
    }
    let eigen = information.symmetric_eigen();
    let constrained = |value: &f64| *value > OPEN_DIRECTION * count;
    let step = eigen.eigenvectors.column_iter().zip(eigen.eigenvalues.iter()).filter(|(_, value)| constrained(value));
    let step: Vector6<f64> = step.map(|(direction, value)| direction * (direction.dot(&residuals) / value)).sum();
    let rotation = Rotation3::new(step.fixed_rows::<3>(0) / extent);
    let translation = center - rotation * center + step.fixed_rows::<3>(3);
    Some(IsometryMatrix3::from_parts(Translation3::from(translation), rotation))
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::super::cloud::normals;
    use super::super::rigid::tests::random_points;
    use super::*;
    use snake_core::space::vector;

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
        let target = Neighbors::new(target).unwrap();
        let normals = normals(&target, 0.2, &Control::default()).unwrap();
        icp(source, &target, &normals, rough, 0.3, 30, &Control::default()).unwrap()
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

    #[test]
    fn fitness_counts_what_is_near() {
        let target = Neighbors::new(vec![Vector::zeros(), Vector::x()]).unwrap();
        let source = [Vector::zeros(), Vector::x(), 0.3 * Vector::y(), 9.0 * Vector::z()];
        let of = |transform| fitness(&source, &target, &transform, 1.0);
        assert_eq!(of(IsometryMatrix3::identity()), (0.75, 0.03_f64.sqrt()));
        assert_eq!(of(IsometryMatrix3::translation(0.0, 0.0, 99.0)), (0.0, 0.0));
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

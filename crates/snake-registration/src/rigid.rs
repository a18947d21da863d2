//! Rigid transforms: the least-squares fit, and the transform of points.

use nalgebra::{
    IsometryMatrix3, Matrix3, Matrix4, Quaternion, Rotation3, SymmetricEigen, Translation3, UnitQuaternion,
};

use snake_core::{Error, Result};
use snake_geometry::{Point, RigidTransform, Vector, check_pairs, vector};

/// The least-squares rigid transform `t_target_source` from `source` `(N, 3)` to `target` `(N, 3)`,
/// where row i corresponds to row i.
///
/// It minimises `Σ |R source_i + t - target_i|²` (Kabsch 1976). It is always a rotation, even where
/// a reflection would fit better.
///
/// ```
/// use snake_registration::{kabsch, transform_points};
/// let source = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 2.0, 0.0]];
/// let target = [[5.0, 0.0, 0.0], [5.0, 1.0, 0.0], [3.0, 0.0, 0.0]];
/// let moved = transform_points(&kabsch(&source, &target)?, &source);
/// assert!(moved.as_flattened().iter().zip(target.as_flattened()).all(|(a, b)| (a - b).abs() < 1e-6));
/// # Ok::<(), snake_core::Error>(())
/// ```
///
/// # Errors
/// [`Error::Input`] when the arrays differ in length, hold fewer than three points or a coordinate
/// that is not finite, or are collinear, so that the rotation is not unique.
pub fn kabsch(source: &[Point], target: &[Point]) -> Result<RigidTransform> {
    check_pairs(source, target)?;
    let pairs = source.iter().zip(target).map(|(&s, &t)| (vector(s), vector(t)));
    let reason = || "fewer than three points that are not on one line: any rotation about it would do".into();
    best_fit(pairs).map(RigidTransform::from).ok_or_else(|| Error::Input { what: "source", reason: reason() })
}

/// Transforms points `(N, 3)`, computed in f64.
pub fn transform_points(transform: &RigidTransform, points: &[Point]) -> Vec<Point> {
    points.iter().map(|&point| transform.apply(point)).collect()
}

/// [`kabsch`] for pairs (source, target); `None` if the points of either are collinear.
///
/// The rotation is the eigenvector of Horn (1987), a unit quaternion and therefore never a reflection. nalgebra's
/// decomposition of 3×3 matrices squares them, which loses half of the digits if three points are nearly collinear.
pub(crate) fn best_fit(pairs: impl Iterator<Item = (Vector, Vector)> + Clone) -> Option<IsometryMatrix3<f64>> {
    let count = pairs.clone().count() as f64;
    let [source_mean, target_mean] =
        pairs.clone().fold([Vector::zeros(); 2], |[a, b], (s, t)| [a + s, b + t]).map(|sum| sum / count);
    let c: Matrix3<f64> = pairs.map(|(s, t)| (s - source_mean) * (t - target_mean).transpose()).sum();
    let skew = Vector::new(c.m23 - c.m32, c.m31 - c.m13, c.m12 - c.m21);
    let mut horn = Matrix4::from_diagonal_element(c.trace());
    horn.fixed_view_mut::<1, 3>(0, 1).copy_from(&skew.transpose());
    horn.fixed_view_mut::<3, 1>(1, 0).copy_from(&skew);
    horn.fixed_view_mut::<3, 3>(1, 1).copy_from(&(c + c.transpose() - Matrix3::from_diagonal_element(c.trace())));
    let SymmetricEigen { eigenvalues, eigenvectors } = horn.symmetric_eigen();
    let largest = eigenvalues.imax();
    let gap = eigenvalues[largest] - eigenvalues.remove_row(largest).max();
    // For collinear points two quaternions are equally good, up to squared rounding errors of f32
    // coordinates. Without pairs all quaternions are equally good.
    if gap <= 1e-8 * eigenvalues[largest] {
        return None;
    }
    let q = eigenvectors.column(largest);
    let rotation = UnitQuaternion::new_normalize(Quaternion::new(q[0], q[1], q[2], q[3])).to_rotation_matrix();
    let translation = target_mean - rotation * source_mean;
    Some(IsometryMatrix3::from_parts(Translation3::from(translation), rotation))
}

/// The least-squares transform of pairs (source, target) whose rotation is about a unit axis;
/// `None` if the points do not determine its angle.
pub(crate) fn best_fit_about(axis: &Vector, pairs: &[(Vector, Vector)]) -> Option<IsometryMatrix3<f64>> {
    let count = pairs.len() as f64;
    let [source_mean, target_mean] =
        pairs.iter().fold([Vector::zeros(); 2], |[a, b], (s, t)| [a + s, b + t]).map(|sum| sum / count);
    let (sine, cosine) = pairs.iter().fold((0.0, 0.0), |(sine, cosine), (s, t)| {
        let (s, t) = (s - source_mean, t - target_mean);
        (sine + axis.dot(&s.cross(&t)), cosine + s.dot(&t) - axis.dot(&s) * axis.dot(&t))
    });
    if pairs.len() < 2 || (sine, cosine) == (0.0, 0.0) {
        return None;
    }
    let rotation = Rotation3::from_scaled_axis(axis * f64::atan2(sine, cosine));
    let translation = target_mean - rotation * source_mean;
    Some(IsometryMatrix3::from_parts(Translation3::from(translation), rotation))
}

/// The axis of a rotation times its angle. `Rotation3::scaled_axis` is NaN for half of the rotations
/// by almost nothing, because it takes the arc cosine of a rounded trace.
pub(crate) fn rotation_vector(rotation: &Rotation3<f64>) -> Vector {
    UnitQuaternion::from_rotation_matrix(rotation).scaled_axis()
}

/// Transforms a vector as a position.
pub(crate) fn moved(transform: &IsometryMatrix3<f64>, point: &Vector) -> Vector {
    transform.transform_point(&(*point).into()).coords
}

/// The root mean square distance between the positions of points under two transforms.
pub(crate) fn displacement(a: &IsometryMatrix3<f64>, b: &IsometryMatrix3<f64>, points: &[Vector]) -> f64 {
    let squared = points.iter().map(|point| (moved(a, point) - moved(b, point)).norm_squared());
    (squared.sum::<f64>() / points.len().max(1) as f64).sqrt()
}

#[cfg(test)]
pub(crate) mod tests {
    use chacha20::ChaCha8Rng;
    use rand::{RngExt, SeedableRng};

    use super::*;

    /// A uniformly random rotation with a translation of a few units.
    pub(crate) fn random_transform(rng: &mut ChaCha8Rng) -> IsometryMatrix3<f64> {
        let mut normal = || (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0;
        let quaternion =
            nalgebra::UnitQuaternion::new_normalize(nalgebra::Quaternion::new(normal(), normal(), normal(), normal()));
        let translation = Translation3::new(normal(), normal(), normal());
        IsometryMatrix3::from_parts(translation, quaternion.to_rotation_matrix())
    }

    /// The points of samples/plane.ply.
    pub(crate) fn sample() -> Vec<Point> {
        snake_io::read_points(concat!(env!("CARGO_MANIFEST_DIR"), "/../../samples/plane.ply").as_ref()).unwrap()
    }

    pub(crate) fn random_points(rng: &mut ChaCha8Rng, count: usize) -> Vec<Point> {
        (0..count).map(|_| std::array::from_fn(|_| rng.random_range(-1.0..1.0))).collect()
    }

    fn squared_residual(transform: &IsometryMatrix3<f64>, pairs: &[(Vector, Vector)]) -> f64 {
        pairs.iter().map(|(s, t)| (moved(transform, s) - t).norm_squared()).sum()
    }

    #[test]
    fn the_vector_of_a_rotation_by_nothing_is_zero() {
        let mut rng = ChaCha8Rng::seed_from_u64(11);
        for size in [0.0, 1e-9, 1e-3, 1.0, 3.1] {
            for _ in 0..100 {
                let frame = random_transform(&mut rng).rotation;
                let expected = size * (frame * Vector::x());
                let rotated = Rotation3::new(frame.inverse() * expected);
                let vector = rotation_vector(&(frame * rotated * frame.inverse()));
                assert!((vector - expected).norm() < 1e-7, "{vector} {expected}");
            }
        }
    }

    #[test]
    fn known_transforms_are_recovered_from_space_and_plane() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        for case in 0..300 {
            let (truth, offset) = (random_transform(&mut rng), if case % 3 == 0 { 1e4 } else { 0.0 });
            let mut source = random_points(&mut rng, 3 + case % 40);
            if case % 2 == 0 {
                // In a plane, a reflection fits as well as a rotation.
                source.iter_mut().for_each(|p| p[2] = 0.3 * p[0] - 0.2);
            }
            let source: Vec<Vector> = source.into_iter().map(|p| vector(p).add_scalar(offset)).collect();
            let fit = best_fit(source.iter().map(|s| (*s, moved(&truth, s)))).unwrap();
            assert!((fit.rotation.matrix() - truth.rotation.matrix()).norm() < 1e-7, "case {case}");
            assert!(source.iter().all(|s| (moved(&fit, s) - moved(&truth, s)).norm() < 1e-7), "case {case}");
        }
    }

    #[test]
    fn noisy_and_mirrored_points_get_the_best_proper_rotation() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        for case in 0..60 {
            let truth = random_transform(&mut rng);
            let pair = |(p, noise): (Point, Point)| {
                let mirrored = if case % 2 == 0 { [-p[0], p[1], p[2]] } else { p };
                (vector(p), moved(&truth, &vector(mirrored)) + 0.1 * vector(noise))
            };
            let [points, noise] = [(); 2].map(|()| random_points(&mut rng, 12));
            let pairs: Vec<(Vector, Vector)> = points.into_iter().zip(noise).map(pair).collect();
            let fit = best_fit(pairs.iter().copied()).unwrap();
            assert!((fit.rotation.matrix().determinant() - 1.0).abs() < 1e-9);
            let least = squared_residual(&fit, &pairs);
            // No transform, near or far, has a smaller residual.
            for step in [1e-3, 1e-2, 0.1, 1.0, 3.0] {
                for axis in 0..6 {
                    let mut parameters = [0.0; 6];
                    parameters[axis] = step;
                    let [x, y, z, a, b, c] = parameters;
                    let change = IsometryMatrix3::new(Vector::new(x, y, z), Vector::new(a, b, c));
                    assert!(squared_residual(&(change * fit), &pairs) > least, "case {case}");
                }
            }
        }
    }

    #[test]
    fn what_does_not_fix_a_rotation_is_refused() {
        let line: Vec<Point> =
            (0..9).map(|i| [0.1 * i as f32, 0.7 - 0.3 * i as f32, 1000.0 + 0.2 * i as f32]).collect();
        for points in [vec![], vec![[1.0; 3]; 2], vec![[2.0, 1.0, 0.0]; 9], vec![[0.0; 3], [1.0; 3]], line] {
            let error = kabsch(&points, &points).unwrap_err().to_string();
            assert!(error.contains("one line"), "{error}");
        }
        let three = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
        assert!(kabsch(&three, &three[..2]).unwrap_err().to_string().contains("2 points"));
        assert!(kabsch(&three, &[[f32::NAN; 3]; 3]).unwrap_err().to_string().contains("finite"));
        assert!(kabsch(&three.map(|p| p.map(|v| v * f32::MAX)), &three).is_ok());
    }
}

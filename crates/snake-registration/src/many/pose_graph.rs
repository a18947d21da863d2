//! Robust least squares over poses that are linked by measured transforms.
//!
//! This is a dense Levenberg-Marquardt of one page. The factor-graph crates would bring a second
//! version of nalgebra and about a hundred crates, for graphs far larger than ours.

use nalgebra::{DMatrix, DVector, IsometryMatrix3, Matrix3, Matrix6, Rotation3, Translation3, Vector6};

use crate::rigid::rotation_vector;
use snake_core::{Counter, Result};
use snake_geometry::Vector;

/// Number of steps with one set of robust weights. Set by hand.
const POSE_STEPS: usize = 8;
/// A link with a larger squared error has no weight. This is also the width of the widest kernel.
/// The poses start from the most reliable links, and without the limit, some wrong links that agree
/// with each other outvote them. Unit: squared thresholds. Set by hand.
const WIDEST: f64 = 100.0;
/// Factor by which the kernel narrows from one round to the next. Unit: ratio of widths. Set by hand.
const NARROWING: f64 = 1.6;
/// A smaller step ends the round. Unit: radians, and inlier distances. Set by hand.
const POSE_TOLERANCE: f64 = 1e-7;
/// Damping of directions that no link fixes. Unit: share of the diagonal. Set by hand.
const MIN_DAMPING: f64 = 1e-9;

/// A measured transform between two poses.
#[derive(Debug, Clone)]
pub(super) struct Link {
    pub(super) source: usize,
    pub(super) target: usize,
    pub(super) t_target_source: IsometryMatrix3<f64>,
    /// Information matrix of a small rotation and then a small translation in the target frame: the
    /// sum over `count` pairs of points.
    pub(super) information: Matrix6<f64>,
}

impl Link {
    /// The error `(rotation vector, translation)` of two poses: the motion from the measured
    /// transform to that of the poses.
    fn residual(&self, poses: &[IsometryMatrix3<f64>]) -> Vector6<f64> {
        let error = poses[self.target].inverse() * poses[self.source] * self.t_target_source.inverse();
        let (rotation, translation) = (rotation_vector(&error.rotation), error.translation.vector);
        Vector6::new(rotation.x, rotation.y, rotation.z, translation.x, translation.y, translation.z)
    }

    /// The derivatives of the residual with respect to small motions of source and target, each in its own frame.
    fn jacobians(&self, residual: &Vector6<f64>) -> [Matrix6<f64>; 2] {
        let rotation: Vector = residual.fixed_rows::<3>(0).into();
        let translation: Vector = residual.fixed_rows::<3>(3).into();
        let rotate = Rotation3::new(rotation).into_inner();
        let measured = self.t_target_source.rotation.matrix();
        // Source: error · M Exp(δ) M⁻¹, where M is the measured transform.
        let mut source = Matrix6::zeros();
        source.fixed_view_mut::<3, 3>(0, 0).copy_from(&(inverse_right_jacobian(&rotation) * measured));
        let lever = self.t_target_source.translation.vector.cross_matrix() * measured;
        source.fixed_view_mut::<3, 3>(3, 0).copy_from(&(rotate * lever));
        source.fixed_view_mut::<3, 3>(3, 3).copy_from(&(rotate * measured));
        // Target: Exp(-δ) · error.
        let mut target = Matrix6::zeros();
        target.fixed_view_mut::<3, 3>(0, 0).copy_from(&-inverse_right_jacobian(&-rotation));
        target.fixed_view_mut::<3, 3>(3, 0).copy_from(&translation.cross_matrix());
        target.fixed_view_mut::<3, 3>(3, 3).copy_from(&-Matrix3::identity());
        [source, target]
    }

    /// The mean squared distance, along the planes' normals, between the pairs under the poses and
    /// under the measured transform, in squared cloud units. It is comparable between links.
    pub(super) fn squared_error(&self, poses: &[IsometryMatrix3<f64>]) -> f64 {
        let residual = self.residual(poses);
        (self.information * residual).dot(&residual) / self.count()
    }

    /// The number of pairs: each adds the square of a unit normal to the diagonal of the translations.
    fn count(&self) -> f64 {
        self.information.fixed_view::<3, 3>(3, 3).trace().max(f64::MIN_POSITIVE)
    }
}

/// The derivative of `log(R Exp(ω))` with respect to ω at 0, for R = Exp(rotation).
fn inverse_right_jacobian(rotation: &Vector) -> Matrix3<f64> {
    let (angle, cross) = (rotation.norm(), rotation.cross_matrix());
    let second =
        if angle < 1e-4 { 1.0 / 12.0 } else { 1.0 / angle.powi(2) - 1.0 / (2.0 * angle * (angle / 2.0).tan()) };
    Matrix3::identity() + 0.5 * cross + second * cross * cross
}

/// Optimises the poses; the first one is fixed. The weights of links whose error exceeds `threshold` (cloud units)
/// fall towards zero (kernel of Geman and McClure), after rounds with wider kernels (graduated non-convexity, Yang et
/// al. 2020). Links far from the poses have no weight unless a round brings them closer.
pub(super) fn optimize(
    poses: &mut [IsometryMatrix3<f64>],
    links: &[Link],
    threshold: f64,
    counter: &Counter,
) -> Result<()> {
    let squared = threshold * threshold;
    let largest = links.iter().map(|link| link.squared_error(poses)).fold(0.0, f64::max);
    let mut width = (2.0 * largest / squared).clamp(1.0, WIDEST);
    loop {
        let weight = |link: &Link| match link.squared_error(poses) {
            error if error > WIDEST * squared => 0.0,
            error => (width * squared / (error + width * squared)).powi(2),
        };
        let weights: Vec<f64> = links.iter().map(weight).collect();
        least_squares(poses, links, &weights, threshold, counter)?;
        if width == 1.0 {
            return Ok(());
        }
        width = (width / NARROWING).max(1.0);
    }
}

/// Optimises the poses; the first one is fixed, and each link has its weight.
pub(super) fn least_squares(
    poses: &mut [IsometryMatrix3<f64>],
    links: &[Link],
    weights: &[f64],
    scale: f64,
    counter: &Counter,
) -> Result<()> {
    let cost = |poses: &[IsometryMatrix3<f64>]| -> f64 {
        let costs = links.iter().zip(weights).map(|(link, weight)| weight * link.count() * link.squared_error(poses));
        costs.sum()
    };
    let (mut damping, mut best) = (1e-6, cost(poses));
    for _ in 0..POSE_STEPS {
        counter.check()?;
        let (normal, gradient) = normal_equations(poses, links, weights);
        let Some(inverse) = damped(&normal, damping).cholesky() else {
            damping *= 10.0;
            continue;
        };
        let step = -inverse.solve(&gradient);
        let moved: Vec<IsometryMatrix3<f64>> = poses
            .iter()
            .enumerate()
            .map(
                |(i, pose)| if i == 0 { *pose } else { pose * small_motion(&step.fixed_rows::<6>(6 * (i - 1)).into()) },
            )
            .collect();
        let moved_cost = cost(&moved);
        if moved_cost > best {
            damping *= 10.0;
            continue;
        }
        poses.copy_from_slice(&moved);
        (best, damping) = (moved_cost, (damping / 10.0).max(MIN_DAMPING));
        if step.amax() < POSE_TOLERANCE * scale.min(1.0) {
            break;
        }
    }
    Ok(())
}

fn small_motion(step: &Vector6<f64>) -> IsometryMatrix3<f64> {
    let rotation = Rotation3::new(step.fixed_rows::<3>(0).into_owned());
    IsometryMatrix3::from_parts(Translation3::from(step.fixed_rows::<3>(3).into_owned()), rotation)
}

/// The normal matrix and the gradient of all poses but the first.
fn normal_equations(poses: &[IsometryMatrix3<f64>], links: &[Link], weights: &[f64]) -> (DMatrix<f64>, DVector<f64>) {
    let size = 6 * (poses.len() - 1);
    let (mut normal, mut gradient) = (DMatrix::zeros(size, size), DVector::zeros(size));
    for (link, weight) in links.iter().zip(weights) {
        let residual = link.residual(poses);
        let information = *weight * link.information;
        let jacobians = link.jacobians(&residual);
        let ends = [(link.source, jacobians[0]), (link.target, jacobians[1])];
        for (row, row_jacobian) in ends.iter().filter(|(pose, _)| *pose > 0) {
            let left = row_jacobian.transpose() * information;
            let mut part = gradient.fixed_rows_mut::<6>(6 * (row - 1));
            part += left * residual;
            for (column, column_jacobian) in ends.iter().filter(|(pose, _)| *pose > 0) {
                let mut block = normal.fixed_view_mut::<6, 6>(6 * (row - 1), 6 * (column - 1));
                block += left * column_jacobian;
            }
        }
    }
    (normal, gradient)
}

/// The matrix with a raised diagonal, whose entries are bounded away from zero.
fn damped(normal: &DMatrix<f64>, damping: f64) -> DMatrix<f64> {
    let mut damped = normal.clone();
    let least = MIN_DAMPING * normal.diagonal().max();
    for i in 0..damped.nrows() {
        damped[(i, i)] = (damped[(i, i)] * (1.0 + damping)).max(least).max(f64::MIN_POSITIVE);
    }
    damped
}

/// The covariances of the poses relative to the first, each of a small rotation and then a small translation in the
/// pose's own frame. `variance` is the least variance of one distance to a plane; if loops disagree more, their
/// variance is used. Directions that the links leave open have a large but finite covariance.
pub(super) fn covariances(poses: &[IsometryMatrix3<f64>], links: &[Link], variance: f64) -> Vec<Matrix6<f64>> {
    let (normal, _) = normal_equations(poses, links, &vec![1.0; links.len()]);
    let mut damping = MIN_DAMPING;
    let inverse = loop {
        // Enough damping makes any matrix of a sum of squares positive definite.
        match damped(&normal, damping).cholesky() {
            Some(decomposed) => break decomposed.inverse(),
            None => damping *= 10.0,
        }
    };
    let freedom = 6.0 * (links.len() as f64 - (poses.len() as f64 - 1.0));
    let cost: f64 = links.iter().map(|link| link.count() * link.squared_error(poses)).sum();
    let variance = if freedom > 0.0 { variance.max(cost / freedom) } else { variance };
    let covariance = |i: usize| match i {
        0 => Matrix6::zeros(),
        _ => variance * inverse.fixed_view::<6, 6>(6 * (i - 1), 6 * (i - 1)),
    };
    (0..poses.len()).map(covariance).collect()
}

#[cfg(test)]
mod tests {
    use chacha20::ChaCha8Rng;
    use rand::{RngExt, SeedableRng};

    use super::*;
    use crate::rigid::tests::random_transform;

    fn noise(rng: &mut ChaCha8Rng, size: f64) -> IsometryMatrix3<f64> {
        small_motion(&Vector6::from_fn(|_, _| size * rng.random_range(-1.0..1.0)))
    }

    /// A ring of poses with chords.
    fn ring(count: usize, size: f64) -> (Vec<IsometryMatrix3<f64>>, Vec<Link>) {
        let mut rng = ChaCha8Rng::seed_from_u64(8);
        let truth: Vec<_> = (0..count).map(|_| random_transform(&mut rng)).collect();
        let pairs = (0..count).flat_map(|i| [(i, (i + 1) % count), (i, (i + 2) % count)]);
        let link = |(source, target): (usize, usize)| {
            let factor = Matrix6::from_fn(|_, _| rng.random_range(-1.0..1.0));
            let t_target_source = truth[target].inverse() * truth[source] * noise(&mut rng, size);
            Link { source, target, t_target_source, information: factor * factor.transpose() + Matrix6::identity() }
        };
        let links = pairs.map(link).collect();
        (truth, links)
    }

    #[test]
    fn derivatives_are_those_of_differences() {
        let (truth, links) = ring(5, 0.3);
        for link in &links {
            let jacobians = link.jacobians(&link.residual(&truth));
            for (pose, jacobian) in [(link.source, jacobians[0]), (link.target, jacobians[1])] {
                for axis in 0..6 {
                    let at = |step: f64| {
                        let mut poses = truth.clone();
                        let mut motion = Vector6::zeros();
                        motion[axis] = step;
                        poses[pose] *= small_motion(&motion);
                        link.residual(&poses)
                    };
                    let difference = (at(1e-6) - at(-1e-6)) / 2e-6;
                    assert!((difference - jacobian.column(axis)).norm() < 1e-6, "axis {axis}");
                }
            }
        }
    }

    #[test]
    fn poses_far_along_a_chain_are_less_certain() {
        let (truth, links) = ring(6, 0.0);
        let chain: Vec<Link> = links.into_iter().step_by(2).take(5).collect();
        let narrow = covariances(&truth, &chain, 1e-4);
        assert_eq!(narrow[0], Matrix6::zeros());
        let volume = |i: usize| narrow[i].determinant();
        assert!((2..6).all(|i| volume(i) > volume(i - 1)));
        // One link from the first pose: the inverse of its information, which is in the target's frame.
        let expected = 1e-4 * chain[0].information.try_inverse().unwrap();
        assert!((narrow[1] - expected).norm() < 1e-6 * expected.norm());
        // A pose that a link leaves open in one direction is uncertain there, and finite.
        let mut open = chain;
        open[4].information.row_mut(5).fill(0.0);
        open[4].information.column_mut(5).fill(0.0);
        let wide = covariances(&truth, &open, 1e-4);
        assert!(wide[5].trace() > 1e3 * narrow[5].trace() && wide[5].iter().all(|v| v.is_finite()));
        assert!((wide[4] - narrow[4]).norm() < 1e-6 * narrow[4].norm());
    }
}

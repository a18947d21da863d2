//! The rotations in which a cloud is encoded: a fixed set of evenly distributed rotations, and its principal axes.

use nalgebra::{Matrix3, Vector3};

use crate::Point;

/// A rotation matrix, row by row.
pub type Rotation = [Point; 3];

/// The identity.
pub const IDENTITY: Rotation = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

/// `number` evenly distributed rotations: super-Fibonacci spirals (Alexa, CVPR 2022), rotated so that the first is the
/// identity.
pub fn super_fibonacci(number: usize) -> impl Iterator<Item = Rotation> {
    let quaternion = move |i: usize| {
        let place = i as f64 + 0.5;
        let share = place / number as f64;
        let [a, b] = [std::f64::consts::SQRT_2, 1.533_751_168_755_204_3].map(|c| std::f64::consts::TAU * place / c);
        let [r, s] = [share.sqrt(), (1.0 - share).sqrt()];
        nalgebra::UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(
            r * a.sin(),
            r * a.cos(),
            s * b.sin(),
            s * b.cos(),
        ))
    };
    let back = quaternion(0).inverse();
    let matrix = move |i: usize| {
        let rotation = (quaternion(i) * back).to_rotation_matrix();
        std::array::from_fn(|row| std::array::from_fn(|column| rotation[(row, column)] as f32))
    };
    // The identity is exact, without rounding.
    std::iter::once(IDENTITY).chain((1..number).map(matrix))
}

/// The rotation of a cloud about `center` into its principal axes, with the longest axis along x.
///
/// Each axis points to the side of positive skewness. If that gives a reflection, the axis of least skewness is reversed.
/// This is the axis across a plane of symmetry, if there is one, so the sign is the same for any samples of a shape.
pub fn principal_axes(points: &[Point], center: Point) -> Rotation {
    let offset = |p: &Point| Vector3::from_fn(|axis, _| f64::from(p[axis]) - f64::from(center[axis]));
    let scatter = points.iter().map(offset).map(|v| v * v.transpose()).sum::<Matrix3<f64>>();
    let eigen = scatter.symmetric_eigen();
    let mut order = [0, 1, 2];
    order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
    let mut axes = order.map(|axis| eigen.eigenvectors.column(axis).into_owned());
    let cubes = |sums: Vector3<f64>, p: &Point| sums + Vector3::from(axes.map(|axis| axis.dot(&offset(p)).powi(3)));
    let cubes = points.iter().fold(Vector3::zeros(), cubes);
    let skewness = Vector3::from_fn(|axis, _| match eigen.eigenvalues[order[axis]] {
        variance if variance > 0.0 => cubes[axis] / variance.powf(1.5),
        _ => 0.0,
    });
    for (axis, skewness) in axes.iter_mut().zip(&skewness) {
        if *skewness < 0.0 {
            *axis = -*axis;
        }
    }
    if axes[0].cross(&axes[1]).dot(&axes[2]) < 0.0 {
        let least = skewness.iamin();
        axes[least] = -axes[least];
    }
    axes.map(|axis| [0, 1, 2].map(|i| axis[i] as f32))
}

/// `A B`.
pub fn compose(a: &Rotation, b: &Rotation) -> Rotation {
    a.map(|row| rotate_inverse(b, row))
}

/// `R p`.
pub fn rotate(rotation: &Rotation, point: Point) -> Point {
    rotation.map(|row| row[0] * point[0] + row[1] * point[1] + row[2] * point[2])
}

/// `Rᵀ p`.
pub fn rotate_inverse(rotation: &Rotation, point: Point) -> Point {
    std::array::from_fn(|axis| (0..3).map(|row| rotation[row][axis] * point[row]).sum())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The surface of an ellipsoid that is thicker on one side along each axis.
    fn lopsided(i: u32) -> Point {
        let unit = |k: u32| f64::from(i.wrapping_mul(k) % 9973) / 9973.0;
        let (z, angle) = (2.0 * unit(7919) - 1.0, std::f64::consts::TAU * unit(4421));
        let ring = (1.0 - z * z).sqrt();
        let stretched = |v: f64, length: f64| (length * (v + 0.3 * v * v)) as f32 + 5.0;
        [stretched(ring * angle.cos(), 1.0), stretched(ring * angle.sin(), 0.4), stretched(z, 0.7)]
    }

    #[test]
    fn principal_axes_turn_with_the_cloud_and_fall_along_x_y_z() {
        let cloud: Vec<Point> = (0..3000).map(lopsided).collect();
        let axes_and_points = |rotation: &Rotation| {
            let cloud: Vec<Point> = cloud.iter().map(|&p| rotate(rotation, p)).collect();
            let mean = std::array::from_fn(|axis| cloud.iter().map(|p| p[axis]).sum::<f32>() / cloud.len() as f32);
            let axes = principal_axes(&cloud, mean);
            let along: Vec<Point> = cloud.iter().map(|p| rotate(&axes, [0, 1, 2].map(|i| p[i] - mean[i]))).collect();
            (axes, along)
        };
        let (axes, along) = axes_and_points(&IDENTITY);
        let moment =
            |power: i32| [0, 1, 2].map(|axis| along.iter().map(|p| f64::from(p[axis]).powi(power)).sum::<f64>());
        assert!(moment(2).is_sorted_by(|a, b| a > b), "{:?}", moment(2));
        let positive = moment(3).iter().filter(|sum| **sum > 0.0).count();
        assert!(positive >= 2, "{:?}", moment(3));
        for rotation in super_fibonacci(9).skip(1) {
            let (rotated_axes, rotated_along) = axes_and_points(&rotation);
            let product = compose(&rotated_axes, &rotation);
            assert!(axes.as_flattened().iter().zip(product.as_flattened()).all(|(a, b)| (a - b).abs() < 1e-3));
            for (a, b) in along.iter().zip(&rotated_along) {
                assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-2), "{a:?} {b:?}");
            }
        }
    }

    #[test]
    fn principal_axes_of_lines_and_planes_are_rotations() {
        let line: Vec<Point> = (0..9).map(|i| [i as f32, 0.0, 0.0]).collect();
        let plane: Vec<Point> = (0..81).map(|i| [(i % 9) as f32, 3.0, (i / 9) as f32]).collect();
        for cloud in [line, plane, vec![[0.0; 3], [1e-15, 0.0, 0.0]], vec![[1e15, 0.0, 0.0], [0.0; 3]]] {
            let axes = principal_axes(&cloud, cloud[cloud.len() / 2]);
            let back = compose(&axes, &[0, 1, 2].map(|column| axes.map(|row| row[column])));
            assert!(back.as_flattened().iter().zip(IDENTITY.as_flattened()).all(|(a, b)| (a - b).abs() < 1e-6));
            let [x, y, z] = axes.map(Vector3::from);
            assert!((x.cross(&y).dot(&z) - 1.0).abs() < 1e-6, "{axes:?}");
        }
    }

    #[test]
    fn rotations_are_rotations_and_far_apart() {
        for number in [1, 2, 8, 32] {
            let rotations: Vec<Rotation> = super_fibonacci(number).collect();
            assert_eq!(rotations.len(), number);
            for (i, a) in rotations.iter().enumerate() {
                let point = [0.3, -0.5, 0.7];
                let back = rotate_inverse(a, rotate(a, point));
                assert!(point.iter().zip(back).all(|(p, b)| (p - b).abs() < 1e-6), "{back:?}");
                for b in &rotations[..i] {
                    let trace: f32 = a.as_flattened().iter().zip(b.as_flattened()).map(|(a, b)| a * b).sum();
                    let angle = ((trace - 1.0) / 2.0).clamp(-1.0, 1.0).acos();
                    assert!(angle > 0.9 * (8.0 / number as f32).cbrt().min(1.5), "{number}: {angle}");
                }
            }
        }
    }
}

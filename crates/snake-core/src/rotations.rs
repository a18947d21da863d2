//! A fixed set of evenly distributed rotations.

use crate::points::Point;

/// A rotation matrix, row by row.
pub(crate) type Rotation = [Point; 3];

/// `number` evenly distributed rotations: super-Fibonacci spirals (Alexa, CVPR 2022), rotated so that the first is the
/// identity.
pub(crate) fn super_fibonacci(number: usize) -> Vec<Rotation> {
    let quaternion = |i: usize| {
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
    let matrix = |i: usize| {
        let rotation = (quaternion(i) * back).to_rotation_matrix();
        std::array::from_fn(|row| std::array::from_fn(|column| rotation[(row, column)] as f32))
    };
    // The identity is exact, without rounding.
    let none = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    std::iter::once(none).chain((1..number).map(matrix)).collect()
}

/// `R p`.
pub(crate) fn rotate(rotation: &Rotation, point: Point) -> Point {
    rotation.map(|row| row[0] * point[0] + row[1] * point[1] + row[2] * point[2])
}

/// `Rᵀ p`.
pub(crate) fn rotate_inverse(rotation: &Rotation, point: Point) -> Point {
    std::array::from_fn(|axis| (0..3).map(|row| rotation[row][axis] * point[row]).sum())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rotations_are_rotations_and_far_apart() {
        for number in [1, 2, 8, 32] {
            let rotations = super_fibonacci(number);
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

//! Names of the motions that an overlap leaves open.

use nalgebra::{Matrix3xX, Matrix6xX};

use snake_geometry::Vector;

/// A motion with a smaller rotation part is named a translation. Unit: length of the rotation part. Set by hand.
const NO_ROTATION: f64 = 0.1;

/// The motions in words, such as "translation along (1.00, 0.00, 0.00), any rotation"; empty without any. The columns
/// are orthonormal: a rotation about the overlap's middle, scaled to lengths by its extent, and then a translation.
pub(super) fn names(open: &Matrix6xX<f64>) -> String {
    if open.ncols() == 0 {
        return String::new();
    }
    let rotations: Matrix3xX<f64> = open.fixed_rows::<3>(0).into_owned();
    let combinations = (rotations.transpose() * &rotations).symmetric_eigen();
    let (mut turns, mut slides) = (Vec::new(), Vec::new());
    for (combination, squared) in combinations.eigenvectors.column_iter().zip(combinations.eigenvalues.iter()) {
        let motion = open * combination;
        let (turn, slide): (Vector, Vector) = (motion.fixed_rows::<3>(0).into(), motion.fixed_rows::<3>(3).into());
        if *squared < NO_ROTATION.powi(2) {
            slides.push(slide.normalize());
        } else {
            turns.push(turn.normalize());
        }
    }
    let slides = name("translation", "along", "across", &slides);
    let turns = name("rotation", "about", "about all axes across", &turns);
    [slides, turns].into_iter().flatten().collect::<Vec<_>>().join(", ")
}

/// One direction is named by itself, two by the direction perpendicular to both.
fn name(what: &str, one: &str, two: &str, directions: &[Vector]) -> Option<String> {
    match directions {
        [] => None,
        [direction] => Some(format!("{what} {one} {}", axis_name(direction))),
        [first, second] => Some(format!("{what} {two} {}", axis_name(&first.cross(second).normalize()))),
        _ => Some(format!("any {what}")),
    }
}

/// The name of an axis. Its sign means nothing, so the largest component is made positive.
pub(super) fn axis_name(direction: &Vector) -> String {
    let direction = direction * direction[direction.iamax()].signum();
    // Adding zero removes the sign of zeros.
    let [x, y, z] = [0, 1, 2].map(|i| (100.0 * direction[i]).round() / 100.0 + 0.0);
    format!("({x:.2}, {y:.2}, {z:.2})")
}

//! The rule: options that only one kind of model has name it, and else the cloud decides.

use serde_json::{Map, Value};

use super::few_voxels;
use crate::Builtin;
use crate::cloud::{NUM_SIGNS, UsedCloud};
use snake_geometry::Point;

/// The weight of each of [`scene_signs`](crate::scene_signs), of the square of each, and that of one.
const WEIGHTS: ([f64; NUM_SIGNS], [f64; NUM_SIGNS], f64) = (
    [-123.3, 8.272, 1.518, 0.4191, -0.2706, 3.505, 3.414, -4.734],
    [-169.3, -4.197, -0.1518, -3.115, -0.04307, 0.5688, 0.5446, -265.7],
    -6.797,
);

/// Scores within this of 0 are doubtful: the log-odds that a cloud is a scene.
const DOUBT: f64 = 0.5;

/// Clouds whose second scene sign, the breadth of surroundings, is at most this are wires or curves, never scenes.
const CURVE: f64 = 0.2;

/// The given option that only one kind of model has, and the built-in model of that kind. An option that is off does not
/// count.
pub(super) fn by_options(values: &Map<String, Value>) -> Option<(&'static str, Builtin)> {
    let is_given = |name: &&str| values.get(*name).is_some_and(|value| !value.is_null());
    let is_nonzero = |value: &Value| value.as_f64() != Some(0.0);
    if values.get("voxel_size").is_some_and(|size| !size.is_null() && is_nonzero(size)) {
        return Some(("voxel_size", Builtin::Scenes));
    }
    if let Some(name) = ["preset", "normalization"].into_iter().find(is_given) {
        return Some((name, Builtin::Compact));
    }
    let rotations = values.get("rotations").and_then(Value::as_u64);
    rotations.filter(|&number| number > 1).map(|_| ("rotations", Builtin::Compact))
}

/// The built-in model for a cloud.
pub(super) fn by_cloud(cloud: &UsedCloud) -> Builtin {
    let is_scene = cloud.is_sweep() || scene_score(cloud) > 0.0 || few_voxels::note(cloud).is_some();
    if is_scene { Builtin::Scenes } else { Builtin::Compact }
}

/// The note on a cloud of which an object's voxels show little, and on one that looks about as much like a scene as like an object.
pub(super) fn note_of_doubt(cloud: &UsedCloud) -> Option<String> {
    if let Some(note) = few_voxels::note(cloud) {
        return Some(note);
    }
    if cloud.is_sweep() || scene_score(cloud).abs() > DOUBT {
        return None;
    }
    let (kind, other, named) = match by_cloud(cloud) {
        Builtin::Scenes => ("a scene", "one object", Builtin::Compact),
        Builtin::Compact => ("one object", "a scene", Builtin::Scenes),
    };
    Some(format!(
        "the cloud is taken for {kind}, though not clearly; if it is {other}, name the model `{}`",
        named.name()
    ))
}

/// By how much a cloud looks like a scene and not like one object: the log-odds, negative for objects.
fn scene_score(cloud: &UsedCloud) -> f64 {
    let Some(signs) = cloud.scene_signs() else { return f64::NEG_INFINITY };
    let [_, broad, ..] = &signs;
    if *broad <= CURVE {
        return f64::NEG_INFINITY;
    }
    let (linear, square, constant) = &WEIGHTS;
    let weighed = signs.iter().zip(linear).zip(square).map(|((sign, linear), square)| sign * (linear + sign * square));
    weighed.sum::<f64>() + constant
}

impl Builtin {
    /// The model for a cloud `(N, 3)` in any unit: [`Builtin::Scenes`] if it looks like the sweep of a sensor in its midst, or
    /// like a room, a street or terrain by its [`scene_signs`](crate::scene_signs); else [`Builtin::Compact`]. A
    /// [`Chooser`](crate::Chooser) also looks at the options.
    pub fn for_cloud(points: &[Point]) -> Self {
        UsedCloud::new(points).map_or(Self::Compact, |cloud| by_cloud(&cloud))
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    fn is_scene(points: &[Point]) -> bool {
        scene_score(&UsedCloud::new(points).unwrap()) > 0.0
    }

    /// Points on a box about the origin, of any half size.
    fn cuboid(number: usize, half: [f32; 3]) -> impl Iterator<Item = Point> {
        let at = |i: usize, step: f32| (i as f32 * step).fract() * 2.0 - 1.0;
        (0..number).map(move |i| {
            let mut point = [at(i, 0.618_034), at(i, 0.754_878), at(i, 0.569_84)];
            point[i % 3] = if i / 3 % 2 == 0 { 1.0 } else { -1.0 };
            std::array::from_fn(|axis| point[axis] * half[axis])
        })
    }

    /// A floor, two walls and some boxes on the floor, in a unit and rotated about z.
    pub(in crate::choose) fn corner_of_a_room(unit: f32, angle: f32) -> Vec<Point> {
        let walls = cuboid(9000, [2.0, 1.5, 1.2]).filter(|p| p[0] > -1.99 && p[1] < 1.49 && p[2] < 1.19);
        let boxes = (0..6).flat_map(|i| {
            let half = [0.2 + 0.05 * i as f32, 0.2, 0.3];
            cuboid(300, half).map(move |p| [p[0] - 1.2 + 0.5 * i as f32, p[1] - 0.8 + 0.3 * i as f32, p[2] - 0.9])
        });
        let (sin, cos) = angle.sin_cos();
        let rotated = |p: Point| [cos * p[0] - sin * p[1], sin * p[0] + cos * p[1], p[2]].map(|v| v * unit);
        walls.chain(boxes).map(rotated).collect()
    }

    #[test]
    fn room_is_a_scene_in_any_unit_and_orientation_and_objects_are_not() {
        for (unit, angle) in [(1.0, 0.0), (1000.0, 0.0), (1.0, 0.7), (0.01, 2.0)] {
            assert!(is_scene(&corner_of_a_room(unit, angle)), "{unit} {angle}");
        }
        for half in [[1.0, 1.0, 1.0], [1.0, 0.4, 0.3], [1.0, 1.0, 0.1]] {
            assert!(!is_scene(&cuboid(4000, half).collect::<Vec<_>>()), "{half:?}");
        }
        let knot = |i: usize| {
            let (u, v) = (0.1 * i as f32, 0.7 * i as f32);
            [(1.0 + 0.3 * v.cos()) * u.cos(), (1.0 + 0.3 * v.cos()) * u.sin(), 0.3 * v.sin()]
        };
        assert!(!is_scene(&(0..4000).map(knot).collect::<Vec<_>>()));
    }
}

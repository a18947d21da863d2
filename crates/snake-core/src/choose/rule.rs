//! The rule: options that only one kind of model has name it, and else the cloud decides.

use serde_json::{Map, Value};

use super::few_voxels;
use crate::Builtin;
use crate::cloud::{NUM_SIGNS, UsedCloud, scene_signs};
use snake_geometry::Point;

/// The mean of each of [`scene_signs`], and its deviation, in units of which it is weighed up to [`LIMIT`].
const MEANS: [f64; NUM_SIGNS] =
    [0.02078, 0.1099, 0.2712, 2.061, 0.1927, 0.9403, 0.09717, 0.02572, 0.006575, 0.02325, 0.2284, -0.06675];
const DEVIATIONS: [f64; NUM_SIGNS] =
    [0.02868, 0.06186, 0.06545, 0.5759, 0.1816, 0.1304, 0.1279, 0.02794, 0.02525, 0.1018, 0.1259, 0.1364];
const LIMIT: f64 = 3.0;

/// The weights of a quadratic form: of the scaled signs, of their products in pairs and squares, and the constant.
const WEIGHTS: [f64; NUM_SIGNS + NUM_SIGNS * (NUM_SIGNS + 1) / 2 + 1] = [
    -0.467, 1.072, 0.5349, 0.6373, 0.8527, -0.5983, 0.8783, -0.7293, -1.417, -0.7845, 1.621, 0.7234, -0.4249, 0.1723,
    -1.392, -0.7696, -0.2556, -1.063, -0.2194, 0.309, 0.1336, 0.06973, 0.856, -0.464, 0.03062, 0.2806, -0.3571,
    -0.08037, -0.1864, 0.8376, -0.4605, -0.07088, -0.2653, 1.354, -0.02165, -0.2731, -0.4026, -0.1721, -0.4937, 0.4746,
    -0.1895, 0.3754, 0.2626, -0.38, -1.025, -0.1173, -1.024, -0.7964, -0.2244, 0.002406, -0.2077, -0.05789, -0.6532,
    0.1006, 0.1483, -0.3413, -0.2098, 0.1567, -0.1353, 0.2448, -0.1612, 0.6648, -0.1477, -0.2958, 1.057, -0.187,
    -0.04945, -0.292, 0.09254, -0.1493, 0.4302, -0.1862, -0.4929, -0.5269, -0.4543, 0.1647, -0.04063, -0.5501, -0.225,
    0.5045, 0.3692, -0.06265, 0.8872, -0.09023, -0.562, 0.3628, -0.5487, 0.3565, -0.04822, -0.9055, 1.641,
];

/// Scores within this of 0 are doubtful: the log-odds that a cloud is a scene.
const DOUBT: f64 = 1.5;

/// Clouds whose surroundings are at most this broad are wires or curves, never scenes.
const CURVE: f64 = 0.15;

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

/// The built-in model for a cloud, and a note if it looks about as much like a scene as like an object. `viewpoint` is where its
/// sensor may have stood.
pub(super) fn by_cloud(cloud: &UsedCloud, viewpoint: [f64; 3]) -> (Builtin, Option<String>) {
    if let Some(note) = few_voxels::note(cloud) {
        return (Builtin::Scenes, Some(note));
    }
    let score = if cloud.is_sweep() { f64::INFINITY } else { scene_score(cloud.points(), viewpoint) };
    let (which, kind, named, other) = if score > 0.0 {
        (Builtin::Scenes, "a scene", Builtin::Compact, "one object")
    } else {
        (Builtin::Compact, "one object", Builtin::Scenes, "a scene")
    };
    let note = || {
        let name = named.name();
        format!("the cloud is taken for {kind}, though not clearly; if it is {other}, name the model `{name}`")
    };
    (which, (score.abs() <= DOUBT).then(note))
}

/// By how much a cloud looks like a scene and not like one object: the log-odds, negative for objects.
fn scene_score(points: &[Point], viewpoint: [f64; 3]) -> f64 {
    let Some(signs) = scene_signs(points, viewpoint) else { return f64::NEG_INFINITY };
    let [_, _, broad, ..] = &signs;
    if *broad <= CURVE {
        return f64::NEG_INFINITY;
    }
    let scaled: [f64; NUM_SIGNS] =
        std::array::from_fn(|i| ((signs[i] - MEANS[i]) / DEVIATIONS[i]).clamp(-LIMIT, LIMIT));
    let products = (0..NUM_SIGNS).flat_map(|i| (0..=i).map(move |j| scaled[i] * scaled[j]));
    scaled.into_iter().chain(products).chain([1.0]).zip(WEIGHTS).map(|(column, weight)| column * weight).sum()
}

impl Builtin {
    /// The model for a cloud `(N, 3)` in any unit: [`Builtin::Scenes`] if it looks like the sweep of a sensor in its midst, or
    /// like a room, a street or terrain by its [`scene_signs`]; else [`Builtin::Compact`]. A [`Chooser`](crate::Chooser) also
    /// looks at the options.
    pub fn for_cloud(points: &[Point]) -> Self {
        UsedCloud::new(points).map_or(Self::Compact, |cloud| by_cloud(&cloud, [0.0; 3]).0)
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    fn is_scene(points: &[Point]) -> bool {
        scene_score(points, [0.0; 3]) > 0.0
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

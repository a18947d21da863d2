//! The rule: options that only one kind of model has name it, and else the cloud decides.

use serde_json::{Map, Value};

use super::few_voxels;
use crate::Builtin;
use crate::cloud::{NUM_SIGNS, UsedCloud, WITHIN, scene_signs};
use snake_geometry::{Point, Sensor};

/// The mean of each of [`scene_signs`], and its deviation, in units of which it is weighed up to [`LIMIT`].
const MEANS: [f64; NUM_SIGNS] =
    [0.02159, 0.1083, 0.2748, 2.082, 0.1932, 0.9489, 0.09218, 0.02425, 0.003368, 0.02161, 0.2176, -0.06813, 0.4428];
const DEVIATIONS: [f64; NUM_SIGNS] =
    [0.02993, 0.06144, 0.0686, 0.5796, 0.1827, 0.1192, 0.1286, 0.02798, 0.0261, 0.1006, 0.1292, 0.1426, 0.2653];
const LIMIT: f64 = 3.0;

/// The weights of a quadratic form: of the scaled signs, of their products in pairs and squares, and the constant.
const WEIGHTS: [f64; NUM_SIGNS + NUM_SIGNS * (NUM_SIGNS + 1) / 2 + 1] = [
    0.2871, 0.8591, 0.8173, 0.8385, 1.119, -0.9947, 0.9922, -0.5491, -0.6741, -1.009, 1.236, 0.6048, -0.1084, -1.084,
    0.3683, -1.721, -0.5726, 0.2323, -0.906, -0.2129, 0.6264, 0.6325, -1.159, -0.232, -0.5724, 0.4259, 0.1799, -0.6873,
    -0.7829, 0.1203, 0.286, 0.08133, 0.161, -0.413, 1.576, 0.001549, 0.4781, -0.9573, -0.101, -0.2167, 0.6102, -0.1817,
    0.3883, 0.1947, 0.03756, -1.227, 0.1343, -1.133, -0.5962, 0.147, -0.1679, -0.0328, -0.3693, -0.8669, 0.137,
    -0.2119, 0.01995, -0.4443, -0.3947, 0.2063, 0.08034, 0.2991, 0.4637, 0.4743, -0.1327, 0.3454, 0.2206, -0.2169,
    -0.9427, 0.5176, -0.721, -0.6068, 0.7392, -0.3206, -0.4774, 0.2478, -0.09463, 0.1092, -0.874, 0.3634, -0.09584,
    0.4624, 0.08028, 0.3686, -0.4662, -0.3979, 0.2975, 0.3864, -0.2089, -0.155, -0.5597, -0.2808, 0.4167, 0.04533,
    0.6474, -0.1248, 0.3697, -0.0137, -0.7966, 0.01128, -0.1433, 1.231, 0.03809, -0.7209, 2.593,
];

/// Scores within this of 0 are doubtful: the log-odds that a cloud is a scene.
const DOUBT: f64 = 1.5;

/// In doubt, the sensor decides if it can be found: a cloud that was seen from within is a scene, and one that was seen from more
/// than so many radii away is one object. Depth frames of rooms have 1.4 to 2.2.
const APART: f64 = 3.0;

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
    let mut score = if cloud.is_sweep() { f64::INFINITY } else { scene_score(cloud.points(), viewpoint) };
    if score.abs() <= DOUBT {
        let away = Sensor::find(cloud.points()).map(|sensor| sensor.radii_away(cloud.points()));
        score = match away {
            Some(away) if away < WITHIN => f64::INFINITY,
            Some(away) if away > APART => -score.abs(),
            _ => score,
        };
    }
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
    fn an_empty_room_is_a_scene_if_its_sensor_is_found_within() {
        let beam = |i: usize| {
            let (azimuth, elevation) = ((i / 60) as f64 * 0.0314, ((i % 60) as f64 * 2.5 - 60.0).to_radians());
            let direction =
                [azimuth.cos() * elevation.cos(), azimuth.sin() * elevation.cos(), elevation.sin()].map(|v| v + 1e-9);
            let [low, high] = [[-2.6, -1.7, -1.4], [3.1, 2.3, 1.3]];
            let walls = (0..3).map(|axis| if direction[axis] > 0.0 { high[axis] } else { low[axis] } / direction[axis]);
            let range = walls.fold(f64::INFINITY, f64::min);
            direction.map(|v| (v * range) as f32)
        };
        for offset in [0.0, 40.0] {
            let room: Vec<Point> = (0..12_000).map(|i| beam(i).map(|v| v + offset)).collect();
            assert!(!is_scene(&room));
            assert_eq!(Builtin::for_cloud(&room), Builtin::Scenes, "{offset}");
        }
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

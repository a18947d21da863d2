//! The rule: options that only one kind of model has name it, and else the cloud decides.

use serde_json::{Map, Value};

use super::few_voxels;
use super::network::Networks;
use crate::Builtin;
use crate::cloud::{UsedCloud, is_seen_from_within, scene_signs};
use snake_geometry::{Point, Sensor};

/// Scores within this of 0 are doubtful: the log-odds that a cloud is a scene.
const DOUBT: f64 = 1.5;

/// Scores within this of 0 ask for the sensor.
const ASKED: f64 = 3.0;

/// A cloud whose sensor is found within the first many radii of its middle is a scene, and one that was seen from beyond the second
/// many is one object. Rooms in the view of a depth camera have 1.4 to 3.6, and most views of objects more than 3.3.
const AWAY: [f64; 2] = [3.2, 5.0];

/// Clouds whose surroundings are at most this broad are wires or curves, never scenes.
const CURVE: f64 = 0.15;

/// Where a plane holds more than this share of the patches, the points do not tell a wall from a plate.
const ONE_PLANE: f64 = 0.97;

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

/// The built-in model for a cloud, and a note if it looks about as much like a scene as like an object.
pub(super) fn by_cloud(cloud: &UsedCloud) -> (Builtin, Option<String>) {
    if let Some(note) = few_voxels::note(cloud) {
        return (Builtin::Scenes, Some(note));
    }
    let score = if cloud.is_sweep() { f64::INFINITY } else { scene_score(cloud.points()) };
    let score = with_sensor(score, || Some(Sensor::find(cloud.points())?.radii_away(cloud.points())));
    // A sweep of a small yard has no points far beyond, and things on flat ground look like an object.
    let score = if score < 0.0 && is_seen_from_within(cloud.points()) { f64::INFINITY } else { score };
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

/// The score of a cloud, if it is doubtful with what the distance of its sensor from the middle says, in radii.
fn with_sensor(score: f64, away: impl FnOnce() -> Option<f64>) -> f64 {
    if score.abs() > ASKED {
        return score;
    }
    match away() {
        Some(away) if away < AWAY[0] => f64::INFINITY,
        Some(away) if away > AWAY[1] => f64::NEG_INFINITY,
        _ => score,
    }
}

/// By how much a cloud looks like a scene and not like one object: the log-odds, negative for objects.
fn scene_score(points: &[Point]) -> f64 {
    let Some(signs) = scene_signs(points) else { return f64::NEG_INFINITY };
    let [_, _, broad, .., on_plane, _, _] = &signs;
    if *broad <= CURVE {
        return f64::NEG_INFINITY;
    }
    let score = Networks::fitted().score(&signs);
    if *on_plane > ONE_PLANE { score.clamp(-DOUBT, DOUBT) } else { score }
}

impl Builtin {
    /// The model for a cloud `(N, 3)` in any unit: [`Builtin::Scenes`] if it looks like the sweep of a sensor in its midst, or
    /// like a room, a street or terrain by its [`scene_signs`]; else [`Builtin::Compact`]. A [`Chooser`](crate::Chooser) also
    /// looks at the options.
    pub fn for_cloud(points: &[Point]) -> Self {
        UsedCloud::new(points).map_or(Self::Compact, |cloud| by_cloud(&cloud).0)
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    fn is_scene(points: &[Point]) -> bool {
        scene_score(points) > 0.0
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
    fn the_sensor_decides_in_doubt() {
        for (score, away, is_scene) in [(-2.9, 3.1, true), (2.9, 5.1, false), (-0.1, 4.0, false), (0.1, 4.0, true)] {
            assert_eq!(with_sensor(score, || Some(away)) > 0.0, is_scene, "{score} {away}");
            assert_eq!(with_sensor(score, || None), score);
        }
        assert_eq!([-3.1, 3.1].map(|score| with_sensor(score, || unreachable!())), [-3.1, 3.1]);
    }

    #[test]
    fn a_plane_may_be_a_wall_or_a_plate() {
        let inner = |p: &Point| p[0].abs() < 1.0 && p[1].abs() < 1.0;
        let floor: Vec<Point> = cuboid(18000, [1.0; 3]).filter(inner).map(|p| [p[0], p[1], 0.002 * p[2]]).collect();
        assert_eq!(scene_score(&floor), -DOUBT);
    }

    #[test]
    fn an_empty_room_is_a_scene_in_any_frame() {
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

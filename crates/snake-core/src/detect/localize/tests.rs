//! Localization on corners, edges, planes and plates at known positions.

use nalgebra::{Matrix3, Rotation3};

use super::*;

/// A number in −0.5 to 0.5 that looks random.
fn noise(i: u32, stream: u32) -> f32 {
    let mixed = (i.wrapping_mul(0x9e37_79b9) ^ stream.wrapping_mul(0x85eb_ca6b)).wrapping_mul(0xc2b2_ae35);
    ((mixed ^ mixed >> 15).wrapping_mul(0x2c1b_3c6d) >> 8) as f32 / (1 << 24) as f32 - 0.5
}

/// Points of the first `number` of three planes that meet at the origin, each covering the positive quadrant of side 1.
fn corner(number: u32, spacing: f32, sigma: f32) -> Vec<Point> {
    let side = (1.0 / spacing) as u32;
    let at = |i: u32| {
        let (u, v) = ((i % side) as f32 * spacing, (i / side % side) as f32 * spacing);
        let flat = match i / (side * side) {
            0 => [u, v, 0.0],
            1 => [0.0, u, v],
            _ => [v, 0.0, u],
        };
        // The sum of four has nearly a normal distribution.
        [0, 1, 2].map(|axis| flat[axis as usize] + sigma * 1.73 * (0..4).map(|k| noise(i, 4 * axis + k)).sum::<f32>())
    };
    (0..number * side * side).map(at).collect()
}

fn localized(points: &[Point], start: Point) -> Place {
    let anchors = Anchors::of(points, SIDES[0] * 0.25, false, |point| point).unwrap().0;
    localize(&Patches::new(points, &anchors, 0.25).unwrap(), &[start], &[1.0])[0]
}

fn distance(a: Point, b: Point) -> f32 {
    (vector(a) - vector(b)).norm() as f32
}

#[test]
fn sparse_points_of_a_scene_localize_faint_keypoints_only() {
    let (points, start) = (corner(3, 0.05, 0.002), [0.05, 0.03, 0.04]);
    let anchors = Anchors::of(&points, SIDES[0] * 0.25, true, |point| point).unwrap().0;
    let patches = Patches::new(&points, &anchors, 0.25).unwrap();
    let [faint, salient] = [0.4, 0.9].map(|score| localize(&patches, &[start], &[score])[0]);
    assert!(distance(faint.position, [0.0; 3]) < 0.02 && faint.corner == 0.0, "{faint:?}");
    assert_eq!(salient.position, start);
}

#[test]
fn a_corner_with_noise_is_found_within_its_covariance() {
    let (mut inside, mut total) = (0, 0);
    for (spacing, sigma) in [(0.01, 0.003), (0.02, 0.003), (0.02, 0.01), (0.04, 0.003), (0.04, 0.01)] {
        let points = corner(3, spacing, sigma);
        for i in 0..20 {
            let start = [noise(i, 91), noise(i, 92), noise(i, 93)].map(|v| 0.25 * v);
            let place = localized(&points, start);
            let error = vector(place.position);
            // With much noise, the place is partly that of the field.
            let is_known = sigma > 0.005 || place.corner > 0.1 && error.norm() < 2.0 * f64::from(sigma + 0.2 * spacing);
            assert!(is_known && place.corner > 0.0, "{spacing} {sigma}: {error}");
            assert!(distance(place.position, start) <= 0.25 * MAX_GROWTH, "{place:?}");
            let covariance = Matrix3::from_fn(|i, j| f64::from(place.covariance.rows()[i][j]));
            // 7.81 is the 95 % point of χ² with three degrees of freedom.
            inside += u32::from(error.dot(&(covariance.try_inverse().unwrap() * error)) < 7.81);
            total += 1;
        }
    }
    assert!(f64::from(inside) >= 0.95 * f64::from(total), "{inside} of {total}");
}

#[test]
fn an_edge_leaves_one_direction_open_and_a_plane_two() {
    let open = |place: &Place| {
        let rows = place.covariance.rows();
        (0..3).filter(|&axis| rows[axis][axis].is_infinite()).count()
    };
    let edge = localized(&corner(2, 0.02, 0.003), [0.03, 0.5, 0.04]);
    assert!(open(&edge) == 1 && edge.corner < OPEN as f32, "{edge:?}");
    assert!(distance(edge.position, [0.0, 0.5, 0.0]) < 0.01, "{edge:?}");
    let plane = localized(&corner(1, 0.02, 0.003), [0.5, 0.5, 0.05]);
    assert!(open(&plane) == 2 && plane.corner < OPEN as f32, "{plane:?}");
    assert!(distance(plane.position, [0.5, 0.5, 0.0]) < 0.01, "{plane:?}");
    let nothing = localized(&corner(1, 0.02, 0.003), [0.5, 0.5, 0.9]);
    assert_eq!(Place { is_wall: false, ..nothing }, Place::unknown([0.5, 0.5, 0.9]));
}

#[test]
fn walls_with_noise_and_places_along_edges_are_one_of_many_and_corners_and_boards_are_not() {
    let is_one_of_many = |points: &[Point], start| {
        let anchors = Anchors::of(points, SIDES[0] * 0.25, true, |point| point).unwrap().0;
        localize(&Patches::new(points, &anchors, 0.25).unwrap(), &[start], &[1.0])[0].is_one_of_many(0.05)
    };
    for (planes, sigma, start, expected) in [
        (1, 0.003, [0.5, 0.5, 0.03], true),
        (1, 0.03, [0.5, 0.5, 0.03], true),
        (1, 0.05, [0.5, 0.5, 0.03], true),
        (1, 0.09, [0.5, 0.5, 0.03], true),
        (2, 0.003, [0.03, 0.5, 0.04], true),
        (3, 0.003, [0.03, 0.02, 0.04], false),
        (3, 0.05, [0.03, 0.02, 0.04], false),
    ] {
        assert_eq!(is_one_of_many(&corner(planes, 0.01, sigma), start), expected, "{planes} {sigma}");
    }
    assert!(is_one_of_many(&corner(1, 0.2, 0.003), [0.5, 0.5, 0.01]), "five points are near");
    let beside_floor = |[x, y, z]: Point| [[x, y, z], [x + 1.05, y, 0.02 * z]];
    let noisy: Vec<Point> = corner(1, 0.01, 0.09).into_iter().flat_map(beside_floor).collect();
    assert!(is_one_of_many(&noisy, [0.5, 0.5, 0.03]), "noise beside a quiet floor");
    let side = corner(1, 0.01, 0.003);
    let board: Vec<Point> = side.iter().copied().chain(side.iter().map(|[x, y, z]| [*x, *y, z + 0.07])).collect();
    assert!(!is_one_of_many(&board, [0.03, 0.02, 0.03]));
}

#[test]
fn a_thin_plate_keeps_its_sides_apart() {
    // The plate lies at different heights relative to the borders of cells.
    for low in (0..20).map(|i| i as f32 * 0.006) {
        let plate = corner(1, 0.02, 0.002).into_iter().flat_map(|[x, y, z]| [[x, y, z + low], [x, y, z + low + 0.1]]);
        let plate: Vec<Point> = plate.collect();
        for height in [low, low + 0.1] {
            let place = localized(&plate, [0.5, 0.5, height]);
            assert!((place.position[2] - height).abs() < 0.02, "{place:?}");
        }
    }
}

#[test]
fn points_as_sparse_as_cells_determine_nothing() {
    let start = [0.06, 0.05, -0.04];
    for (spacing, is_known) in [(0.052, false), (0.02, true)] {
        let points = corner(3, spacing, 0.003);
        let anchors = Anchors::of(&points, SIDES[0] * 0.25, true, |point| point).unwrap().0;
        let places = localize(&Patches::new(&points, &anchors, 0.25).unwrap(), &[start], &[1.0]);
        assert_eq!(places[0].covariance != Covariance::UNKNOWN, is_known, "{spacing}");
        assert_ne!(localized(&points, start).covariance, Covariance::UNKNOWN);
    }
}

#[test]
fn the_deviations_are_those_of_the_planes_and_the_field_bounds_the_covariance() {
    let places = [0.02, 0.08].map(|sigma| localized(&corner(3, 0.02, sigma), [0.06, 0.05, -0.04]));
    let [low, high] = places.map(|place| place.deviations.into_iter().fold(0.0, f32::max));
    let [narrow, wide] = places.map(|place| place.covariance.deviation());
    assert!(high > 3.0 * low && wide < 2.0 * narrow, "{low} {high} {narrow} {wide}");
}

#[test]
fn a_point_that_is_stored_several_times_was_measured_once() {
    let encoded = |points: &[Point]| {
        crate::Model::builtin(crate::Builtin::Scenes).encode(points, &crate::EncodeOptions::default()).unwrap()
    };
    let points = corner(3, 0.02, 0.003);
    let fields = [encoded(&points), encoded(&points.repeat(3))];
    let [once, thrice] = fields.each_ref().map(|field| Surroundings::of(field, Preference::Salient).unwrap());
    assert_eq!((&once.points, &once.anchors.counts), (&thrice.points, &thrice.anchors.counts));
}

#[test]
fn stray_points_do_not_pull() {
    let clean = corner(3, 0.02, 0.003);
    let stray = (0..clean.len() as u32 / 20).map(|i| [noise(i, 71), noise(i, 72), noise(i, 73)].map(|v| v + 0.3));
    let place = localized(&clean.iter().copied().chain(stray).collect::<Vec<_>>(), [0.06, 0.05, -0.04]);
    assert!(distance(place.position, [0.0; 3]) < 0.015, "{place:?}");
}

#[test]
fn rotation_order_and_far_coordinates_change_nothing() {
    let points = corner(3, 0.02, 0.003);
    let start = [0.06, 0.05, -0.04];
    let place = localized(&points, start);
    let reversed = localized(&points.iter().rev().copied().collect::<Vec<_>>(), start);
    assert!(distance(reversed.position, place.position) < 1e-6, "{reversed:?} {place:?}");
    for (angles, offset) in [([0.3, -1.2, 2.5], [0.0; 3]), ([1.0, 0.2, -0.7], [400.0, -700.0, 90.0])] {
        let turn = Rotation3::from_euler_angles(angles[0], angles[1], angles[2]);
        let moved = |p: &Point| -> Point { (turn * vector(*p) + Vector::from(offset)).map(|v| v as f32).into() };
        let rotated = localized(&points.iter().map(moved).collect::<Vec<_>>(), moved(&start));
        let corner = moved(&[0.0; 3]);
        assert!(distance(rotated.position, corner) < 0.012, "{rotated:?} {corner:?}");
        let [a, b] = [place, rotated].map(|place| place.covariance.deviation());
        assert!((a / b).ln().abs() < 0.7, "{a} {b}");
    }
}

#[test]
fn the_place_does_not_depend_on_points_far_away() {
    let points = corner(3, 0.02, 0.003);
    let start = [0.06, 0.05, -0.04];
    let is_near = |point: &&Point| distance(**point, start) < 0.25 * (2.0 * MAX_GROWTH + REACH);
    let near: Vec<Point> = points.iter().filter(is_near).copied().collect();
    assert!(near.len() < points.len());
    assert_eq!(localized(&near, start), localized(&points, start));
}

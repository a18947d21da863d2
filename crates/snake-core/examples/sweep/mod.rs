//! A made drive: sweeps of a laser scanner with 64 beams through a street of walls, poles and boxes.

use snake_core::Point;

/// Number of beams, from 24° below to 2° above the horizon.
const BEAMS: usize = 64;
/// Height of the scanner above the road, in metres.
const HEIGHT: f32 = 1.8;

/// One sweep `(N, 3)` in metres, in the scanner's frame, with x ahead and z up. `position` is the scanner's way along the
/// street in metres. A beam without an echo is NaN.
pub fn sweep(num_points: usize, position: f32) -> Vec<Point> {
    let steps = num_points.div_ceil(BEAMS);
    let point = |number: usize| {
        let azimuth = (number / BEAMS) as f32 / steps as f32 * std::f32::consts::TAU;
        let elevation = (-24.0 + 26.0 * (number % BEAMS) as f32 / (BEAMS - 1) as f32).to_radians();
        let direction = [elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin()];
        let range = range(direction, position);
        // Echoes scatter by some centimetres.
        let noise = (number.wrapping_mul(0x9e37_79b9) >> 8 & 0xff) as f32 / 255.0 - 0.5;
        if range < 60.0 { direction.map(|v| v * (range + 0.04 * noise)) } else { [f32::NAN; 3] }
    };
    (0..num_points).map(point).collect()
}

/// Distance along a beam to the road, the walls of the houses, or a box between them.
fn range([x, y, z]: Point, position: f32) -> f32 {
    let road = if z < 0.0 { HEIGHT / -z } else { f32::INFINITY };
    let walls = 9.0 / y.abs();
    // A box of 4 x 2 x 1.6 metres every 12 metres on both sides.
    let boxes = (-5..=5).flat_map(|number| {
        let ahead = 12.0 * number as f32 - position.rem_euclid(12.0);
        [-5.0, 5.0].map(|side| box_range([x, y, z], [ahead, side, 0.8 - HEIGHT], [2.0, 1.0, 0.8]))
    });
    boxes.fold(road.min(walls), f32::min)
}

/// Distance along a beam to a box with this centre and these half extents.
fn box_range(direction: Point, center: Point, half: Point) -> f32 {
    let (mut near, mut far) = (0.0_f32, f32::INFINITY);
    for axis in 0..3 {
        let ends = [-1.0, 1.0].map(|side| (center[axis] + side * half[axis]) / direction[axis]);
        near = near.max(ends[0].min(ends[1]));
        far = far.min(ends[0].max(ends[1]));
    }
    if near > 0.0 && near <= far { near } else { f32::INFINITY }
}

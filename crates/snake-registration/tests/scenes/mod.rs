//! Made scenes of boxes, rooms and tunnels, which rays meet.

use std::f64::consts::TAU;

use chacha20::ChaCha8Rng;
use nalgebra::{IsometryMatrix3, Vector3};
use rand::RngExt;
use snake_core::Point;

pub type Vec3 = [f64; 3];

/// The rays of a LiDAR with that many beams from `low` to `high` (radians).
pub fn lidar(beams: i32, columns: i32, low: f64, high: f64) -> Vec<Vec3> {
    let ray = |i: i32| {
        let elevation = low + f64::from(i / columns) * (high - low) / f64::from(beams - 1);
        let azimuth = f64::from(i % columns) * TAU / f64::from(columns);
        [elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin()]
    };
    (0..beams * columns).map(ray).collect()
}

/// Boxes, and rooms that are seen from inside: low and high corner. Tunnels along x have a radius
/// about y = z = 0.
#[derive(Default)]
pub struct Scene {
    pub boxes: Vec<[Vec3; 2]>,
    pub rooms: Vec<[Vec3; 2]>,
    pub tunnel: Option<f64>,
}

impl Scene {
    /// What a sensor at a pose sees within `most`, in its frame.
    pub fn scan(
        &self,
        pose: &IsometryMatrix3<f64>,
        rays: &[Vec3],
        most: f64,
        noise: f64,
        rng: &mut ChaCha8Rng,
    ) -> Vec<Point> {
        let hit = |ray: &Vec3| {
            let in_scene = pose.rotation * Vector3::from(*ray);
            let range =
                self.range(pose.translation.vector.into(), in_scene.into()) + noise * rng.random_range(-1.7..1.7);
            (range < most).then(|| ray.map(|v| (v * range) as f32))
        };
        rays.iter().filter_map(hit).collect()
    }

    /// The distance to the first surface.
    fn range(&self, at: Vec3, ray: Vec3) -> f64 {
        let crossings = |[low, high]: &[Vec3; 2]| {
            let (mut near, mut far) = (f64::NEG_INFINITY, f64::INFINITY);
            for axis in 0..3 {
                let (a, b) = ((low[axis] - at[axis]) / ray[axis], (high[axis] - at[axis]) / ray[axis]);
                (near, far) = (near.max(a.min(b)), far.min(a.max(b)));
            }
            (near, far)
        };
        let box_ranges = self.boxes.iter().map(crossings).filter(|(near, far)| *near > 0.0 && near <= far);
        let room_ranges = self.rooms.iter().map(crossings).map(|(_, far)| far);
        let tunnel_range = self.tunnel.map(|radius| {
            let (a, b) = (ray[1].powi(2) + ray[2].powi(2), ray[1] * at[1] + ray[2] * at[2]);
            let c = at[1].powi(2) + at[2].powi(2) - radius * radius;
            ((b * b - a * c).sqrt() - b) / a
        });
        box_ranges.map(|(near, _)| near).chain(room_ranges).chain(tunnel_range).fold(f64::INFINITY, f64::min)
    }
}

/// A street along x with houses, cars and poles.
pub fn street(rng: &mut ChaCha8Rng) -> Scene {
    let mut boxes = vec![[[-150.0, -150.0, -1.0], [150.0, 150.0, 0.0]]];
    for side in [-1.0, 1.0] {
        let mut add = |x: f64, y: f64, size: Vec3| {
            let (near, far) = (side * y, side * (y + size[1]));
            boxes.push([[x, near.min(far), 0.0], [x + size[0], near.max(far), size[2]]]);
        };
        let mut x = -90.0;
        while x < 90.0 {
            let size = [rng.random_range(8.0..25.0), rng.random_range(6.0..15.0), rng.random_range(4.0..18.0)];
            add(x, rng.random_range(6.0..12.0), size);
            x += size[0] + rng.random_range(0.0..8.0);
        }
        for _ in 0..12 {
            add(rng.random_range(-80.0..80.0), rng.random_range(3.0..4.0), [4.2, 1.8, 1.5]);
            add(rng.random_range(-80.0..80.0), 5.3, [0.3, 0.3, 6.0]);
        }
    }
    Scene { boxes, ..Default::default() }
}

//! Points of glam and nalgebra, without a copy: `cargo run --release -p snake-interop --example geometry`.

use std::error::Error;

use glam::Vec3;
use nalgebra::Point3;
use snake_core::{Builtin, Model, Point};

/// A torus of 4000 points, with a radius of 1 and a tube of 0.3.
fn torus() -> Vec<Vec3> {
    let point = |i: u16| {
        let (u, v) = (f32::from(i) * 0.1, f32::from(i) * 0.7);
        let ring = 1.0 + 0.3 * v.cos();
        Vec3::new(ring * u.cos(), ring * u.sin(), 0.3 * v.sin())
    };
    (0..4000).map(point).collect()
}

/// Detects the same keypoints in points of either crate.
pub fn main() -> Result<(), Box<dyn Error>> {
    let model = Model::builtin(Builtin::Compact);
    let glam_points: Vec<Vec3> = torus();

    // Types of three floats in a row are cast. `try_cast_slice` returns an error for another layout, such as Vec3A.
    let points: &[Point] = bytemuck::try_cast_slice(&glam_points).map_err(|error| error.to_string())?;
    let detection = model.detect(points, model.recommended())?;
    let keypoints: Vec<Vec3> = detection.keypoints.iter().map(|keypoint| Vec3::from(keypoint.position)).collect();
    println!("{} keypoints, the first at {}", keypoints.len(), keypoints[0]);

    let nalgebra_points: Vec<Point3<f32>> = glam_points.iter().map(|p| Point3::new(p.x, p.y, p.z)).collect();
    let points: &[Point] = bytemuck::try_cast_slice(&nalgebra_points).map_err(|error| error.to_string())?;
    let again = model.detect(points, model.recommended())?;
    assert_eq!(again.keypoints, detection.keypoints);
    Ok(())
}

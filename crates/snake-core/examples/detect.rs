//! Keypoints of a cloud in one call: `cargo run --release --example detect`.

use snake_core::{Builtin, Model, Point, Result};

/// A torus of 4000 points, with a radius of 1 and a tube of 0.3.
fn torus() -> Vec<Point> {
    let point = |i: u16| {
        let (u, v) = (f32::from(i) * 0.1, f32::from(i) * 0.7);
        let ring = 1.0 + 0.3 * v.cos();
        [ring * u.cos(), ring * u.sin(), 0.3 * v.sin()]
    };
    (0..4000).map(point).collect()
}

fn main() -> Result<()> {
    let model = Model::builtin(Builtin::Compact);
    let detection = model.detect(&torus(), model.recommended())?;
    for keypoint in &detection.keypoints {
        println!("{:?} saliency {:.3}", keypoint.position, keypoint.saliency);
    }
    Ok(())
}

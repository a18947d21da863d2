//! The surface of a cloud as a triangle mesh: `cargo run --release --example mesh`.

use snake_core::{Builtin, EncodeOptions, MeshOptions, Model, Point, Result};

/// A sphere of radius 2, as 4000 points on a spiral.
fn sphere() -> Vec<Point> {
    let point = |i: u16| {
        let z = 1.0 - f32::from(i) / 1999.5;
        let (ring, angle) = ((1.0 - z * z).sqrt(), f32::from(i) * 2.399_963);
        [2.0 * ring * angle.cos(), 2.0 * ring * angle.sin(), 2.0 * z]
    };
    (0..4000).map(point).collect()
}

fn main() -> Result<()> {
    let field = Model::builtin(Builtin::Compact).encode(&sphere(), &EncodeOptions::default())?;
    let mesh = field.mesh(&MeshOptions::default())?;
    println!("{} vertices, {} triangles, area {:.2}", mesh.vertices.len(), mesh.triangles.len(), mesh.area());
    Ok(())
}

//! Encode a cloud once, query its field many times, and make its surface: `cargo run --release --example field`.

use snake_core::{Builtin, MeshOptions, Model, Point, Result};

/// A cube of side 1, as points on its faces.
fn cube() -> Vec<Point> {
    let point = |i: u16| {
        let (u, v) = (f32::from(i % 40) / 39.0, f32::from(i / 40 % 40) / 39.0);
        let face = f32::from(i / 1600 % 2);
        match i / 3200 {
            0 => [u, v, face],
            1 => [u, face, v],
            _ => [face, u, v],
        }
    };
    (0..9600).map(point).collect()
}

fn main() -> Result<()> {
    let model = Model::builtin(Builtin::Compact);
    let field = model.encode(&cube(), &model.recommended().encode)?;

    // Queries, gradients and results are in the frame and units of the cloud.
    let queries = [[0.0, 0.0, 0.0], [0.5, 0.5, 0.0], [0.5, 0.5, 0.5]];
    let occupancy = field.occupancy(&queries)?;
    let (saliency, gradient) = field.saliency_and_gradient(&queries)?;
    for i in 0..queries.len() {
        println!(
            "{:?}: occupancy {:.3}, saliency {:.3}, gradient {:?}",
            queries[i], occupancy[i], saliency[i], gradient[i]
        );
    }

    // The options that the weights recommend, with another one in its place; `DetectOptions::default()` are the paper's.
    let options = model.recommended().detect.with_nms_radius(Some(0.2.into()));
    let keypoints = field.detect(&options)?.keypoints;
    assert!(!keypoints.is_empty());
    println!("{} keypoints at least 0.2 apart", keypoints.len());

    let mesh = field.mesh(&MeshOptions::default())?;
    println!("{} vertices, {} triangles, area {:.2}", mesh.vertices.len(), mesh.triangles.len(), mesh.area());
    Ok(())
}

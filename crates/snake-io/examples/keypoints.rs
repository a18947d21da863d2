//! Keypoints of a file, and the field behind them.

use snake_core::{Builtin, Model};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let points = snake_io::read_points("samples/plane.ply".as_ref())?;
    let model = Model::builtin(Builtin::Compact);
    let detection = model.detect(&points, model.recommended())?; // one call for everything

    let field = model.encode(&points, &model.recommended().encode)?; // or encode once, query many times
    let (saliency, gradient) = field.saliency_and_gradient(&points)?;
    let spread = field.detect(&model.recommended().detect.with_nms_radius(Some(0.2.into())))?;
    assert!(!detection.keypoints.is_empty() && !spread.keypoints.is_empty());
    println!("{} {} {} {}", detection.keypoints.len(), spread.keypoints.len(), saliency.len(), gradient.len());
    Ok(())
}

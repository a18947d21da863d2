//! The same keypoints in one frame after another: `cargo run --release -p snake-registration --example frames -- FRAME1 FRAME2`.

use snake_core::{Builtin, Control, Detection, FrameDetector, Model, Point};
use snake_registration::{FPFH_DIMENSION, describe_keypoints, mutual_nearest};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let model = Model::builtin(Builtin::Scenes);
    let options = *model.recommended();
    let mut detector = FrameDetector::new(model, options)?;
    let mut detection = Detection::default();
    let mut last: Option<Vec<f32>> = None;
    for path in std::env::args().skip(1) {
        let points = snake_io::read_points(path.as_ref())?;
        detector.detect_into(&points, &mut detection)?;
        let positions: Vec<Point> = detection.keypoints.iter().map(|keypoint| keypoint.position).collect();
        let rows = describe_keypoints(&points, &positions, &Control::default())?;
        if let Some(before) = &last {
            // Rows of the keypoints before and of these, each the nearest of the other.
            let pairs: Vec<[usize; 2]> = mutual_nearest(before, &rows, FPFH_DIMENSION)?;
            println!("{path}: {} pairs with the keypoints of the frame before", pairs.len());
        }
        last = Some(rows);
    }
    Ok(())
}

//! A node of Zenoh: clouds come in at the key `points`, and their keypoints go out at the key `keypoints` as JSON.
//!
//! A cloud is float32 values x, y and z in little-endian byte order, one point after another.

use std::error::Error;

use snake_core::{Builtin, Detection, Detector, Model, PointCloud2Layout, PointCloud2View, PointField};
use zenoh::Wait;

fn main() -> Result<(), Box<dyn Error + Send + Sync>> {
    let session = zenoh::open(zenoh::Config::default()).wait()?;
    let clouds = session.declare_subscriber("points").wait()?;
    let keypoints = session.declare_publisher("keypoints").wait()?;

    let model = Model::builtin(Builtin::Compact);
    let options = *model.recommended();
    let mut detector = Detector::new(model, options)?;
    let mut detection = Detection::default();
    while let Ok(sample) = clouds.recv() {
        match detect(&mut detector, &sample.payload().to_bytes(), &mut detection) {
            Ok(()) => keypoints.put(serde_json::to_vec(&detection.keypoints)?).wait()?,
            // The next cloud may be good.
            Err(error) => eprintln!("{error}"),
        }
    }
    Ok(())
}

/// Detects the keypoints of a message. Its bytes are read where they are.
fn detect(detector: &mut Detector, bytes: &[u8], detection: &mut Detection) -> snake_core::Result<()> {
    let width = bytes.len() / 12;
    let layout = PointCloud2Layout { height: 1, width, point_step: 12, row_step: 12 * width, is_bigendian: false };
    let field = |name, offset| PointField { name, offset, datatype: 7, count: 1 };
    let fields = [field("x", 0), field("y", 4), field("z", 8)];
    detector.detect_into(&PointCloud2View::new(layout, &fields, bytes)?, detection)
}

//! Keypoints of a ROS 2 message, read where its bytes are: `cargo run --release -p snake-core --example pointcloud2`.

use snake_core::{Builtin, Detection, FrameDetector, Model, PointCloud2Layout, PointCloud2View, PointField, Result};

/// The bytes of a `sensor_msgs/PointCloud2`: rows of x, y, z and intensity as float32, with a gap after z. Every tenth
/// point is missing.
fn message() -> (PointCloud2Layout, Vec<u8>) {
    let layout = PointCloud2Layout { height: 40, width: 100, point_step: 20, row_step: 2000, is_bigendian: false };
    let mut data = Vec::new();
    for i in 0..4000_u16 {
        let (u, v) = (f32::from(i) * 0.1, f32::from(i) * 0.7);
        let ring = 1.0 + 0.3 * v.cos();
        let x = if i % 10 == 0 { f32::NAN } else { ring * u.cos() };
        for value in [x, ring * u.sin(), 0.3 * v.sin(), 0.0, 1.0] {
            data.extend(value.to_le_bytes());
        }
    }
    (layout, data)
}

fn main() -> Result<()> {
    let (layout, data) = message();

    // Fields by name; 7 is float32 in sensor_msgs/PointField. Nothing is copied.
    let field = |name, offset| PointField { name, offset, datatype: 7, count: 1 };
    let fields = [field("x", 0), field("y", 4), field("z", 8), field("intensity", 16)];
    let cloud = PointCloud2View::new(layout, &fields, &data)?;

    let model = Model::builtin(Builtin::Compact);
    let options = *model.recommended();
    let mut detector = FrameDetector::new(model, options)?;
    let mut detection = Detection::default();
    detector.detect_into(&cloud, &mut detection)?;
    println!("{} points skipped", detection.num_skipped);
    for keypoint in &detection.keypoints {
        // The index counts all points of the message, so it also gives the row and the column.
        let (row, column) = (keypoint.nearest_index / layout.width, keypoint.nearest_index % layout.width);
        println!("{:?} near row {row}, column {column}", keypoint.position);
    }
    Ok(())
}

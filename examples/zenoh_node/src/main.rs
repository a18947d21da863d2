//! A node of Zenoh: clouds come in at the key `points`, and their keypoints go out at the key `keypoints` as JSON.
//!
//! A cloud is float32 values x, y and z in little-endian byte order, one point after another.

use std::error::Error;

use snake_core::{Builtin, Detection, FrameDetector, Model, PointCloud2Layout, PointCloud2View, PointField};
use zenoh::{Session, Wait};

fn main() -> Result<(), Box<dyn Error + Send + Sync>> {
    serve(&zenoh::open(zenoh::Config::default()).wait()?)
}

/// Answers clouds until the session is closed.
fn serve(session: &Session) -> Result<(), Box<dyn Error + Send + Sync>> {
    let clouds = session.declare_subscriber("points").wait()?;
    let keypoints = session.declare_publisher("keypoints").wait()?;

    let model = Model::builtin(Builtin::Compact);
    let options = *model.recommended();
    let mut detector = FrameDetector::new(model, options)?;
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
fn detect(detector: &mut FrameDetector, bytes: &[u8], detection: &mut Detection) -> snake_core::Result<()> {
    let width = bytes.len() / 12;
    let layout = PointCloud2Layout { height: 1, width, point_step: 12, row_step: 12 * width, is_bigendian: false };
    let field = |name, offset| PointField { name, offset, datatype: 7, count: 1 };
    let fields = [field("x", 0), field("y", 4), field("z", 8)];
    detector.detect_into(&PointCloud2View::new(layout, &fields, bytes)?, detection)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_good_cloud_gives_keypoints() {
        // A session that neither listens nor searches for others: its own messages reach it all the same.
        let mut config = zenoh::Config::default();
        for (key, value) in [("listen/endpoints", "[]"), ("scouting/multicast/enabled", "false")] {
            config.insert_json5(key, value).unwrap();
        }
        let session = zenoh::open(config).wait().unwrap();
        let found = session.declare_subscriber("keypoints").wait().unwrap();
        let node = session.clone();
        let node = std::thread::spawn(move || serve(&node).map_err(|error| error.to_string()));
        let clouds = session.declare_publisher("points").wait().unwrap();
        while !clouds.matching_status().wait().unwrap().matching() {
            std::thread::yield_now();
        }
        let torus: Vec<u8> = (0..3000_u16)
            .flat_map(|i| {
                let (u, v) = (f32::from(i) * 0.1, f32::from(i) * 0.7);
                let ring = 4.0 + v.cos();
                [ring * u.cos(), ring * u.sin(), v.sin()]
            })
            .flat_map(f32::to_le_bytes)
            .collect();
        for cloud in [&torus[..], &[], &torus] {
            clouds.put(cloud).wait().unwrap();
        }
        for _ in 0..2 {
            let sample = found.recv().unwrap();
            let keypoints: serde_json::Value = serde_json::from_slice(&sample.payload().to_bytes()).unwrap();
            assert!(!keypoints.as_array().unwrap().is_empty(), "{keypoints}");
        }
        session.close().wait().unwrap();
        node.join().unwrap().unwrap();
    }
}

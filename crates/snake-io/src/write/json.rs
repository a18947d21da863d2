//! Writes keypoints as JSON.

use std::io::{self, Write};

use serde_json::{Number, Value, json};

use crate::write::keypoint_source::KeypointSource;
use snake_geometry::{Keypoint, add_origin};

/// One keypoint as an object with the keys x, y, z, saliency, occupancy, nearest_index, confidence
/// and covariance. Without a map of confidences, the confidence is `null`.
///
/// The origin is added to the position. A number that is not finite is written as `null`.
pub fn keypoint_json(keypoint: &Keypoint, origin: [f64; 3]) -> Value {
    let [x, y, z] = position(keypoint, origin);
    json!({
        "x": x,
        "y": y,
        "z": z,
        "saliency": number(keypoint.saliency),
        "occupancy": number(keypoint.occupancy),
        "nearest_index": keypoint.nearest_index,
        "confidence": keypoint.confidence.and_then(number),
        "covariance": keypoint.covariance.rows().map(|row| row.map(number)),
    })
}

/// Writes `{"keypoints": [..]}`.
pub(crate) fn write(out: &mut dyn Write, keypoints: &[Keypoint], origin: [f64; 3]) -> io::Result<()> {
    let keypoints: Vec<Value> = keypoints.iter().map(|keypoint| keypoint_json(keypoint, origin)).collect();
    serde_json::to_writer_pretty(&mut *out, &json!({ "keypoints": keypoints }))?;
    writeln!(out)
}

/// Writes a KeypointNet annotation file with one shape. Each keypoint has its position, its saliency and the index of its nearest
/// point. Its rank replaces KeypointNet's `semantic_id`.
pub(crate) fn write_keypointnet(
    out: &mut dyn Write,
    keypoints: &[Keypoint],
    source: &KeypointSource,
) -> io::Result<()> {
    let mark = |(rank, keypoint): (usize, &Keypoint)| {
        json!({
            "xyz": position(keypoint, source.origin),
            "semantic_id": rank,
            "pcd_info": { "point_index": keypoint.nearest_index },
            "saliency": number(keypoint.saliency),
        })
    };
    let marked: Vec<Value> = keypoints.iter().enumerate().map(mark).collect();
    let KeypointSource { class_id, model_id, .. } = source;
    let shapes = json!([{ "class_id": class_id, "model_id": model_id, "keypoints": marked }]);
    serde_json::to_writer_pretty(&mut *out, &shapes)?;
    writeln!(out)
}

fn position(keypoint: &Keypoint, origin: [f64; 3]) -> [Option<Number>; 3] {
    if origin == [0.0; 3] {
        keypoint.position.map(number)
    } else {
        add_origin(keypoint.position, origin).map(Number::from_f64)
    }
}

/// Converts a number through its shortest decimal form: JSON numbers are `f64`, and 0.1 must not become 0.10000000149011612.
fn number(value: f32) -> Option<Number> {
    value.to_string().parse().ok().and_then(Number::from_f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::KEYPOINTS;

    #[test]
    fn numbers_are_short_and_exact() {
        let mut bytes = Vec::new();
        write(&mut bytes, &KEYPOINTS, [0.0; 3]).unwrap();
        let text = String::from_utf8(bytes).unwrap();
        assert!(text.contains("\"x\": 0.1,") && text.contains("\"nearest_index\": 16777217"), "{text}");
    }

    #[test]
    fn not_finite_is_null() {
        let value = keypoint_json(&Keypoint { saliency: f32::NAN, occupancy: f32::INFINITY, ..KEYPOINTS[0] }, [0.0; 3]);
        assert!(value["saliency"].is_null() && value["occupancy"].is_null());
    }

    #[test]
    fn keypointnet_marks_indices_of_a_named_shape() {
        let source = KeypointSource::new("pcds/02691156/1a04.pcd".as_ref(), [5e6, 0.0, 0.0]);
        let mut bytes = Vec::new();
        write_keypointnet(&mut bytes, &KEYPOINTS, &source).unwrap();
        let value: Value = serde_json::from_slice(&bytes).unwrap();
        let shape = &value[0];
        assert_eq!((&shape["class_id"], &shape["model_id"]), (&"02691156".into(), &"1a04".into()));
        let second = &shape["keypoints"][1];
        assert_eq!((&second["semantic_id"], &second["pcd_info"]["point_index"]), (&1.into(), &16_777_217.into()));
        assert_eq!(second["xyz"], json!([5_000_004.0, 5.0, 1e7]));
    }
}

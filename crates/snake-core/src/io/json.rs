//! Keypoints and registrations as JSON.

use std::io::{self, Write};

use serde_json::{Number, Value, json};

use crate::detect::Keypoint;
use crate::registration::Registration;

/// One keypoint as an object with the keys x, y, z, saliency, occupancy and nearest_index.
///
/// A number that is not finite becomes `null`.
pub fn keypoint_json(keypoint: &Keypoint) -> Value {
    let [x, y, z] = keypoint.position.map(number);
    json!({
        "x": x,
        "y": y,
        "z": z,
        "saliency": number(keypoint.saliency),
        "occupancy": number(keypoint.occupancy),
        "nearest_index": keypoint.nearest_index,
    })
}

/// Writes `{"keypoints": [..]}`.
pub(super) fn write(out: &mut dyn Write, keypoints: &[Keypoint]) -> io::Result<()> {
    let keypoints: Vec<Value> = keypoints.iter().map(keypoint_json).collect();
    serde_json::to_writer_pretty(&mut *out, &json!({ "keypoints": keypoints }))?;
    writeln!(out)
}

/// Writes the object with the fields of a registration.
pub(super) fn write_registration(out: &mut dyn Write, registration: &Registration) -> io::Result<()> {
    serde_json::to_writer(&mut *out, registration)?;
    writeln!(out)
}

/// By way of its shortest decimal form: JSON numbers are `f64`, and 0.1 should not read 0.10000000149011612.
fn number(value: f32) -> Option<Number> {
    value.to_string().parse().ok().and_then(Number::from_f64)
}

#[cfg(test)]
mod tests {
    use super::super::tests::KEYPOINTS;
    use super::*;

    #[test]
    fn numbers_are_short_and_exact() {
        let mut bytes = Vec::new();
        write(&mut bytes, &KEYPOINTS).unwrap();
        let text = String::from_utf8(bytes).unwrap();
        assert!(text.contains("\"x\": 0.1,") && text.contains("\"nearest_index\": 16777217"), "{text}");
        let parsed: Value = serde_json::from_str(&text).unwrap();
        for (value, keypoint) in parsed["keypoints"].as_array().unwrap().iter().zip(KEYPOINTS) {
            let read = ["x", "y", "z", "saliency", "occupancy"].map(|key| value[key].as_f64().unwrap() as f32);
            let [x, y, z] = keypoint.position;
            assert_eq!(read, [x, y, z, keypoint.saliency, keypoint.occupancy]);
        }
    }

    #[test]
    fn not_finite_is_null() {
        let value = keypoint_json(&Keypoint { saliency: f32::NAN, occupancy: f32::INFINITY, ..KEYPOINTS[0] });
        assert!(value["saliency"].is_null() && value["occupancy"].is_null());
    }
}

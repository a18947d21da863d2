//! Keypoints of each cloud of a recording, written back as a topic:
//! `cargo run --release -p snake-io --example mcap_replay -- IN.mcap OUT.mcap TOPIC`.

use std::collections::BTreeMap;
use std::error::Error;
use std::fs::File;
use std::path::Path;

use mcap::records::MessageHeader;
use snake_core::{Builtin, Detection, FrameDetector, Model};
use snake_io::{RecordedCloud, keypoint_json, read_recording};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [input, output, topic @ ..] = &arguments[..] else {
        return Err("give the recording to read and the one to write".into());
    };
    let model = Model::builtin(Builtin::Compact);
    let options = *model.recommended();
    let mut detector = FrameDetector::new(model, options)?;
    let mut detection = Detection::default();

    let mut writer = mcap::Writer::new(File::create(output)?)?;
    let schema = writer.add_schema("snake_rs.Keypoints", "jsonschema", br#"{"type": "object"}"#)?;
    let channel_id = writer.add_channel(schema, "/keypoints", "json", &BTreeMap::new())?;
    let mut messages = Vec::new();
    let topic = topic.first().map(String::as_str);
    let mut number = 0;
    // One cloud after another: a recording may be larger than the memory.
    for recorded in read_recording(Path::new(input), topic)? {
        let RecordedCloud { log_time, frame_id, cloud } = recorded?;
        match detector.detect_into(&cloud.points, &mut detection) {
            Ok(()) => {
                let keypoints = detection.keypoints.iter().map(|keypoint| keypoint_json(keypoint, cloud.origin));
                let keypoints: Vec<_> = keypoints.collect();
                messages.push((log_time, serde_json::json!({"frame_id": frame_id, "keypoints": keypoints})));
            }
            Err(error) => eprintln!("cloud at {log_time} ns: {error}"),
        }
        number += 1;
    }
    for (sequence, (log_time, message)) in (0..).zip(&messages) {
        let header = MessageHeader { channel_id, sequence, log_time: *log_time, publish_time: *log_time };
        writer.write_to_known_channel(&header, &serde_json::to_vec(message)?)?;
    }
    writer.finish()?;
    println!("{} of {number} clouds have keypoints", messages.len());
    Ok(())
}

//! A node of Dora: clouds come in at the input `points`, and their keypoints go out at the output `keypoints`.
//!
//! Both are Arrow arrays of float32. A point is x, y and z; a keypoint is x, y, z and its saliency. They follow one another, and
//! the best keypoint is the first. In a dataflow:
//!
//! ```yaml
//! - id: keypoints
//!   build: cargo build --release
//!   path: target/release/dora_node
//!   inputs:
//!     points: lidar/points
//!   outputs:
//!     - keypoints
//! ```

use std::error::Error;

use dora_node_api::{DoraArray, DoraNode, Event};
use snake_core::{Builtin, Detection, FrameDetector, Model, Point};

fn main() -> Result<(), Box<dyn Error>> {
    let (mut node, mut events) = DoraNode::init_from_env()?;
    let model = Model::builtin(Builtin::Compact);
    let options = *model.recommended();
    let mut detector = FrameDetector::new(model, options)?;
    let mut detection = Detection::default();
    while let Some(event) = events.recv() {
        let Event::Input { metadata, data, .. } = event else { continue };
        match detect(&mut detector, &data, &mut detection) {
            Ok(()) => node.send_output("keypoints".to_owned().into(), metadata.parameters, rows(&detection))?,
            // The next cloud may be good.
            Err(error) => eprintln!("{error}"),
        }
    }
    Ok(())
}

/// Detects the keypoints of an array, which is read where it is.
fn detect(detector: &mut FrameDetector, data: &DoraArray, detection: &mut Detection) -> Result<(), Box<dyn Error>> {
    let values: &[f32] = data.try_into()?;
    let points: &[Point] = bytemuck::try_cast_slice(values)
        .map_err(|_| format!("{} values are no points: their number is no multiple of 3", values.len()))?;
    Ok(detector.detect_into(points, detection)?)
}

fn rows(detection: &Detection) -> Vec<f32> {
    let row = |keypoint: &snake_core::Keypoint| {
        let [x, y, z] = keypoint.position;
        [x, y, z, keypoint.saliency]
    };
    detection.keypoints.iter().flat_map(row).collect()
}

#[cfg(test)]
mod tests {
    use dora_node_api::integration_testing::integration_testing_format::{
        IncomingEvent, InputData, IntegrationTestInput, TimedIncomingEvent,
    };
    use dora_node_api::integration_testing::{
        TestingInput, TestingOptions, TestingOutput, drain_outputs, output_channel, setup_integration_testing,
    };
    use serde_json::{Value, json};

    /// Events of clouds, and the end.
    fn events(clouds: &[Vec<f32>]) -> Vec<TimedIncomingEvent> {
        let input = |values: &Vec<f32>| IncomingEvent::Input {
            id: "points".to_owned().into(),
            metadata: None,
            data: Some(Box::new(InputData::JsonObject { data: json!(values), data_type: Some(json!("Float32")) })),
        };
        let events = clouds.iter().map(input).chain([IncomingEvent::Stop]);
        events.map(|event| TimedIncomingEvent { time_offset_secs: 0.0, event }).collect()
    }

    #[test]
    fn every_good_cloud_gives_keypoints() {
        let torus: Vec<f32> = (0..3000_u16)
            .flat_map(|i| {
                let (u, v) = (f32::from(i) * 0.1, f32::from(i) * 0.7);
                let ring = 4.0 + v.cos();
                [ring * u.cos(), ring * u.sin(), v.sin()]
            })
            .collect();
        let clouds = [torus.clone(), torus[..8999].to_vec(), torus];
        let inputs = TestingInput::Input(IntegrationTestInput::new("keypoints".parse().unwrap(), events(&clouds)));
        let (sender, mut receiver) = output_channel();
        setup_integration_testing(
            inputs,
            TestingOutput::ToChannel(sender),
            TestingOptions { skip_output_time_offsets: true },
        );
        crate::main().unwrap();
        let outputs = drain_outputs(&mut receiver);
        assert_eq!(outputs.len(), 2, "{outputs:?}");
        for output in outputs {
            let values = output["data"].as_array().unwrap();
            assert!(output["id"] == Value::from("keypoints") && values.len() >= 4 && values.len() % 4 == 0, "{output:?}");
        }
    }
}

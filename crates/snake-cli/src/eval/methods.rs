//! The detectors that are compared.

use anyhow::Result;
use serde_json::{Value, json};
use snake_core::baselines::{Detector, Protocol};
use snake_core::{Model, Point, Preset};

use crate::args::{ProtocolName, RepeatabilityArguments};
use crate::model;

/// A detector with its settings: from a cloud to the positions of its best keypoints.
pub enum Method {
    Snake { model: Box<Model>, options: Preset },
    Classical { name: String, detector: Detector, count: usize, protocol: Protocol },
}

impl Method {
    /// The methods that were asked for.
    pub fn all(arguments: &RepeatabilityArguments) -> Result<Vec<Self>> {
        let protocol = match arguments.protocol {
            ProtocolName::Ranked => Protocol::Ranked,
            ProtocolName::Paper => Protocol::Paper,
        };
        let method = |name: &String| {
            if name == "snake" {
                return Self::snake(arguments);
            }
            let detector = Detector::named(name, protocol)?;
            Ok(Self::Classical { name: name.clone(), detector, count: arguments.count, protocol })
        };
        arguments.methods.iter().map(method).collect()
    }

    fn snake(arguments: &RepeatabilityArguments) -> Result<Self> {
        let model = model::load(arguments.model.as_deref())?;
        let mut options = match &arguments.preset {
            Some(name) => Preset::named(name)?,
            None => *model.recommended(),
        };
        options.detect.max_keypoints = arguments.count;
        options.detect.nms_radius = arguments.nms_radius.unwrap_or(options.detect.nms_radius);
        Ok(Self::Snake { model: Box::new(model), options })
    }

    /// As on the command line.
    pub fn name(&self) -> &str {
        match self {
            Self::Snake { .. } => "snake",
            Self::Classical { name, .. } => name,
        }
    }

    /// What the keypoints depend on.
    pub fn settings(&self) -> Value {
        match self {
            Self::Snake { model, options } => {
                json!({"name": "snake", "options": options, "model": model.metadata()})
            }
            Self::Classical { name, .. } => json!({"name": name}),
        }
    }

    /// Positions of the best keypoints, best first; the seed is that of random choices.
    pub fn keypoints(&self, points: &[Point], seed: u64) -> Result<Vec<Point>> {
        Ok(match self {
            Self::Snake { model, options } => {
                model.detect(points, options)?.keypoints.iter().map(|keypoint| keypoint.position).collect()
            }
            Self::Classical { detector, count, protocol, .. } => {
                let found = detector.keypoints(points, *count, *protocol, seed)?;
                found.iter().map(|response| points[response.index]).collect()
            }
        })
    }
}

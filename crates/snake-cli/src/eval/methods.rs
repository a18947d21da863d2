//! The detectors that an evaluation compares.

use anyhow::{Result, bail};
use serde_json::{Value, json};
use snake_core::space::suppress_ranked;
use snake_core::{Length, Model, Options, Point, Preset};
use snake_registration::detectors::{Detector, Protocol};

use super::args::{EvalArguments, ProtocolName};
use crate::setup::{Loaded, none_if_zero};

/// A detector with its options. It maps a cloud to the positions of its best keypoints.
pub enum Method {
    Snake { name: String, model: Box<Model>, options: Options },
    Classical { name: String, detector: Detector, count: usize, protocol: Protocol, spacing: Option<Length> },
}

impl Method {
    /// The methods of the command line. With `--nms-radius`, or else with a `spacing`, the ranked keypoints of the
    /// classical detectors too are farther apart than that.
    pub fn all(arguments: &EvalArguments, spacing: Option<Length>) -> Result<Vec<Self>> {
        if arguments.count == 0 {
            bail!("--count must be 1 or more");
        }
        let nms_radius = arguments.nms_radius.or(spacing);
        let protocol = match arguments.protocol {
            ProtocolName::Ranked => Protocol::Ranked,
            ProtocolName::Paper => Protocol::Paper,
        };
        let method = |name: &String| {
            if let Some(rotations) = rotations(name) {
                return Self::snake(name, rotations, arguments, nms_radius);
            }
            let detector = Detector::named(name, protocol)?;
            let spacing = nms_radius.filter(|_| protocol == Protocol::Ranked);
            Ok(Self::Classical { name: name.clone(), detector, count: arguments.count, protocol, spacing })
        };
        arguments.methods.iter().map(method).collect()
    }

    fn snake(
        name: &str,
        rotations: Option<usize>,
        arguments: &EvalArguments,
        nms_radius: Option<Length>,
    ) -> Result<Self> {
        let Loaded { model, options, .. } = arguments.run.compute.load_model()?;
        let mut options = match &arguments.preset {
            Some(name) => Preset::named(name)?.options(),
            None => options,
        };
        options.detect.max_keypoints = arguments.count;
        options.encode.rotations = rotations.unwrap_or(options.encode.rotations);
        options.window_radius = arguments.window_radius.or(options.window_radius);
        options.detect.nms_radius = nms_radius.map_or(options.detect.nms_radius, none_if_zero);
        Ok(Self::Snake { name: name.into(), model: Box::new(model), options })
    }

    /// The name on the command line.
    pub fn name(&self) -> &str {
        match self {
            Self::Snake { name, .. } | Self::Classical { name, .. } => name,
        }
    }

    /// All settings that the keypoints depend on.
    pub fn all_settings(arguments: &EvalArguments, methods: &[Self]) -> Value {
        json!({
            "methods": methods.iter().map(Self::settings).collect::<Vec<_>>(),
            "protocol": match arguments.protocol { ProtocolName::Ranked => "ranked", ProtocolName::Paper => "paper" },
            "count": arguments.count,
            "limit": arguments.run.limit,
            "seed": arguments.run.seed,
            "seeds": arguments.run.seeds,
        })
    }

    fn settings(&self) -> Value {
        match self {
            Self::Snake { name, model, options } => {
                json!({"name": name, "options": options, "model": model.metadata()})
            }
            Self::Classical { name, spacing, .. } => json!({"name": name, "spacing": spacing}),
        }
    }

    /// Positions of the best keypoints, best first. The seed determines random choices.
    pub fn keypoints(&self, points: &[Point], seed: u64) -> Result<Vec<Point>> {
        Ok(match self {
            Self::Snake { model, options, .. } => {
                model.detect(points, options)?.keypoints.iter().map(|keypoint| keypoint.position).collect()
            }
            Self::Classical { detector, count, protocol, spacing, .. } => {
                let candidates = if spacing.is_some() { points.len() } else { *count };
                let found = detector.keypoints(points, candidates, *protocol, seed)?;
                let radius = match spacing {
                    None | Some(Length::Units(0.0)) => 0.0,
                    Some(spacing) => spacing.in_units("nms_radius", points)? as f32,
                };
                let ranked: Vec<Point> = found.iter().map(|response| points[response.index]).collect();
                suppress_ranked(&ranked, radius, *count)?.into_iter().map(|index| ranked[index]).collect()
            }
        })
    }
}

/// The number of rotated copies in a method's name: N for `snakexN`, no number for `snake`, and `None` for other
/// methods.
fn rotations(method: &str) -> Option<Option<usize>> {
    match method.strip_prefix("snake")? {
        "" => Some(None),
        times => times.strip_prefix('x')?.parse().ok().map(Some),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_number_of_rotated_copies_is_in_the_name() {
        assert_eq!([rotations("snake"), rotations("snakex4")], [Some(None), Some(Some(4))]);
        for other in ["iss", "snakex", "snakex-1", "snake4", "snakex4x"] {
            assert_eq!(rotations(other), None);
        }
    }
}

//! The detectors that an evaluation compares.

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use serde_json::{Value, json};
use snake_core::{Builtin, Chooser, Control, DetectOptions, Length, NamedModel, Point};
use snake_detectors::{Detector, Protocol};
use snake_eval::ExternalKeypoints;
use snake_eval::reports::Models;
use snake_geometry::suppress_ranked;

use super::args::{EvalArguments, ProtocolName};
use crate::setup::none_if_zero;

/// A detector with its options. It maps a cloud to the positions of its best keypoints.
pub struct Method {
    name: String,
    source: Source,
    /// Number of keypoints at most.
    count: usize,
    spacing: Spacing,
}

enum Source {
    Snake {
        chooser: Box<Chooser>,
        /// The suppression of the detection itself.
        spacing: Spacing,
    },
    Classical {
        detector: Detector,
        protocol: Protocol,
    },
    /// Keypoints from files, in this folder.
    Files(PathBuf),
}

/// Keypoints of another program under a name, `FOLDER/CLOUD.npz` for each cloud.
pub struct External<'a> {
    pub name: &'a str,
    pub folder: &'a Path,
}

impl External<'_> {
    /// Reads the keypoints of one cloud.
    pub fn read(&self, InFile { name, origin }: InFile) -> Result<ExternalKeypoints> {
        let path = self.folder.join(format!("{name}.npz"));
        ExternalKeypoints::read(&path, origin).with_context(|| format!("--external {}", self.name))
    }
}

/// The best `count` keypoints of a cloud, farther apart than a radius.
pub fn best(ranked: Vec<Point>, radius: Option<Length>, count: usize, points: &[Point]) -> Result<Vec<Point>> {
    let radius = match radius.and_then(none_if_zero) {
        Some(length) => length.in_units("nms_radius", points)?,
        None => 0.0,
    };
    Ok(suppress_ranked(&ranked, radius as f32, count)?.into_iter().map(|index| ranked[index]).collect())
}

/// Keypoints of a cloud.
pub struct Ranked {
    /// Best first.
    pub positions: Vec<Point>,
    /// The model that was chosen for the cloud, if none was named.
    pub model: Option<Builtin>,
}

/// The cloud that a file of keypoints belongs to.
#[derive(Clone, Copy)]
pub struct InFile<'a> {
    /// The file's name without its extension.
    pub name: &'a str,
    /// Offset from the cloud's coordinates to those of its file.
    pub origin: [f64; 3],
}

/// The least distance between the ranked keypoints of a method.
#[derive(Clone, Copy)]
enum Spacing {
    /// The method's own.
    Own,
    /// This length.
    Radius(Length),
    /// The radius at which the keypoints cover the clouds as `--coverage` asks.
    Coverage,
}

impl Spacing {
    fn radius(self) -> Option<Length> {
        if let Self::Radius(radius) = self { Some(radius) } else { None }
    }
}

impl Method {
    /// The methods of the command line. All ranked keypoints are farther apart than `--nms-radius`, or else `spacing`. With
    /// `--coverage` [`candidates`](Self::candidates) are not suppressed.
    pub fn all(arguments: &EvalArguments, spacing: Option<Length>) -> Result<Vec<Self>> {
        let spacing = match arguments.coverage {
            Some(_) => Spacing::Coverage,
            None => arguments.nms_radius.or(spacing).map_or(Spacing::Own, Spacing::Radius),
        };
        if arguments.max_keypoints == 0 {
            bail!("--max-keypoints must be 1 or more");
        }
        let protocol = match arguments.protocol {
            ProtocolName::Ranked => Protocol::Ranked,
            ProtocolName::Paper => Protocol::Paper,
        };
        let of =
            |name: &str, source, spacing| Self { name: name.into(), source, count: arguments.max_keypoints, spacing };
        let mut methods: Vec<Self> = Vec::new();
        for name in &arguments.methods {
            match rotations(name) {
                Some(rotations) => {
                    // The detection suppresses by a radius itself.
                    let after = if matches!(spacing, Spacing::Coverage) { spacing } else { Spacing::Own };
                    let sources = Source::networks(rotations, arguments, spacing)?;
                    methods.extend(sources.into_iter().map(|source| of(name, source, after)));
                }
                None => {
                    let spacing = if protocol == Protocol::Ranked { spacing } else { Spacing::Own };
                    let source = Source::Classical { detector: Detector::classical(name)?, protocol };
                    methods.push(of(name, source, spacing));
                }
            }
        }
        let files = |(name, folder): &(String, PathBuf)| of(name, Source::Files(folder.clone()), spacing);
        methods.extend(arguments.external.iter().map(files));
        let names = arguments.methods.iter().chain(arguments.external.iter().map(|(name, _)| name)).map(String::as_str);
        check_distinct("--methods and --external", names)?;
        Ok(methods)
    }

    /// The name on the command line.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// All settings that the keypoints depend on.
    pub fn all_settings(arguments: &EvalArguments, methods: &[Self]) -> Value {
        json!({
            "methods": methods.iter().map(Self::settings).collect::<Vec<_>>(),
            "protocol": match arguments.protocol { ProtocolName::Ranked => "ranked", ProtocolName::Paper => "paper" },
            "max_keypoints": arguments.max_keypoints,
            "coverage": arguments.coverage,
            "limit": arguments.run.limit,
            "seed": arguments.run.seed,
            "seeds": arguments.run.seeds,
        })
    }

    fn settings(&self) -> Value {
        let mut settings = json!({"name": self.name, "spacing": self.spacing.radius()});
        match &self.source {
            Source::Snake { chooser, .. } => {
                let model = |named: &NamedModel| json!({"model": named.model.metadata(), "options": named.options});
                settings["models"] = chooser.models().iter().map(model).collect();
            }
            Source::Classical { .. } => (),
            Source::Files(folder) => settings["folder"] = json!(folder),
        }
        settings
    }

    /// Positions of the best keypoints of a cloud, best first; `file` names the cloud for keypoints in files. The seed determines
    /// random choices. `radius` suppresses them, in cloud units, or else the method's own radius.
    pub fn keypoints(&self, points: &[Point], file: Option<InFile>, seed: u64, radius: Option<f64>) -> Result<Ranked> {
        let radius = radius.map(Length::Units).or(self.spacing.radius());
        let Ranked { positions, model } = self.candidates(points, file, seed)?;
        Ok(Ranked { positions: best(positions, radius, self.count, points)?, model })
    }

    /// Positions of all keypoints, best first, before suppression unless the detector suppresses itself.
    pub fn candidates(&self, points: &[Point], file: Option<InFile>, seed: u64) -> Result<Ranked> {
        let positions = match &self.source {
            Source::Snake { chooser, spacing } => {
                let mut chosen = chooser.for_points(points)?;
                self.set_number(&mut chosen.options.detect, *spacing);
                let detection = chosen.detect(&Control::default())?;
                let positions = detection.keypoints.iter().map(|keypoint| keypoint.position).collect();
                return Ok(Ranked { positions, model: chosen.which });
            }
            Source::Classical { detector, protocol } => {
                let candidates = if matches!(self.spacing, Spacing::Own) { self.count } else { points.len() };
                let responses = detector.keypoints(points, candidates, *protocol, seed)?;
                responses.iter().map(|response| points[response.index]).collect()
            }
            Source::Files(folder) => {
                let Some(file) = file else {
                    bail!("--external needs a data set of pairs of clouds: the views of an object are drawn at random");
                };
                External { name: &self.name, folder }.read(file)?.positions
            }
        };
        Ok(Ranked { positions, model: None })
    }

    /// Sets the number of keypoints of a detection and the distance between them.
    fn set_number(&self, options: &mut DetectOptions, spacing: Spacing) {
        options.max_keypoints = self.count;
        match spacing {
            Spacing::Own => (),
            Spacing::Radius(radius) => options.nms_radius = none_if_zero(radius),
            // All candidates are suppressed afterwards.
            Spacing::Coverage => {
                (options.nms_radius, options.max_keypoints, options.min_confidence) = (None, usize::MAX, None)
            }
        }
    }

    /// The largest number of keypoints of a cloud.
    pub fn count(&self) -> usize {
        self.count
    }
}

impl Source {
    /// One source for each named model, or one that chooses a model for each cloud.
    fn networks(rotations: Option<usize>, arguments: &EvalArguments, spacing: Spacing) -> Result<Vec<Self>> {
        let mut values = arguments.options.values();
        values.extend(rotations.map(|number| ("rotations".to_owned(), number.into())));
        let choosers = arguments.run.choosers(&values)?;
        Ok(choosers.into_iter().map(|chooser| Self::Snake { chooser: Box::new(chooser), spacing }).collect())
    }
}

/// How many clouds each model was chosen for.
pub fn count_models(ranked: &[Ranked]) -> Models {
    let mut models = Models::new();
    for model in ranked.iter().filter_map(|ranked| ranked.model) {
        *models.entry(model.name().to_owned()).or_default() += 1;
    }
    models
}

/// Refuses a name that is given twice, because a report takes rows of one name for several models of one method.
pub fn check_distinct<'a>(option: &str, names: impl Iterator<Item = &'a str>) -> Result<()> {
    let mut known = HashSet::new();
    for name in names {
        if !known.insert(name) {
            bail!("{option} name {name} twice");
        }
    }
    Ok(())
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

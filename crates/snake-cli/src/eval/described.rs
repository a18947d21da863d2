//! Clouds with the keypoints and descriptors that `snake-cli eval registration` compares.

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::path::PathBuf;

use anyhow::{Context, Result, anyhow, bail};
use snake_core::{Control, NamedModel};
use snake_eval::ExternalKeypoints;
use snake_eval::datasets::{ScenePair, Scenes};
use snake_eval::reports::registration::Method;
use snake_geometry::{Cloud, Length, Point, suppress_ranked};
use snake_registration::steps::{Lengths, VoxelCloud};
use snake_registration::{Descriptor, Detector};

use super::args::RegistrationArguments;
use super::methods::check_distinct;
use crate::inputs::ColumnArguments;
use crate::setup::{builtin_name, named, none_if_zero};

/// Size of the voxels to which clouds are downsampled, in metres.
pub const VOXEL_SIZE: f64 = 0.03;
/// The lengths of normals and descriptors; no inlier distance takes part.
const LENGTHS: Lengths = Lengths {
    voxel_size: VOXEL_SIZE,
    normal_radius: 2.0 * VOXEL_SIZE,
    feature_radius: 7.0 * VOXEL_SIZE,
    inlier_distance: VOXEL_SIZE,
};
/// The preset with the paper's settings, and its radius of suppression in metres; the released code has 0.04.
const PAPER: (&str, Length) = ("3dmatch", Length::Units(0.05));

/// The detectors and descriptors to evaluate, and the models that they use.
pub struct Methods<'a> {
    pub models: Vec<NamedModel>,
    /// The model that was chosen for the first cloud, if none is named.
    chosen: Option<String>,
    combinations: Vec<Combination>,
    external: &'a [(String, PathBuf)],
    columns: &'a ColumnArguments,
    /// The largest number of keypoints of a cloud.
    most: usize,
    /// The radius of suppression of classical detectors and of keypoints from files.
    spacing: [Option<Length>; 2],
}

/// A built-in detector or descriptor, or the index of one of the `--external`.
#[derive(Clone, Copy)]
enum Source<T> {
    Builtin(T),
    Files(usize),
}

/// A detector and the model that runs it, with its descriptors and their models.
struct Combination {
    source: Source<Detector>,
    model: usize,
    descriptors: Vec<(Source<Descriptor>, usize)>,
}

impl<'a> Methods<'a> {
    /// The methods of the command line, whose models start from the options of registration.
    pub fn new(arguments: &'a RegistrationArguments, scenes: &Scenes) -> Result<Self> {
        let RegistrationArguments { external, nms_radius, options, .. } = arguments;
        let first = || arguments.run.columns.read(&scenes.clouds[scenes.pairs[0].target]);
        let models = arguments
            .run
            .load_models(&options.values(), first, |model| VoxelCloud::default_options(model, VOXEL_SIZE))?;
        let is_open = arguments.run.models.is_empty() && arguments.run.compute.is_open()?;
        let is_preset = options.preset() == Some(PAPER.0) && !options.given().contains_key("nms_radius");
        let paper = is_preset.then_some(PAPER.1);
        let resolve = |mut loaded: NamedModel| -> Result<NamedModel> {
            loaded.options = loaded.options.resolve(&options.values())?;
            if let Some(radius) = nms_radius.or(paper) {
                loaded.options.detect.nms_radius = none_if_zero(radius);
            }
            Ok(loaded)
        };
        let mut methods = Self {
            chosen: models.first().filter(|_| is_open).map(|loaded| builtin_name(&loaded.name).to_owned()),
            models: models.into_iter().map(resolve).collect::<Result<_>>()?,
            combinations: Vec::new(),
            external,
            columns: &arguments.run.columns,
            most: arguments.max_keypoints.iter().copied().max().unwrap_or_default(),
            spacing: [*nms_radius, nms_radius.or(paper)],
        };
        methods.combinations = methods.combine(arguments, scenes)?;
        Ok(methods)
    }

    /// All combinations, in the order of the command line. Keypoints of files also have the descriptors of their own files.
    fn combine(&self, arguments: &RegistrationArguments, scenes: &Scenes) -> Result<Vec<Combination>> {
        let names = arguments.detectors.iter().map(name_of).collect::<Vec<_>>();
        check_distinct("--detectors and --external", names.iter().chain(self.external.iter().map(|(name, _)| name)))?;
        check_distinct("--descriptors", arguments.descriptors.iter())?;
        let descriptors: Vec<Source<Descriptor>> =
            arguments.descriptors.iter().map(|name| self.descriptor(name)).collect::<Result<_>>()?;
        let with_models = |source: Source<Descriptor>, model: Option<usize>| {
            let models = match (model, source) {
                (Some(model), _) => model..model + 1,
                (None, Source::Builtin(Descriptor::Field)) => 0..self.models.len(),
                _ => 0..1,
            };
            models.map(move |model| (source, model))
        };
        let mut combinations = Vec::new();
        for &detector in &arguments.detectors {
            let is_model = detector == Detector::Snake;
            for model in 0..if is_model { self.models.len() } else { 1 } {
                let descriptors = descriptors.iter().flat_map(|&source| with_models(source, is_model.then_some(model)));
                let descriptors = descriptors.collect();
                combinations.push(Combination { source: Source::Builtin(detector), model, descriptors });
            }
        }
        for file in 0..self.external.len() {
            let is_own = |source: &Source<Descriptor>| matches!(source, Source::Files(other) if *other == file);
            let mut all = descriptors.clone();
            if !all.iter().any(is_own) && self.read(file, scenes, scenes.pairs[0].source, [0.0; 3])?.dimension > 0 {
                all.push(Source::Files(file));
            }
            let descriptors = all.into_iter().flat_map(|source| with_models(source, None)).collect();
            combinations.push(Combination { source: Source::Files(file), model: 0, descriptors });
        }
        Ok(combinations)
    }

    fn descriptor(&self, name: &str) -> Result<Source<Descriptor>> {
        let file = self.external.iter().position(|(other, _)| other == name).map(Source::Files);
        file.or(named(name).ok().map(Source::Builtin)).ok_or_else(|| {
            let known: Vec<&str> = self.external.iter().map(|(name, _)| &name[..]).collect();
            anyhow!("--descriptors names {name}: allowed is {}", [&["field", "fpfh"], &known[..]].concat().join(", "))
        })
    }

    /// The rows of the tables: one for each method and model.
    pub fn rows(&self) -> Vec<Method> {
        let file = |file: usize| self.external[file].0.clone();
        let mut rows = Vec::new();
        for Combination { source, descriptors, .. } in &self.combinations {
            let detector = match source {
                Source::Builtin(Detector::Snake) => self.with_model(name_of(&Detector::Snake)),
                Source::Builtin(detector) => name_of(detector),
                Source::Files(number) => file(*number),
            };
            rows.extend(descriptors.iter().map(|(source, _)| {
                let descriptor = match source {
                    Source::Builtin(Descriptor::Field) => self.with_model(name_of(&Descriptor::Field)),
                    Source::Builtin(descriptor) => name_of(descriptor),
                    Source::Files(number) => file(*number),
                };
                Method { detector: detector.clone(), descriptor }
            }));
        }
        rows
    }

    /// A name with the model that was chosen.
    fn with_model(&self, name: String) -> String {
        self.chosen.as_ref().map_or(name.clone(), |model| format!("{name} ({model})"))
    }

    /// Reads a cloud and computes the keypoints of each detector with their descriptors.
    fn cloud(&self, scenes: &Scenes, index: usize, seed: u64) -> Result<DescribedCloud> {
        let Cloud { points, origin } = self.columns.read(&scenes.clouds[index])?;
        let control = Control::default();
        let voxels = |loaded: &NamedModel| -> Result<VoxelCloud> {
            Ok(VoxelCloud::new(&points, &LENGTHS, &control)?.with_model(&loaded.model, loaded.options))
        };
        let clouds: Vec<VoxelCloud> = self.models.iter().map(voxels).collect::<Result<_>>()?;
        let read = |file| self.read(file, scenes, index, origin);
        let files: Vec<ExternalKeypoints> = (0..self.external.len()).map(read).collect::<Result<_>>()?;
        // The random keypoints of two clouds must be independent.
        let seed = seed.wrapping_add(index as u64);
        let mut features = Vec::new();
        for Combination { source, model, descriptors } in &self.combinations {
            let ranked = match source {
                Source::Builtin(detector) => {
                    clouds[*model].keypoints(*detector, self.candidates(*detector, &points), seed, &control)?
                }
                Source::Files(file) => files[*file].positions.clone(),
            };
            let keypoints = self.apart(ranked, *source, &points)?;
            for (descriptor, model) in descriptors {
                let (descriptors, dimension) = match descriptor {
                    Source::Builtin(descriptor) => {
                        let rows = clouds[*model].descriptors(&keypoints, *descriptor, &control)?;
                        (rows, clouds[*model].dimension(*descriptor)?)
                    }
                    Source::Files(file) => self.file_descriptors(*file, &files[*file], &keypoints)?,
                };
                features.push(Features { keypoints: keypoints.clone(), descriptors, dimension });
            }
        }
        Ok(DescribedCloud { points, origin, features })
    }

    /// The number of keypoints to find before suppression; the network suppresses itself.
    fn candidates(&self, detector: Detector, points: &[Point]) -> usize {
        let suppresses = detector == Detector::Snake || self.spacing[0].is_none();
        if suppresses { self.most } else { points.len() }
    }

    /// The best keypoints, farther apart than the radius of suppression.
    fn apart(&self, ranked: Vec<Point>, source: Source<Detector>, points: &[Point]) -> Result<Vec<Point>> {
        let spacing = match source {
            Source::Builtin(Detector::Snake) => None,
            Source::Builtin(_) => self.spacing[0],
            Source::Files(_) => self.spacing[1],
        };
        let radius = match spacing.and_then(none_if_zero) {
            Some(length) => length.in_units("nms_radius", points)?,
            None => 0.0,
        };
        Ok(suppress_ranked(&ranked, radius as f32, self.most)?.into_iter().map(|index| ranked[index]).collect())
    }

    /// Descriptors of keypoints from one of the files, and their length.
    fn file_descriptors(
        &self,
        file: usize,
        found: &ExternalKeypoints,
        keypoints: &[Point],
    ) -> Result<(Vec<f32>, usize)> {
        if found.descriptors.is_empty() && !keypoints.is_empty() {
            bail!("--external {}: no `descriptors` in the file, or no keypoint has one", self.external[file].0);
        }
        Ok((found.descriptors_at(keypoints)?, found.dimension))
    }

    fn read(&self, file: usize, scenes: &Scenes, cloud: usize, origin: [f64; 3]) -> Result<ExternalKeypoints> {
        let (name, folder) = &self.external[file];
        let path = folder.join(format!("{}.npz", scenes.cloud_name(cloud)));
        ExternalKeypoints::read(&path, origin).with_context(|| format!("--external {name}"))
    }
}

/// The name of a detector or descriptor on the command line.
fn name_of(value: &impl serde::Serialize) -> String {
    serde_json::to_value(value).ok().and_then(|name| Some(name.as_str()?.to_owned())).unwrap_or_default()
}

/// A cloud with the keypoints and descriptors of each method.
pub struct DescribedCloud {
    pub points: Vec<Point>,
    /// Offset to add to the points.
    pub origin: [f64; 3],
    pub features: Vec<Features>,
}

/// Keypoints, best first, each with a descriptor of `dimension` numbers.
pub struct Features {
    keypoints: Vec<Point>,
    descriptors: Vec<f32>,
    dimension: usize,
}

impl Features {
    /// The first `count` keypoints and descriptors, or all if there are fewer.
    pub fn best(&self, count: usize) -> (&[Point], &[f32]) {
        let count = count.min(self.keypoints.len());
        (&self.keypoints[..count], &self.descriptors[..count * self.dimension])
    }

    /// The length of descriptors that are to be matched with those of another cloud; 1 if neither has any.
    pub fn dimension_with(&self, other: &Self) -> Result<usize> {
        match (self.descriptors.len(), other.descriptors.len()) {
            (0, 0) => Ok(1),
            (0, _) => Ok(other.dimension),
            (_, 0) => Ok(self.dimension),
            _ if self.dimension == other.dimension => Ok(self.dimension),
            _ => bail!("descriptors of {} numbers and of {}", self.dimension, other.dimension),
        }
    }
}

/// A cache of the clouds of the current scene and seed.
#[derive(Default)]
pub struct Clouds {
    scene: String,
    seed: u64,
    described: HashMap<usize, DescribedCloud>,
}

impl Clouds {
    /// The source and target of a pair.
    pub fn of(
        &mut self,
        pair: &ScenePair,
        scenes: &Scenes,
        methods: &Methods,
        seed: u64,
    ) -> Result<[&DescribedCloud; 2]> {
        if (&self.scene, self.seed) != (&pair.scene, seed) {
            (self.scene, self.seed) = (pair.scene.clone(), seed);
            self.described.clear();
        }
        for index in [pair.source, pair.target] {
            if let Entry::Vacant(vacant) = self.described.entry(index) {
                let cloud = methods.cloud(scenes, index, seed);
                vacant.insert(cloud.with_context(|| scenes.clouds[index].display().to_string())?);
            }
        }
        Ok([&self.described[&pair.source], &self.described[&pair.target]])
    }
}

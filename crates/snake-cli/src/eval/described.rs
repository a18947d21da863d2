//! Clouds with the keypoints and descriptors that `snake-cli eval registration` compares.

use std::collections::HashMap;
use std::collections::hash_map::Entry;

use anyhow::{Context, Result, anyhow, bail};
use serde::Serialize;
use snake_core::{Builtin, Control, Model, NamedModel};
use snake_eval::ExternalKeypoints;
use snake_eval::datasets::{ScenePair, Scenes};
use snake_eval::reports::registration as reports;
use snake_geometry::{Cloud, Length, Point};
use snake_registration::steps::{Lengths, VoxelCloud};
use snake_registration::{Descriptor, Detector};

use super::args::RegistrationArguments;
use super::methods::{External, InFile, best, check_distinct};
use crate::inputs::ColumnArguments;
use crate::setup::{named, none_if_zero};

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
    /// The model that suits the first cloud, if none is named.
    which: Option<Builtin>,
    all: Vec<Method>,
    external: Vec<External<'a>>,
    columns: &'a ColumnArguments,
    /// The largest number of keypoints of a cloud.
    count: usize,
    /// The radius of suppression of classical detectors.
    spacing: Option<Length>,
    /// The radius of suppression of keypoints from files.
    file_spacing: Option<Length>,
}

/// A built-in detector or descriptor, or the index of one of the `--external`.
#[derive(Clone, Copy, PartialEq)]
enum Source<T> {
    Builtin(T),
    Files(usize),
}

/// A detector with a descriptor, and the model for those of them that run one.
struct Method {
    detector: Source<Detector>,
    descriptor: Source<Descriptor>,
    model: usize,
}

impl<'a> Methods<'a> {
    /// The methods of the command line, whose models start from the options of registration.
    pub fn new(arguments: &'a RegistrationArguments, scenes: &Scenes) -> Result<Self> {
        let RegistrationArguments { nms_radius, options, run, .. } = arguments;
        let first = || run.columns.read(&scenes.clouds[scenes.pairs[0].target]);
        let start = |model: &Model| VoxelCloud::default_options(model, VOXEL_SIZE);
        let which = if run.models.is_empty() { run.compute.suited(&options.values(), first)? } else { None };
        let mut models = run.load_models(which, start)?;
        let is_preset = options.preset() == Some(PAPER.0) && !options.given().contains_key("nms_radius");
        let spacing_or_paper = nms_radius.or(is_preset.then_some(PAPER.1));
        for loaded in &mut models {
            loaded.options = loaded.options.resolve(&options.values())?;
            if let Some(radius) = spacing_or_paper {
                loaded.options.detect.nms_radius = none_if_zero(radius);
            }
        }
        let mut methods = Self {
            which,
            models,
            all: Vec::new(),
            external: arguments.external.iter().map(|(name, folder)| External { name, folder }).collect(),
            columns: &run.columns,
            count: arguments.max_keypoints.iter().copied().max().unwrap_or_default(),
            spacing: *nms_radius,
            file_spacing: spacing_or_paper,
        };
        methods.all = methods.combine(arguments, scenes)?;
        Ok(methods)
    }

    /// All combinations, in the order of the command line. Keypoints of files also have the descriptors of their own files.
    fn combine(&self, arguments: &RegistrationArguments, scenes: &Scenes) -> Result<Vec<Method>> {
        let names: Vec<String> = arguments.detectors.iter().map(name_of).collect();
        check_distinct("--detectors and --external", names.iter().map(|name| &name[..]).chain(self.external_names()))?;
        check_distinct("--descriptors", arguments.descriptors.iter().map(|name| &name[..]))?;
        let descriptors: Vec<Source<Descriptor>> =
            arguments.descriptors.iter().map(|name| self.descriptor(name)).collect::<Result<_>>()?;
        let builtin = arguments.detectors.iter().map(|&detector| Source::Builtin(detector));
        let mut methods = Vec::new();
        for detector in builtin.chain((0..self.external.len()).map(Source::Files)) {
            let mut descriptors = descriptors.clone();
            if let Source::Files(file) = detector
                && !descriptors.contains(&Source::Files(file))
                && self.read(file, scenes, scenes.pairs[0].source, [0.0; 3])?.dimension > 0
            {
                descriptors.push(Source::Files(file));
            }
            let num_models = |runs_model: bool| if runs_model { self.models.len() } else { 1 };
            let is_snake = detector == Source::Builtin(Detector::Snake);
            for detector_model in 0..num_models(is_snake) {
                for &descriptor in &descriptors {
                    let is_field = descriptor == Source::Builtin(Descriptor::Field);
                    let models = if is_snake { detector_model..detector_model + 1 } else { 0..num_models(is_field) };
                    methods.extend(models.map(|model| Method { detector, descriptor, model }));
                }
            }
        }
        Ok(methods)
    }

    fn external_names(&self) -> impl Iterator<Item = &str> {
        self.external.iter().map(|external| external.name)
    }

    fn descriptor(&self, name: &str) -> Result<Source<Descriptor>> {
        let file = self.external_names().position(|other| other == name).map(Source::Files);
        file.or(named(name).ok().map(Source::Builtin)).ok_or_else(|| {
            let known: Vec<&str> = ["field", "fpfh"].into_iter().chain(self.external_names()).collect();
            anyhow!("--descriptors names {name}: allowed is {}", known.join(", "))
        })
    }

    /// The rows of the tables: one for each method and model.
    pub fn rows(&self) -> Vec<reports::Method> {
        let row = |method: &Method| reports::Method {
            detector: self.source_name(method.detector, Detector::Snake),
            descriptor: self.source_name(method.descriptor, Descriptor::Field),
        };
        self.all.iter().map(row).collect()
    }

    /// The name of a detector or descriptor; that of `network` has the model that was chosen.
    fn source_name<T: Serialize + PartialEq>(&self, source: Source<T>, network: T) -> String {
        match (source, self.which) {
            (Source::Files(file), _) => self.external[file].name.to_owned(),
            (Source::Builtin(value), Some(which)) if value == network => {
                format!("{} ({})", name_of(&value), which.name())
            }
            (Source::Builtin(value), _) => name_of(&value),
        }
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
        let keypoints = |detector: Source<Detector>, model: usize| match detector {
            // The network suppresses itself.
            Source::Builtin(Detector::Snake) => {
                let ranked = clouds[model].keypoints(Detector::Snake, self.count, seed, &control)?;
                best(ranked, None, self.count, &points)
            }
            Source::Builtin(detector) => {
                let candidates = if self.spacing.is_none() { self.count } else { points.len() };
                let ranked = clouds[0].keypoints(detector, candidates, seed, &control)?;
                best(ranked, self.spacing, self.count, &points)
            }
            Source::Files(file) => best(files[file].positions.clone(), self.file_spacing, self.count, &points),
        };
        let mut features: Vec<Features> = Vec::new();
        for (index, &Method { detector, descriptor, model }) in self.all.iter().enumerate() {
            let is_snake = detector == Source::Builtin(Detector::Snake);
            let is_same = |other: &Method| detector == other.detector && (!is_snake || model == other.model);
            let keypoints = match self.all[..index].iter().rposition(is_same) {
                Some(earlier) => features[earlier].keypoints.clone(),
                None => keypoints(detector, model)?,
            };
            let (descriptors, dimension) = match descriptor {
                Source::Builtin(descriptor) => {
                    let rows = clouds[model].descriptors(&keypoints, descriptor, &control)?;
                    (rows, clouds[model].dimension(descriptor)?)
                }
                Source::Files(file) if files[file].descriptors.is_empty() && !keypoints.is_empty() => {
                    let name = self.external[file].name;
                    bail!("--external {name}: no `descriptors` in the file, or no keypoint has one")
                }
                Source::Files(file) => (files[file].descriptors_at(&keypoints)?, files[file].dimension),
            };
            features.push(Features { keypoints, descriptors, dimension });
        }
        Ok(DescribedCloud { points, origin, features })
    }

    fn read(&self, file: usize, scenes: &Scenes, cloud: usize, origin: [f64; 3]) -> Result<ExternalKeypoints> {
        self.external[file].read(InFile { name: &scenes.cloud_name(cloud), origin })
    }
}

/// The name of a detector or descriptor on the command line.
fn name_of(value: &impl Serialize) -> String {
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

//! `snake-cli eval registration`: the 3DMatch benchmark for every detector and descriptor.

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use serde_json::{Value, json};
use snake_core::{Cloud, Model, Point};
use snake_eval::datasets::{ScenePair, Scenes};
use snake_eval::reports::registration::{Cases, INLIER_RATIO, RMSE, Report, Row};
use snake_eval::tables::paper::THREE_D_MATCH;
use snake_eval::{information_matrix, inlier_ratio, overlap, squared_registration_error};
use snake_registration::{RansacOptions, Scan, mutual_nearest, ransac};

use super::args::RegistrationArguments;
use super::files;
use super::record::Record;
use super::schedule::{Schedule, Task};
use crate::inputs::ColumnArguments;
use crate::terminal;

// Settings that the benchmark fixes; lengths are in metres.
/// Size of the voxels to which clouds are downsampled.
const VOXEL_SIZE: f64 = 0.03;
/// A correspondence is an inlier up to this distance under the true transform.
const INLIER_DISTANCE: f64 = 0.1;
/// A correspondence is an inlier of RANSAC below this distance.
const RANSAC_DISTANCE: f64 = 0.05;
/// The most samples of RANSAC.
const RANSAC_SAMPLES: usize = 50_000;
/// Without a gt.info, points nearer than this overlap.
const OVERLAP_DISTANCE: f64 = 0.05;

/// Evaluates every pair that is not yet recorded, then reports.
pub fn run(arguments: &RegistrationArguments) -> Result<()> {
    let scenes = Scenes::open(&arguments.data)?;
    let model = arguments.run.compute.load_model()?.model;
    let plan = Plan::new(arguments, &model)?;
    let schedule = Schedule::new(scenes.pairs.len(), &arguments.run)?;
    files::check(&arguments.run, "registration", scenes.clouds.iter().map(PathBuf::as_path))?;
    let settings = plan.settings(arguments);
    let output = arguments.run.output.as_deref();
    let mut record = Record::open(output, "registration", &settings, schedule.tasks().len())?;
    let mut clouds = Clouds::default();
    let rows = |Task { seed, index }| {
        let pair: &ScenePair = &scenes.pairs[index];
        let [source, target] = clouds.of(pair, &scenes.clouds, &plan, seed)?;
        plan.rows(pair, source, target, seed)
    };
    record.fill(schedule.tasks(), |pair| scenes.name(pair), rows)?;
    let pairs: Vec<&ScenePair> = schedule.chosen().iter().map(|&pair| &scenes.pairs[pair]).collect();
    let paper = arguments.run.paper.then_some(&THREE_D_MATCH);
    let report = Report::new(&plan.cases, &settings, &pairs, &schedule.by_seed(record.pairs()), paper)?;
    if let Some(output) = output {
        files::write(output, "registration", &report.files())?;
    }
    terminal::print_report(&report.text_lines().into_iter().collect())
}

/// The detectors, descriptors and numbers of keypoints to evaluate.
struct Plan<'a> {
    model: &'a Model,
    cases: Cases<'a>,
    columns: &'a ColumnArguments,
}

impl<'a> Plan<'a> {
    fn new(arguments: &'a RegistrationArguments, model: &'a Model) -> Result<Self> {
        let RegistrationArguments { detectors, descriptors, keypoints, .. } = arguments;
        if keypoints.contains(&0) {
            bail!("--keypoints must be 1 or more");
        }
        let cases = Cases { detectors, descriptors, keypoints };
        Ok(Self { model, cases, columns: &arguments.run.columns })
    }

    /// All settings that the figures depend on, without the content of the data.
    fn settings(&self, arguments: &RegistrationArguments) -> Value {
        json!({
            "metric": "registration",
            "data": arguments.data,
            "columns": arguments.run.columns.columns,
            "limit": arguments.run.limit,
            "detectors": self.cases.detectors,
            "descriptors": self.cases.descriptors,
            "keypoints": self.cases.keypoints,
            "model": self.model.metadata(),
            "voxel_size": VOXEL_SIZE,
            "inlier_distance": INLIER_DISTANCE,
            "inlier_ratio": INLIER_RATIO,
            "overlap_distance": OVERLAP_DISTANCE,
            "ransac": ransac_options(arguments.run.seed),
            "seeds": arguments.run.seeds,
            "rmse": RMSE,
        })
    }

    /// Reads a cloud and computes the keypoints of each detector with their descriptors.
    fn cloud(&self, files: &[PathBuf], index: usize, seed: u64) -> Result<DescribedCloud> {
        let Cloud { points, origin } = self.columns.read(&files[index])?;
        let scan = Scan::new(&points, self.model, VOXEL_SIZE)?;
        let most = self.cases.keypoints.iter().copied().max().unwrap_or_default();
        // The random keypoints of two clouds must be independent.
        let seed = seed.wrapping_add(index as u64);
        let mut features = Vec::new();
        for &detector in self.cases.detectors {
            let keypoints = scan.keypoints(detector, most, seed)?;
            for &descriptor in self.cases.descriptors {
                let (keypoints, dimension) = (keypoints.clone(), scan.dimension(descriptor));
                let descriptors = scan.descriptors(&keypoints, descriptor)?;
                features.push(Features { keypoints, descriptors, dimension });
            }
        }
        Ok(DescribedCloud { points, origin, features })
    }

    /// The figures of one pair: a row for each case.
    fn rows(&self, pair: &ScenePair, source: &DescribedCloud, target: &DescribedCloud, seed: u64) -> Result<Vec<Row>> {
        let truth = &pair.t_target_source.subtract_origins(source.origin, target.origin);
        // The matrix of gt.info holds for coordinates without an origin subtracted.
        let given = pair.information.filter(|_| source.origin == [0.0; 3]);
        let information = match given {
            Some(information) => information,
            None => information_matrix(&overlap(&source.points, &target.points, truth, OVERLAP_DISTANCE)?)
                .context("the clouds do not overlap under the given transform")?,
        };
        let mut rows = Vec::new();
        for (source, target) in source.features.iter().zip(&target.features) {
            for &count in self.cases.keypoints {
                let [(source_points, source_rows), (target_points, target_rows)] =
                    [source.best(count), target.best(count)];
                let matches = mutual_nearest(source_rows, target_rows, source.dimension)?;
                let from: Vec<Point> = matches.iter().map(|&[row, _]| source_points[row]).collect();
                let to: Vec<Point> = matches.iter().map(|&[_, row]| target_points[row]).collect();
                let found = ransac(&from, &to, &ransac_options(seed))?;
                let squared_error =
                    found.map(|found| squared_registration_error(truth, &found.t_target_source, &information));
                rows.push(Row {
                    found: (source_points.len() + target_points.len()) as f64 / 2.0,
                    correspondences: matches.len(),
                    inlier_ratio: inlier_ratio(&from, &to, truth, INLIER_DISTANCE)?,
                    squared_error: squared_error.transpose()?,
                });
            }
        }
        Ok(rows)
    }
}

/// The benchmark's options of RANSAC.
fn ransac_options(seed: u64) -> RansacOptions {
    RansacOptions::default().with_inlier_distance(RANSAC_DISTANCE).with_max_iterations(RANSAC_SAMPLES).with_seed(seed)
}

/// A cloud with the keypoints and descriptors of each combination of detector and descriptor.
struct DescribedCloud {
    points: Vec<Point>,
    /// Offset to add to the points.
    origin: [f64; 3],
    features: Vec<Features>,
}

/// Keypoints, best first, each with a descriptor of `dimension` numbers.
struct Features {
    keypoints: Vec<Point>,
    descriptors: Vec<f32>,
    dimension: usize,
}

impl Features {
    /// The first `count` keypoints and descriptors, or all if there are fewer.
    fn best(&self, count: usize) -> (&[Point], &[f32]) {
        let count = count.min(self.keypoints.len());
        (&self.keypoints[..count], &self.descriptors[..count * self.dimension])
    }
}

/// A cache of the clouds of the current scene and seed.
#[derive(Default)]
struct Clouds {
    scene: String,
    seed: u64,
    described: HashMap<usize, DescribedCloud>,
}

impl Clouds {
    /// The source and target of a pair.
    fn of(&mut self, pair: &ScenePair, files: &[PathBuf], plan: &Plan, seed: u64) -> Result<[&DescribedCloud; 2]> {
        if (&self.scene, self.seed) != (&pair.scene, seed) {
            (self.scene, self.seed) = (pair.scene.clone(), seed);
            self.described.clear();
        }
        for index in [pair.source, pair.target] {
            if let Entry::Vacant(vacant) = self.described.entry(index) {
                let cloud = plan.cloud(files, index, seed).with_context(|| files[index].display().to_string())?;
                vacant.insert(cloud);
            }
        }
        Ok([&self.described[&pair.source], &self.described[&pair.target]])
    }
}

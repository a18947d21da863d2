//! `snake-cli eval registration`: the 3DMatch benchmark for every detector and descriptor.

use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use serde_json::{Value, json};
use snake_core::NamedModel;
use snake_core::Point;
use snake_eval::datasets::{ScenePair, Scenes};
use snake_eval::reports::Sample;
use snake_eval::reports::registration::{Cases, INLIER_RATIO, RMSE, Row, report};
use snake_eval::tables::paper::THREE_D_MATCH;
use snake_eval::{
    Meeting, RansacOptions, information_matrix, inlier_ratio, overlap, ransac, squared_registration_error,
};
use snake_registration::mutual_nearest;

use super::args::RegistrationArguments;
use super::described::{Clouds, DescribedCloud, Methods, VOXEL_SIZE};
use super::meeting::warn_if_apart;
use super::record::Task;
use super::schedule::Schedule;

// Settings that the benchmark fixes; lengths are in metres.
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
    if arguments.max_keypoints.contains(&0) {
        bail!("--max-keypoints must be 1 or more");
    }
    let methods = Methods::new(arguments, &scenes)?;
    let schedule = Schedule::new(scenes.pairs.len(), &arguments.run)?;
    warn_if_apart(schedule.chosen(), |pair| {
        let ScenePair { source, target, t_target_source, .. } = &scenes.pairs[pair];
        let read = |cloud: usize| arguments.run.columns.read(&scenes.clouds[cloud]);
        let [source, target] = [read(*source)?, read(*target)?];
        let truth = t_target_source.subtract_origins(source.origin, target.origin);
        Ok(Some((scenes.name(pair), Meeting::of(&source.points, &target.points, &truth)?)))
    });
    let settings = settings(arguments, &methods);
    let mut clouds = Clouds::default();
    let rows_of = |Task { seed, index }| {
        let pair: &ScenePair = &scenes.pairs[index];
        let [source, target] = clouds.of(pair, &scenes, &methods, seed)?;
        rows(&arguments.max_keypoints, pair, source, target, seed)
    };
    let pairs: Vec<&ScenePair> = schedule.chosen().iter().map(|&pair| &scenes.pairs[pair]).collect();
    let paper = arguments.run.paper.then_some(&THREE_D_MATCH);
    let cases = Cases { methods: &methods.rows(), keypoints: &arguments.max_keypoints };
    let report = |runs: &[&[Sample<Row>]]| report(&cases, &settings, &pairs, runs, paper);
    let inputs = scenes.clouds.iter().map(PathBuf::as_path);
    schedule.evaluate("registration", &settings, inputs, |pair| scenes.name(pair), rows_of, report)
}

/// All settings that the figures depend on, without the content of the data.
fn settings(arguments: &RegistrationArguments, methods: &Methods) -> Value {
    let model = |loaded: &NamedModel| json!({"model": loaded.model.metadata(), "options": loaded.options});
    json!({
        "metric": "registration",
        "data": arguments.data,
        "columns": arguments.run.columns.columns,
        "limit": arguments.run.limit,
        "detectors": arguments.detectors,
        "descriptors": arguments.descriptors,
        "external": arguments.external,
        "keypoints": arguments.max_keypoints,
        "nms_radius": arguments.nms_radius,
        "preset": arguments.options.preset(),
        "models": methods.models.iter().map(model).collect::<Vec<_>>(),
        "voxel_size": VOXEL_SIZE,
        "inlier_distance": INLIER_DISTANCE,
        "inlier_ratio": INLIER_RATIO,
        "overlap_distance": OVERLAP_DISTANCE,
        "ransac": ransac_options(arguments.run.seed),
        "seeds": arguments.run.seeds,
        "rmse": RMSE,
    })
}

/// The figures of one pair: a row for each method and number of keypoints.
fn rows(
    counts: &[usize],
    pair: &ScenePair,
    source: &DescribedCloud,
    target: &DescribedCloud,
    seed: u64,
) -> Result<Vec<Row>> {
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
        let dimension = source.dimension_with(target)?;
        for &count in counts {
            let [(source_points, source_rows), (target_points, target_rows)] = [source.best(count), target.best(count)];
            let matches = mutual_nearest(source_rows, target_rows, dimension)?;
            let from: Vec<Point> = matches.iter().map(|&[row, _]| source_points[row]).collect();
            let to: Vec<Point> = matches.iter().map(|&[_, row]| target_points[row]).collect();
            let consensus = ransac(&from, &to, &ransac_options(seed))?;
            let squared_error =
                consensus.map(|consensus| squared_registration_error(truth, &consensus.t_target_source, &information));
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

/// The benchmark's options of RANSAC.
fn ransac_options(seed: u64) -> RansacOptions {
    RansacOptions::default().with_inlier_distance(RANSAC_DISTANCE).with_max_iterations(RANSAC_SAMPLES).with_seed(seed)
}

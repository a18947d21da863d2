//! `snake-cli eval semantic`.

use anyhow::Result;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};
use snake_core::{Cloud, Length, Point};
use snake_eval::datasets::SemanticData;
use snake_eval::reports::Sample;
use snake_eval::reports::semantic::{Row, report};
use snake_eval::tables::paper;
use snake_eval::{RankedKeypoints, SmplProtocol, Unreachable, radius_of_coverage, semantic_counts, smpl_pair_counts};

use super::args::{EvalArguments, SemanticArguments};
use super::methods::{InFile, Method, count_models};
use super::record::Task;
use super::schedule::Schedule;
use crate::terminal;

/// The suppression radius of the paper's figures.
const SPACING: Length = Length::Units(0.1);

/// Evaluates every shape that is not yet recorded, then reports.
pub fn run(arguments: &SemanticArguments) -> Result<()> {
    let common = &arguments.common;
    let data = SemanticData::open(&arguments.data, arguments.split.as_deref())?;
    let methods = Method::all(common, Some(SPACING))?;
    let settings = settings(arguments, &methods);
    let schedule = Schedule::new(data.len(), &common.run)?;
    let radii = radii(&data, &schedule, &methods, common)?;
    let inputs = data.files().into_iter().chain([&*arguments.data]).chain(arguments.split.as_deref());
    let paper = common.run.paper.then_some(match data {
        SemanticData::KeypointNet(_) => &paper::KEYPOINTNET,
        _ => &paper::SMPL,
    });
    let classes: Vec<Option<&str>> = schedule.chosen().iter().map(|&shape| data.class(shape)).collect();
    let report = |runs: &[&[Sample<Row>]]| report(&arguments.threshold, &settings, runs, &classes, paper);
    let rows = |task| rows(&data, task, &methods, &radii, arguments);
    schedule.evaluate("semantic", &settings, inputs, |shape| data.name(shape), rows, report)
}

/// All settings that the figures depend on, without the content of the data.
fn settings(arguments: &SemanticArguments, methods: &[Method]) -> Value {
    json!({
        "metric": "semantic consistency",
        "data": arguments.data,
        "columns": arguments.common.run.columns.columns,
        "split": arguments.split,
        "keypoints": Method::all_settings(&arguments.common, methods),
        "threshold": arguments.threshold,
    })
}

/// The random choices on one shape: those of a body model, and the seeds of the first and second cloud and of filling up.
fn draws(Task { seed, index: shape }: Task) -> (ChaCha8Rng, [u64; 3]) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(shape as u64);
    let seeds = std::array::from_fn(|_| rng.random());
    (rng, seeds)
}

/// With `--coverage`, the radius of suppression of each method, from the first clouds of the first seed.
fn radii(
    data: &SemanticData,
    schedule: &Schedule,
    methods: &[Method],
    arguments: &EvalArguments,
) -> Result<Vec<Option<f64>>> {
    let Some(coverage) = arguments.coverage else { return Ok(vec![None; methods.len()]) };
    let seed = schedule.tasks()[0].seed;
    let bar = terminal::progress(methods.len())?;
    bar.set_message("the radius at which each method covers as far");
    let of = |method: &Method| {
        let ranked = |&index: &usize| {
            let (mut rng, [seed, ..]) = draws(Task { seed, index });
            let body_shape = |points| (points, [0.0; 3], body_name(1, index));
            let (points, origin, name) = match data {
                SemanticData::KeypointNet(shapes) => {
                    let Cloud { points, origin } = arguments.run.columns.read(&shapes[index].cloud)?;
                    (points, origin, data.name(index))
                }
                SemanticData::Bodies([first, _]) => body_shape(first[index].clone()),
                SemanticData::BodyModel(pairs) => {
                    let [first, _] = pairs.bodies(index, &mut rng)?;
                    body_shape(first)
                }
            };
            let ranked = method.candidates(&points, Some(InFile { name: &name, origin }), seed)?;
            Ok(RankedKeypoints { points, keypoints: ranked.positions })
        };
        let ranked = schedule.chosen().iter().map(ranked).collect::<Result<Vec<_>>>()?;
        bar.step();
        Ok(Some(radius_of_coverage(&ranked, method.count(), coverage)?))
    };
    let radii = methods.iter().map(of).collect();
    bar.finish();
    radii
}

/// The name of one body of a pair, `which` is 1 or 2, in files of keypoints.
fn body_name(which: usize, pair: usize) -> String {
    format!("body_{which}_{pair}")
}

/// The matches on one shape: a row for each method.
fn rows(
    data: &SemanticData,
    task: Task,
    methods: &[Method],
    radii: &[Option<f64>],
    arguments: &SemanticArguments,
) -> Result<Vec<Row>> {
    let (mut rng, [seed_1, seed_2, fill_seed]) = draws(task);
    let shape = task.index;
    let threshold = &arguments.threshold;
    let compare_bodies = |body_1: &[Point], body_2: &[Point]| {
        let row = |(method, radius): (&Method, &Option<f64>)| {
            let names = [1, 2].map(|which| body_name(which, shape));
            let [file_1, file_2] = names.each_ref().map(|name| Some(InFile { name, origin: [0.0; 3] }));
            let on_1 = method.keypoints(body_1, file_1, seed_1, *radius)?;
            let on_2 = method.keypoints(body_2, file_2, seed_2, *radius)?;
            let ranked = [on_1, on_2];
            let models = count_models(&ranked);
            let [on_1, on_2] = ranked.map(|ranked| ranked.positions);
            let counts = |rule| smpl_pair_counts(body_1, body_2, &on_1, &on_2, threshold, rule);
            let paper = counts(SmplProtocol::PaperCompatible { seed: fill_seed })?;
            let strict = counts(SmplProtocol::Strict)?;
            Ok(Row { method: method.name().into(), models, keypoints: on_1.len(), strict, paper })
        };
        methods.iter().zip(radii).map(row).collect()
    };
    match data {
        SemanticData::KeypointNet(shapes) => {
            // The annotations are indices of points, so the origin matters to keypoints in files only.
            let Cloud { points, origin } = arguments.common.run.columns.read(&shapes[shape].cloud)?;
            let name = data.name(shape);
            let row = |(method, radius): (&Method, &Option<f64>)| {
                let ranked = [method.keypoints(&points, Some(InFile { name: &name, origin }), seed_1, *radius)?];
                let models = count_models(&ranked);
                let [keypoints] = ranked.map(|ranked| ranked.positions);
                let counts = |rule| semantic_counts(&points, &shapes[shape].keypoints, &keypoints, threshold, rule);
                let (strict, paper) = (counts(Unreachable::Strict)?, counts(Unreachable::PaperCompatible)?);
                Ok(Row { method: method.name().into(), models, keypoints: keypoints.len(), strict, paper })
            };
            methods.iter().zip(radii).map(row).collect()
        }
        SemanticData::Bodies([first, second]) => compare_bodies(&first[shape], &second[shape]),
        SemanticData::BodyModel(pairs) => {
            let [body_1, body_2] = pairs.bodies(shape, &mut rng)?;
            compare_bodies(&body_1, &body_2)
        }
    }
}

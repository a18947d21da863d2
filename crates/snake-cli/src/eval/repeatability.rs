//! `snake-cli eval repeatability`.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use serde_json::{Value, json};
use snake_core::Point;
use snake_eval::datasets::{Scale, ViewPairs};
use snake_eval::reports::Sample;
use snake_eval::reports::repeatability::{Row, Sweeps, report};
use snake_eval::tables::paper;
use snake_eval::views::{Condition, PairClouds, Views};
use snake_eval::{
    Meeting, RankedKeypoints, mean_distance_to_keypoints, radius_of_coverage, relative_repeatability,
    repeatability_beyond_chance, share_on_flat_places,
};
use snake_io as io;

use super::args::RepeatabilityArguments;
use super::meeting::warn_if_apart;
use super::methods::{InFile, Method, count_models};
use super::record::Task;
use super::schedule::Schedule;
use crate::inputs::{ColumnArguments, expand};
use crate::terminal;
use crate::{FAILURE, SUCCESS};

/// Evaluates every pair that is not yet recorded, then reports.
pub fn run(arguments: &RepeatabilityArguments) -> Result<u8> {
    let common = &arguments.common;
    let columns = &common.run.columns;
    let (data, left_out) = open(arguments)?;
    let plan = Plan::new(arguments, &data)?;
    let methods = Method::all(common, None)?;
    let schedule = Schedule::new(data.len(), &common.run)?;
    warn_if_apart(schedule.chosen(), |pair| meeting(&data, columns, pair));
    let radii = plan.radii(&data, columns, &schedule, &methods, common.coverage)?;
    let mut settings = plan.settings(arguments, &methods);
    if let Some(split) = &arguments.split {
        settings["split"] = json!(split);
    }
    if !left_out.is_empty() {
        settings["left_out"] = json!(left_out);
    }
    let inputs = data.files().into_iter().chain(arguments.transform.as_deref()).chain(arguments.split.as_deref());
    let paper = match data.scale() {
        _ if !common.run.paper => None,
        Scale::Room => Some(&paper::REDWOOD),
        Scale::Object => Some(&paper::MODELNET40),
        Scale::Annotated => Some(&paper::KEYPOINTNET_VIEWS),
    };
    let report = |runs: &[&[Sample<Row>]]| Ok(report(&plan.sweeps, &settings, runs, paper));
    let rows = |task| plan.rows(&data, columns, task, &methods, &radii);
    schedule.evaluate("repeatability", &settings, inputs, |pair| data.name(pair), rows, report)?;
    Ok(if left_out.is_empty() { SUCCESS } else { FAILURE })
}

/// Opens the data set of the command line: two clouds with their transform, the clouds of a list, a folder in a known layout,
/// or cloud files. Also
/// returns the cloud files that are left out.
fn open(arguments: &RepeatabilityArguments) -> Result<(ViewPairs, Vec<PathBuf>)> {
    let inputs = &arguments.data[..];
    if let Some(transform) = &arguments.transform {
        return Ok((open_pair(inputs, transform)?, Vec::new()));
    }
    if let Some(split) = &arguments.split {
        let [folder] = inputs else { bail!("--split needs one folder, that of KeypointNet's clouds") };
        return Ok((ViewPairs::from_split(folder, split)?, Vec::new()));
    }
    if let [folder] = inputs
        && let Some(data) = ViewPairs::open(folder)?
    {
        return Ok((data, Vec::new()));
    }
    objects(expand(inputs, None)?, &arguments.common.run.columns)
}

/// Cloud files as objects, and those of several that have no cloud, each of which is named.
fn objects(files: Vec<PathBuf>, columns: &ColumnArguments) -> Result<(ViewPairs, Vec<PathBuf>)> {
    let data = ViewPairs::from_objects(files.clone());
    if files.len() == 1 {
        return Ok((data, Vec::new()));
    }
    let (mut used, mut left_out) = (Vec::new(), Vec::new());
    for (index, file) in files.into_iter().enumerate() {
        match data.clouds(index, &columns.options()) {
            Ok(_) => used.push(file),
            Err(error) => {
                let (name, error) = (file.display().to_string(), error.to_string());
                let reason = error.strip_prefix(&format!("{name}: ")).unwrap_or(&error);
                terminal::warn(&format!("{name} is left out: {reason}"));
                left_out.push(file);
            }
        }
    }
    if used.is_empty() {
        bail!("none of the {} files has a cloud to evaluate", left_out.len());
    }
    Ok((ViewPairs::from_objects(used), left_out))
}

fn open_pair(inputs: &[PathBuf], transform: &Path) -> Result<ViewPairs> {
    let [source, target] = inputs else {
        bail!("--transform needs two clouds, SOURCE and TARGET; for several pairs give a folder with pairs.json");
    };
    let t_target_source = io::read_transform(transform).context("--transform")?;
    Ok(ViewPairs::from_pair(source, target, t_target_source))
}

/// The name of a pair and its [`Meeting`]; `None` for an object.
fn meeting(data: &ViewPairs, columns: &ColumnArguments, pair: usize) -> Result<Option<(String, Meeting)>> {
    match data.clouds(pair, &columns.options())? {
        PairClouds::Object(_) => Ok(None),
        PairClouds::Real { clouds: [first, second], t_1_2, .. } => {
            Ok(Some((data.name(pair), Meeting::of(&second, &first, &t_1_2)?)))
        }
    }
}

/// The neighbourhood that tells whether a keypoint stands on a flat place, in multiples of the tables' epsilon.
const FLAT_RADIUS: f64 = 1.5;

/// The suppression radius for each condition and method, in units of the data set; `None` for the method's own.
type Radii = Vec<Vec<Option<f64>>>;

/// The files of keypoints of the two clouds of a pair; `None` for clouds without names.
fn in_files<'a>(data: &'a ViewPairs, pair: usize, origins: &[[f64; 3]; 2]) -> [Option<InFile<'a>>; 2] {
    let names = data.cloud_names(pair);
    [0, 1].map(|which| names.map(|names| InFile { name: &names[which], origin: origins[which] }))
}

/// The thresholds, conditions and number of points to evaluate.
struct Plan {
    sweeps: Sweeps,
    num_points: usize,
}

impl Plan {
    fn new(arguments: &RepeatabilityArguments, data: &ViewPairs) -> Result<Self> {
        // The columns of the paper's tables: ModelNet40, in units of the objects' radius, KeypointNet in its own, and Redwood, in
        // metres.
        let hundredths = |range: std::ops::RangeInclusive<u32>, step| {
            range.step_by(step).map(|hundredth| f64::from(hundredth) / 100.0).collect::<Vec<_>>()
        };
        let (epsilon, table_epsilon, noise, num_points) = match data.scale() {
            Scale::Room => (hundredths(10..=24, 2), 0.2, hundredths(0..=10, 2), 10_240),
            Scale::Object => (hundredths(3..=10, 1), 0.04, hundredths(0..=12, 2), 5000),
            Scale::Annotated => (vec![0.03, 0.05, 0.07, 0.09, 0.1], 0.03, vec![0.0, 0.02, 0.03], 2048),
        };
        let epsilon = arguments.epsilon.clone().unwrap_or(epsilon);
        let noise = arguments.noise.clone().unwrap_or(noise);
        let num_points = arguments.num_points.unwrap_or(num_points);
        let table_epsilon = match arguments.table_epsilon {
            Some(given) => given,
            None if epsilon.contains(&table_epsilon) => table_epsilon,
            None => epsilon[0],
        };
        if !epsilon.contains(&table_epsilon) {
            bail!("--table-epsilon is {table_epsilon}: allowed are the values of --epsilon");
        }
        if let Some(bad) = noise.iter().find(|sigma| !(0.0..=1e30).contains(*sigma)) {
            bail!("--noise is {bad}: allowed is 0 or more");
        }
        if arguments.downsample.contains(&0) || num_points == 0 {
            bail!("--downsample and --num-points must be 1 or more");
        }
        let clean = Condition { downsample: 1, noise: 0.0 };
        let mut conditions = vec![clean];
        conditions.extend(arguments.downsample.iter().map(|&downsample| Condition { downsample, ..clean }));
        conditions.extend(noise.iter().map(|&noise| Condition { noise, ..clean }));
        // The clean views belong to both sweeps and are measured once.
        let mut distinct: Vec<Condition> = Vec::new();
        for condition in conditions {
            if !distinct.contains(&condition) {
                distinct.push(condition);
            }
        }
        Ok(Self { sweeps: Sweeps { epsilon, table_epsilon, conditions: distinct }, num_points })
    }

    /// All settings that the figures depend on, without the content of the data.
    fn settings(&self, arguments: &RepeatabilityArguments, methods: &[Method]) -> Value {
        json!({
            "metric": "relative repeatability",
            "data": arguments.data,
            "columns": arguments.common.run.columns.columns,
            "transform": arguments.transform,
            "keypoints": Method::all_settings(&arguments.common, methods),
            "num_points": self.num_points,
            "epsilon": self.sweeps.epsilon,
            "conditions": self.sweeps.conditions,
        })
    }

    /// With `--coverage`, the radius of suppression of each method under each condition, from the first views of the first seed.
    fn radii(
        &self,
        data: &ViewPairs,
        columns: &ColumnArguments,
        schedule: &Schedule,
        methods: &[Method],
        coverage: Option<f64>,
    ) -> Result<Radii> {
        let Some(coverage) = coverage else { return Ok(vec![vec![None; methods.len()]; self.sweeps.conditions.len()]) };
        let seed = schedule.tasks()[0].seed;
        let clouds = |index: &usize| Ok((*index, data.clouds(*index, &columns.options())?));
        let clouds: Vec<(usize, PairClouds)> = schedule.chosen().iter().map(clouds).collect::<Result<_>>()?;
        let bar = terminal::progress(self.sweeps.conditions.len() * methods.len())?;
        bar.set_message("the radius at which each method covers as far");
        let mut radii = Vec::new();
        for condition in &self.sweeps.conditions {
            let of = |method: &Method| {
                let ranked = |(index, clouds): &(usize, PairClouds)| -> Result<RankedKeypoints> {
                    let Views { view_1, seeds, origins, .. } =
                        clouds.views(*condition, self.num_points, seed, *index)?;
                    let ranked = method.candidates(&view_1, in_files(data, *index, &origins)[0], seeds[0])?;
                    Ok(RankedKeypoints { points: view_1, keypoints: ranked.positions })
                };
                let ranked = clouds.iter().map(ranked).collect::<Result<Vec<_>>>()?;
                bar.step();
                Ok(Some(radius_of_coverage(&ranked, method.count(), coverage)?))
            };
            radii.push(methods.iter().map(of).collect::<Result<Vec<_>>>()?);
        }
        bar.finish();
        Ok(radii)
    }

    /// The figures of one pair: a row for each method and condition.
    fn rows(
        &self,
        data: &ViewPairs,
        columns: &ColumnArguments,
        Task { seed, index }: Task,
        methods: &[Method],
        radii: &Radii,
    ) -> Result<Vec<Row>> {
        let clouds = data.clouds(index, &columns.options())?;
        let mut rows = Vec::new();
        for (condition, radii) in self.sweeps.conditions.iter().zip(radii) {
            let Views { view_1, view_2, t_1_2, seeds, origins } =
                clouds.views(*condition, self.num_points, seed, index)?;
            let files = in_files(data, index, &origins);
            for (method, radius) in methods.iter().zip(radii) {
                let keypoints =
                    |view: &[Point], which: usize| method.keypoints(view, files[which], seeds[which], *radius);
                let ranked = [keypoints(&view_1, 0)?, keypoints(&view_2, 1)?];
                let models = count_models(&ranked);
                let [first, second] = ranked.map(|ranked| ranked.positions);
                let repeatability = relative_repeatability(&first, &second, &t_1_2, &self.sweeps.epsilon)?;
                let beyond_chance =
                    repeatability_beyond_chance(&first, &second, &view_2, &t_1_2, &self.sweeps.epsilon)?;
                let flat = share_on_flat_places(&view_1, &first, FLAT_RADIUS * self.sweeps.table_epsilon)?;
                let coverage = if first.is_empty() { None } else { Some(mean_distance_to_keypoints(&view_1, &first)?) };
                let keypoints = first.len();
                rows.push(Row {
                    method: method.name().into(),
                    models,
                    condition: *condition,
                    keypoints,
                    coverage,
                    repeatability,
                    beyond_chance,
                    flat,
                });
            }
        }
        Ok(rows)
    }
}

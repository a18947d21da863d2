//! `snake-cli eval repeatability`.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use serde_json::{Value, json};
use snake_eval::datasets::{Scale, ViewPairs};
use snake_eval::reports::repeatability::{Report, Row, Sweeps};
use snake_eval::tables::paper;
use snake_eval::views::{Condition, Views};
use snake_eval::{mean_distance_to_keypoints, relative_repeatability};
use snake_io as io;

use super::args::RepeatabilityArguments;
use super::files;
use super::methods::Method;
use super::record::Record;
use super::schedule::{Schedule, Task};
use crate::inputs::{ColumnArguments, expand};
use crate::terminal;

/// Evaluates every pair that is not yet recorded, then reports.
pub fn run(arguments: &RepeatabilityArguments) -> Result<()> {
    let common = &arguments.common;
    let data = open(arguments)?;
    let columns = &common.run.columns;
    let plan = Plan::new(arguments, &data)?;
    let methods = Method::all(common, None)?;
    let settings = plan.settings(arguments, &methods);
    let schedule = Schedule::new(data.len(), &common.run)?;
    let inputs = data.files().into_iter().chain(arguments.transform.as_deref());
    files::check(&common.run, "repeatability", inputs)?;
    let mut record = Record::open(common.run.output.as_deref(), "repeatability", &settings, schedule.tasks().len())?;
    record.fill(schedule.tasks(), |pair| data.name(pair), |task| plan.rows(&data, columns, task, &methods))?;
    let paper = match data.scale() {
        _ if !common.run.paper => None,
        Scale::Room => Some(&paper::REDWOOD),
        Scale::Object => Some(&paper::MODELNET40),
    };
    let report = Report::new(&plan.sweeps, &settings, &schedule.by_seed(record.pairs()), paper);
    if let Some(output) = &common.run.output {
        files::write(output, "repeatability", &report.files())?;
    }
    terminal::print_report(&report.text_lines().into_iter().collect())
}

/// Opens the data set of the command line: two clouds with their transform, a folder in a known layout, or cloud files.
fn open(arguments: &RepeatabilityArguments) -> Result<ViewPairs> {
    let inputs = &arguments.data[..];
    if let Some(transform) = &arguments.transform {
        return open_pair(inputs, transform);
    }
    if let [folder] = inputs
        && let Some(data) = ViewPairs::open(folder)?
    {
        return Ok(data);
    }
    Ok(ViewPairs::from_objects(expand(inputs, None, |_| false)?))
}

fn open_pair(inputs: &[PathBuf], transform: &Path) -> Result<ViewPairs> {
    let [source, target] = inputs else {
        bail!("--transform needs two clouds, SOURCE and TARGET; for several pairs give a folder with pairs.json");
    };
    let t_target_source = io::read_transform(transform).context("--transform")?;
    Ok(ViewPairs::from_pair(source, target, t_target_source))
}

/// The thresholds, conditions and number of points to evaluate.
struct Plan {
    sweeps: Sweeps,
    num_points: usize,
}

impl Plan {
    fn new(arguments: &RepeatabilityArguments, data: &ViewPairs) -> Result<Self> {
        // The columns of the paper's tables: ModelNet40, in units of the objects' radius, and Redwood, in metres.
        let hundredths = |range: std::ops::RangeInclusive<u32>, step| {
            range.step_by(step).map(|hundredth| f64::from(hundredth) / 100.0).collect::<Vec<_>>()
        };
        let (epsilon, table_epsilon, noise, num_points) = match data.scale() {
            Scale::Room => (hundredths(10..=24, 2), 0.2, hundredths(0..=10, 2), 10_240),
            Scale::Object => (hundredths(3..=10, 1), 0.04, hundredths(0..=12, 2), 5000),
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

    /// The figures of one pair: a row for each method and condition.
    fn rows(
        &self,
        data: &ViewPairs,
        columns: &ColumnArguments,
        Task { seed, index }: Task,
        methods: &[Method],
    ) -> Result<Vec<Row>> {
        let clouds = data.clouds(index, &columns.options())?;
        let mut rows = Vec::new();
        for condition in &self.sweeps.conditions {
            let Views { view_1, view_2, t_1_2, seeds } = clouds.views(*condition, self.num_points, seed, index)?;
            for method in methods {
                let (first, second) = (method.keypoints(&view_1, seeds[0])?, method.keypoints(&view_2, seeds[1])?);
                let repeatability = relative_repeatability(&first, &second, &t_1_2, &self.sweeps.epsilon)?;
                let coverage = if first.is_empty() { None } else { Some(mean_distance_to_keypoints(&view_1, &first)?) };
                let keypoints = first.len();
                rows.push(Row {
                    method: method.name().into(),
                    condition: *condition,
                    keypoints,
                    coverage,
                    repeatability,
                });
            }
        }
        Ok(rows)
    }
}

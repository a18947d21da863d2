//! `snake-cli eval`: metrics of keypoints over data sets.

mod data;
mod methods;
mod record;
mod report;
mod views;

use anyhow::{Context, Result, bail};
use indicatif::{ProgressBar, ProgressStyle};
use serde_json::{Value, json};
use snake_core::metrics::{mean_distance_to_keypoints, relative_repeatability};

use crate::args::{ProtocolName, RepeatabilityArguments};
use data::{Data, Scale};
use methods::Method;
use record::{Record, Row};
use report::{PaperRow, Report};
use views::{Condition, Views};

/// Evaluates every pair that is not yet recorded, then reports.
pub fn repeatability(arguments: &RepeatabilityArguments) -> Result<()> {
    if let Some(threads) = arguments.threads {
        rayon::ThreadPoolBuilder::new().num_threads(threads.into()).build_global()?;
    }
    let data = Data::open(&arguments.data)?;
    let plan = Plan::new(arguments, &data)?;
    let methods = Method::all(arguments)?;
    let settings = plan.settings(arguments, &methods);
    let chosen = evenly_spaced(data.len(), arguments.limit)?;
    let mut record = Record::open(arguments.output.as_deref(), &settings, chosen.len())?;
    let bar = ProgressBar::new(chosen.len() as u64).with_position(record.len() as u64);
    bar.set_style(ProgressStyle::with_template("{bar:30} {pos}/{len} {msg} (ETA {eta})")?);
    bar.reset_eta();
    for &pair in &chosen[record.len()..] {
        bar.set_message(data.name(pair));
        let rows = plan.rows(&data, pair, &methods).with_context(|| data.name(pair))?;
        record.append(data.name(pair), rows)?;
        bar.inc(1);
    }
    bar.finish_and_clear();
    let paper: &[PaperRow] = match data.scale {
        _ if !arguments.paper => &[],
        Scale::Object => &report::MODELNET40,
        Scale::Room => &report::REDWOOD,
    };
    let report = Report::new(&plan, &settings, record.pairs(), paper);
    if let Some(output) = &arguments.output {
        report.write(output)?;
    }
    crate::print(&report.text())
}

/// What is measured.
struct Plan {
    epsilon: Vec<f64>,
    table_epsilon: f64,
    conditions: Vec<Condition>,
    num_points: usize,
    seed: u64,
}

impl Plan {
    fn new(arguments: &RepeatabilityArguments, data: &Data) -> Result<Self> {
        // The columns of the paper's tables: ModelNet40, in units of the objects' radius, and Redwood, in metres.
        let hundredths = |range: std::ops::RangeInclusive<u32>, step| {
            range.step_by(step).map(|hundredth| f64::from(hundredth) / 100.0).collect::<Vec<_>>()
        };
        let (epsilon, table_epsilon, noise, num_points) = match data.scale {
            Scale::Object => (hundredths(3..=10, 1), 0.04, hundredths(0..=12, 2), 5000),
            Scale::Room => (hundredths(10..=24, 2), 0.2, hundredths(0..=10, 2), 10_240),
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
            bail!("--table-epsilon {table_epsilon} is none of --epsilon");
        }
        if let Some(bad) = noise.iter().find(|sigma| !(0.0..=1e30).contains(*sigma)) {
            bail!("--noise {bad}: must be 0 or more");
        }
        if arguments.downsample.contains(&0) || num_points == 0 || arguments.count == 0 {
            bail!("--downsample, --num-points and --count must be 1 or more");
        }
        let clean = Condition { downsample: 1, noise: 0.0 };
        let mut conditions = vec![clean];
        conditions.extend(arguments.downsample.iter().map(|&downsample| Condition { downsample, ..clean }));
        conditions.extend(noise.iter().map(|&noise| Condition { noise, ..clean }));
        // The undisturbed views belong to both sweeps; they are measured once.
        let mut different: Vec<Condition> = Vec::new();
        for condition in conditions {
            if !different.contains(&condition) {
                different.push(condition);
            }
        }
        Ok(Self { epsilon, table_epsilon, conditions: different, num_points, seed: arguments.seed })
    }

    /// Everything that the figures depend on, but for the data's content.
    fn settings(&self, arguments: &RepeatabilityArguments, methods: &[Method]) -> Value {
        json!({
            "metric": "relative repeatability",
            "data": arguments.data,
            "limit": arguments.limit,
            "methods": methods.iter().map(Method::settings).collect::<Vec<_>>(),
            "protocol": match arguments.protocol { ProtocolName::Ranked => "ranked", ProtocolName::Paper => "paper" },
            "count": arguments.count,
            "num_points": self.num_points,
            "seed": self.seed,
            "epsilon": self.epsilon,
            "conditions": self.conditions,
        })
    }

    /// The figures of one pair: a row for each method and condition.
    fn rows(&self, data: &Data, pair: usize, methods: &[Method]) -> Result<Vec<Row>> {
        let clouds = data.clouds(pair)?;
        let mut rows = Vec::new();
        for condition in &self.conditions {
            let Views { view_1, view_2, t_1_2, seeds } = clouds.views(*condition, self.num_points, self.seed, pair)?;
            for method in methods {
                let (first, second) = (method.keypoints(&view_1, seeds[0])?, method.keypoints(&view_2, seeds[1])?);
                let repeatability = relative_repeatability(&first, &second, &t_1_2, &self.epsilon)?;
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

/// Indices of `limit` of `length` pairs, evenly spaced from the first to the last.
fn evenly_spaced(length: usize, limit: Option<usize>) -> Result<Vec<usize>> {
    Ok(match limit {
        Some(0) => bail!("--limit must be 1 or more"),
        Some(1) => vec![0],
        Some(limit) if limit < length => {
            (0..limit).map(|i| (i * (length - 1) + (limit - 1) / 2) / (limit - 1)).collect()
        }
        _ => (0..length).collect(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_pairs_are_evenly_spaced() {
        let spaced = |length, limit| evenly_spaced(length, limit).unwrap();
        assert_eq!(spaced(5, None), [0, 1, 2, 3, 4]);
        assert_eq!(spaced(5, Some(9)), [0, 1, 2, 3, 4]);
        assert_eq!(spaced(9, Some(3)), [0, 4, 8]);
        assert_eq!(spaced(9, Some(2)), [0, 8]);
        assert_eq!(spaced(9, Some(1)), [0]);
        assert!(evenly_spaced(9, Some(0)).is_err());
    }
}

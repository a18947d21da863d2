//! The tasks of a run, in order.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;
use snake_eval::reports::{Report, Sample};
use snake_io as io;

use super::args::RunArguments;
use super::record::{Record, Task};
use crate::output::InputFiles;
use crate::terminal;

/// The extensions of a metric's result files.
const EXTENSIONS: [&str; 5] = ["csv", "json", "jsonl", "md", "svg"];

/// The selected pairs or shapes, repeated for each seed.
pub struct Schedule<'a> {
    run: &'a RunArguments,
    chosen: Vec<usize>,
    tasks: Vec<Task>,
}

impl<'a> Schedule<'a> {
    /// Selects among `length` pairs or shapes by `--limit`, and repeats them for each seed.
    pub fn new(length: usize, run: &'a RunArguments) -> Result<Self> {
        let chosen = evenly_spaced(length, run.limit)?;
        let seeds = (0..run.seeds.into()).map(|i| run.seed.wrapping_add(i));
        let tasks = seeds.flat_map(|seed| chosen.iter().map(move |&index| Task { seed, index })).collect();
        Ok(Self { run, chosen, tasks })
    }

    /// Indices of the selected pairs or shapes.
    pub fn chosen(&self) -> &[usize] {
        &self.chosen
    }

    /// All tasks, seed by seed.
    pub fn tasks(&self) -> &[Task] {
        &self.tasks
    }

    /// The results of all tasks, seed by seed.
    fn by_seed<'t, T>(&self, done: &'t [T]) -> Vec<&'t [T]> {
        done.chunks(self.chosen.len()).collect()
    }

    /// Evaluates every task that is not yet recorded, then writes and prints the report. `rows` gives the figures of a task, and
    /// `report` the report of all figures, seed by seed. The output directory must not hold any of the `inputs`.
    pub fn evaluate<'i, Row: Serialize + DeserializeOwned>(
        &self,
        metric: &str,
        settings: &Value,
        inputs: impl Iterator<Item = &'i Path>,
        name: impl Fn(usize) -> String,
        rows: impl FnMut(Task) -> Result<Vec<Row>>,
        report: impl FnOnce(&[&[Sample<Row>]]) -> snake_core::Result<Report>,
    ) -> Result<()>
    where
        'a: 'i,
    {
        let output = self.run.output.as_deref();
        if let Some(folder) = output {
            let models = self.run.compute.model.iter().chain(&self.run.models).map(PathBuf::as_path);
            let inputs = InputFiles::new(inputs.chain(models));
            let path = |extension: &&str| folder.join(format!("{metric}.{extension}"));
            EXTENSIONS.iter().map(path).try_for_each(|path| inputs.refuse_as_output(&path))?;
        }
        let mut record = Record::open(output, metric, settings, self.tasks.len())?;
        record.fill(&self.tasks, name, rows)?;
        let report = report(&self.by_seed(record.pairs()))?;
        if let Some(folder) = output {
            for (extension, text) in report.files() {
                let path = folder.join(format!("{metric}.{extension}"));
                io::write_atomically(&path, |file| file.write_all(text.as_bytes()))
                    .with_context(|| format!("cannot write {}", path.display()))?;
            }
        }
        terminal::print_report(&report.text_lines().into_iter().collect())
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
    use crate::inputs::ColumnArguments;
    use crate::setup::ComputeArguments;

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

    #[test]
    fn every_seed_has_all_pairs() {
        let (limit, seed, seeds) = (Some(2), u64::MAX, 2);
        let compute = ComputeArguments { threads: None, model: None };
        let columns = ColumnArguments::default();
        let models = Vec::new();
        let run = RunArguments { output: None, limit, seed, seeds, models, paper: false, columns, compute };
        let schedule = Schedule::new(3, &run).unwrap();
        let expected = [(u64::MAX, 0), (u64::MAX, 2), (0, 0), (0, 2)].map(|(seed, index)| Task { seed, index });
        assert_eq!((schedule.tasks(), schedule.chosen()), (&expected[..], &[0, 2][..]));
        assert_eq!(schedule.by_seed(&['a', 'b', 'c', 'd']), [['a', 'b'], ['c', 'd']]);
    }
}

//! The figures of each pair, kept in a file so that an interrupted run continues where it stopped.

use std::fs::File;
use std::io::{Seek, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};
use snake_eval::reports::Sample;

use crate::terminal;

/// A pair or shape, and the seed of the random choices on it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Task {
    pub seed: u64,
    pub index: usize,
}

/// The figures of the finished pairs, in order. With an output directory they are kept in `METRIC.jsonl`, whose first
/// line has the settings.
pub struct Record<Row> {
    file: Option<(PathBuf, File)>,
    pairs: Vec<Sample<Row>>,
}

impl<Row: Serialize + DeserializeOwned> Record<Row> {
    /// Opens the record of an output directory and loads the figures that a run with the same settings left there.
    pub fn open(output: Option<&Path>, metric: &str, settings: &Value, num_tasks: usize) -> Result<Self> {
        terminal::detail("settings", || settings.to_string());
        let Some(output) = output else { return Ok(Self { file: None, pairs: Vec::new() }) };
        std::fs::create_dir_all(output).with_context(|| format!("cannot make the directory {}", output.display()))?;
        let path = output.join(format!("{metric}.jsonl"));
        let header = format!("{}\n", json!({ "settings": settings }));
        if path.exists() && !path.is_file() {
            bail!("{} is not a file; give another --output", path.display());
        }
        let text = if path.exists() { std::fs::read_to_string(&path) } else { Ok(String::new()) };
        let text = text.with_context(|| format!("cannot read {}", path.display()))?;
        // An interrupted run may leave an incomplete last line.
        let whole = &text[..text.rfind('\n').map_or(0, |end| end + 1)];
        if !whole.is_empty() && !whole.starts_with(&header) {
            bail!("{} was written with other settings; delete it or give another --output", path.display());
        }
        let lines = whole.get(header.len()..).unwrap_or_default().lines();
        let pairs: Result<Vec<Sample<Row>>, _> = lines.map(serde_json::from_str).collect();
        let pairs = pairs.with_context(|| format!("{} is damaged; delete it", path.display()))?;
        if pairs.len() > num_tasks {
            bail!("{} has more pairs than the data set; delete it or give another --output", path.display());
        }
        let mut record = Self { file: None, pairs };
        let open = || -> std::io::Result<File> {
            let mut file = File::options().write(true).create(true).truncate(false).open(&path)?;
            file.set_len(whole.len() as u64)?;
            file.seek(std::io::SeekFrom::End(0))?;
            if whole.is_empty() {
                file.write_all(header.as_bytes())?;
            }
            Ok(file)
        };
        let file = open().with_context(|| format!("cannot write {}", path.display()))?;
        record.file = Some((path, file));
        Ok(record)
    }

    /// Runs the tasks that are not yet recorded and shows the progress.
    pub fn fill(
        &mut self,
        tasks: &[Task],
        name: impl Fn(usize) -> String,
        mut rows: impl FnMut(Task) -> Result<Vec<Row>>,
    ) -> Result<()> {
        let bar = terminal::progress(tasks.len())?;
        bar.begin_at(self.pairs.len());
        for &task in &tasks[self.pairs.len()..] {
            let name = name(task.index);
            bar.set_message(&name);
            let rows = rows(task).with_context(|| name.clone())?;
            self.append(name, rows)?;
            bar.step();
        }
        bar.finish();
        Ok(())
    }

    /// The finished pairs, in the order of the tasks.
    pub fn pairs(&self) -> &[Sample<Row>] {
        &self.pairs
    }

    /// Adds the next pair.
    fn append(&mut self, name: String, rows: Vec<Row>) -> Result<()> {
        let pair = Sample { name, rows };
        if let Some((path, file)) = &mut self.file {
            let line = serde_json::to_string(&pair)? + "\n";
            file.write_all(line.as_bytes()).with_context(|| format!("cannot write {}", path.display()))?;
        }
        self.pairs.push(pair);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_record_is_continued_or_refused() {
        let folder = tempfile::tempdir().unwrap();
        let (settings, other) = (json!({"seed": 0}), json!({"seed": 1}));
        let open = |settings, number| Record::open(Some(folder.path()), "metric", settings, number);
        let mut record = open(&settings, 3).unwrap();
        record.append("a".into(), vec![0.1 + 0.2]).unwrap();
        record.append("b".into(), vec![1.0 / 3.0, 0.0]).unwrap();
        let pairs = record.pairs().to_vec();
        drop(record);
        assert_eq!(open(&settings, 3).unwrap().pairs(), pairs);
        assert!(open(&other, 3).err().unwrap().to_string().contains("with other settings"));
        assert!(open(&settings, 1).err().unwrap().to_string().contains("more pairs"));
        // A file that is cut anywhere keeps its complete lines and can be continued.
        let path = folder.path().join("metric.jsonl");
        let whole = std::fs::read(&path).unwrap();
        for length in 0..whole.len() {
            std::fs::write(&path, &whole[..length]).unwrap();
            let mut record = open(&settings, 3).unwrap();
            assert_eq!(record.pairs(), &pairs[..record.pairs().len()]);
            let missing = &pairs[record.pairs().len()..];
            for pair in missing {
                record.append(pair.name.clone(), pair.rows.clone()).unwrap();
            }
            assert_eq!(std::fs::read(&path).unwrap(), whole, "{length}");
        }
        std::fs::write(&path, [&whole[..], b"{}\n"].concat()).unwrap();
        assert!(open(&settings, 9).err().unwrap().to_string().contains("damaged"));
    }
}

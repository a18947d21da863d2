//! The result files of a metric in the output directory.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use snake_io as io;

use super::args::RunArguments;
use crate::output::InputFiles;

/// The extensions of a metric's result files.
const EXTENSIONS: [&str; 5] = ["csv", "json", "jsonl", "md", "svg"];

/// Returns an error if the results would replace an input file.
pub fn check<'a>(run: &'a RunArguments, metric: &str, inputs: impl Iterator<Item = &'a Path>) -> Result<()> {
    let Some(folder) = &run.output else { return Ok(()) };
    let models = run.compute.model.iter().chain(&run.models).map(PathBuf::as_path);
    let inputs = InputFiles::new(inputs.chain(models));
    EXTENSIONS.iter().try_for_each(|extension| inputs.refuse_as_output(&folder.join(format!("{metric}.{extension}"))))
}

/// Writes each text to `METRIC.EXTENSION` in the output directory.
pub fn write(output: &Path, metric: &str, texts: &[(&str, String)]) -> Result<()> {
    for (extension, text) in texts {
        let path = output.join(format!("{metric}.{extension}"));
        io::write_atomically(&path, |file| file.write_all(text.as_bytes()))
            .with_context(|| format!("cannot write {}", path.display()))?;
    }
    Ok(())
}

//! Detection in the clouds of a recording, one after another.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, Result, bail};
use serde_json::json;
use snake_io::{Contents, KeypointFormat, RecordedCloud, is_recording, read_recording};

use super::args::DetectArguments;
use super::reports::Reports;
use super::{Item, Job};
use crate::inputs::DASH;
use crate::output::InputFiles;
use crate::terminal::Bar;

/// Whether the input is a recording. Refuses a recording beside other inputs, and a topic without one.
pub fn is_given(arguments: &DetectArguments, inputs: &[PathBuf]) -> Result<bool> {
    let reading = &arguments.input;
    let is_recording = |input: &PathBuf| reading.input_format.is_none() && is_recording(input);
    match inputs {
        [input] if is_recording(input) => match (reading.sample, &reading.columns.columns, arguments.tiles.tile) {
            (None, None, None) => Ok(true),
            _ => bail!("--sample, --columns and --tile are for files of one cloud, not for a recording"),
        },
        _ if inputs.iter().any(is_recording) => bail!("a recording has to be the only input"),
        _ if arguments.topic.is_some() => bail!("--topic is for a recording (.mcap)"),
        _ => Ok(false),
    }
}

/// Processes every cloud. A cloud that fails and a damaged message are reported, and the run continues.
pub fn run(job: &Job, input: &Path, bar: Bar, load_model: f64) -> Result<u8> {
    let arguments = job.arguments;
    let folder = arguments.output.as_deref();
    if let Some(folder) = folder {
        check(folder, input, arguments)?;
    }
    let extension = arguments.format.unwrap_or(KeypointFormat::Ply).extension();
    let stem = input.file_stem().unwrap_or_default().to_string_lossy();
    let recording = read_recording(input, arguments.topic.as_deref())?;
    if let Some(folder) = folder {
        std::fs::create_dir_all(folder).with_context(|| format!("cannot make the directory {}", folder.display()))?;
    }
    let mut reports = Reports::new(arguments, bar, true);
    let mut start = Instant::now();
    for (index, recorded) in recording.enumerate() {
        let name = format!("{}, cloud {index}", input.display());
        reports.bar.set_message(&name);
        let output = folder.map(|folder| folder.join(format!("{stem}.{index:06}.keypoints.{extension}")));
        let process = |RecordedCloud { log_time, frame_id, cloud }| {
            let recorded = Some(json!({ "index": index, "log_time": log_time, "frame_id": frame_id }));
            let contents = Contents { cloud, ..Contents::default() };
            let output = output.as_deref();
            let bar = &reports.bar;
            job.process(Item { input, name: &name, output, recorded, contents, start, bar })
        };
        let result = recorded.map_err(Into::into).and_then(process);
        if !reports.add(index, name, output.as_deref(), result) {
            break;
        }
        start = Instant::now();
    }
    reports.finish(load_model + job.chooser.load_seconds())
}

/// Refuses files for the results, and folders of inputs. A recording has many clouds, so a file cannot hold them.
fn check(folder: &Path, input: &Path, arguments: &DetectArguments) -> Result<()> {
    let is_file_name = arguments.format.is_none() && KeypointFormat::from_path(folder).is_ok() && !folder.is_dir();
    if folder == Path::new(DASH) || is_file_name {
        bail!("{}: a recording has many clouds; give a directory for their keypoints", folder.display());
    }
    InputFiles::new([input].into_iter().chain(arguments.compute.model.as_deref())).refuse_as_output(folder)
}

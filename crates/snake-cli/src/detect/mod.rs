//! `snake-cli detect`: read, detect, write.

pub mod args;
mod recording;
mod reports;
mod tiled;

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use anyhow::{Context, Result, anyhow, bail};
use serde_json::{Value, json};
use snake_core::{Chooser, ChosenBy, Control, Detection, Progress, add_origin, parallel_map};
use snake_io::{self as io, Contents, KeypointFormat, KeypointSource};

use crate::inputs::{DASH, check_inputs, expand, output_origin};
use crate::output::{InputFiles, in_folder};
use crate::setup::detail_of;
use crate::terminal::{self, Bar, Report};
use crate::timing::{STAGES, Seconds};
use args::DetectArguments;
use reports::{Processed, Reports};

/// Number of keypoints in the printed table, at most.
const TABLE_ROWS: usize = 10;

/// Processes every input. A failed input is reported, and the run continues.
pub fn run(arguments: &DetectArguments) -> Result<u8> {
    arguments.compute.start_threads()?;
    let inputs = expand(&arguments.list.extend(&arguments.inputs)?, arguments.input.input_format)?;
    check_inputs(&inputs)?;
    let is_recording = recording::is_given(arguments, &inputs)?;
    if let (Some(side), Some(output)) = (arguments.tiles.tile, &arguments.output) {
        return tiled::run(arguments, &inputs, side, output);
    }
    let progress = Progress::default();
    let loading = Instant::now();
    let chooser = arguments.compute.chooser(&arguments.options.values())?;
    let load_model = loading.elapsed().as_secs_f64();
    let control = Control::new().progress(&progress);
    let job = Job { chooser: &chooser, arguments, control: &control };
    if is_recording {
        return recording::run(&job, &inputs[0], terminal::stages(&progress)?, load_model);
    }
    let outputs = outputs(arguments, &inputs)?;
    let is_parallel = inputs.iter().all(|input| is_small(input));
    let bar = match &inputs[..] {
        [_] => terminal::stages(&progress)?,
        several if is_parallel => terminal::progress(several.len())?,
        several => terminal::calls(several.len(), &progress)?,
    };
    let silent = control.clone().without_progress();
    let job = if is_parallel && inputs.len() > 1 { Job { control: &silent, ..job } } else { job };
    let reports = Mutex::new(Reports::new(arguments, bar, inputs.len() > 1));
    let process = |index: usize| -> snake_core::Result<()> {
        let (input, output): (&PathBuf, &Result<Option<PathBuf>>) = (&inputs[index], &outputs[index]);
        let name = input.display().to_string();
        let bar = lock(&reports).bar.clone();
        bar.set_message(&name);
        let result = match output {
            Ok(output) => job.process_file(input, &name, output.as_deref(), &bar),
            Err(error) => Err(anyhow!("{error:#}")),
        };
        let is_needed = lock(&reports).add(index, name, output.as_ref().ok().and_then(Option::as_deref), result);
        if is_needed { Ok(()) } else { Err(snake_core::Error::Cancelled) }
    };
    // The only error says that no more results are needed.
    let _ended = if is_parallel {
        parallel_map(inputs.len(), process).map(drop)
    } else {
        (0..inputs.len()).try_for_each(process)
    };
    reports.into_inner().unwrap_or_else(PoisonError::into_inner).finish(load_model + chooser.load_seconds())
}

/// Clouds of files up to this many bytes are processed side by side, one on each thread. Larger clouds are processed one
/// after another, each on all threads, because together they might not fit into memory.
const SMALL_FILE: u64 = 32 << 20;

/// Locks the reports. A panic of another thread ends the run anyway.
fn lock<'a, 'b>(reports: &'a Mutex<Reports<'b>>) -> MutexGuard<'a, Reports<'b>> {
    reports.lock().unwrap_or_else(PoisonError::into_inner)
}

fn is_small(input: &Path) -> bool {
    input.metadata().is_ok_and(|metadata| metadata.is_file() && metadata.len() <= SMALL_FILE)
}

/// The output file of each input, or `None` if its keypoints are only printed. No output file is an input.
fn outputs(arguments: &DetectArguments, inputs: &[PathBuf]) -> Result<Vec<Result<Option<PathBuf>>>> {
    let Some(output) = &arguments.output else { return Ok(inputs.iter().map(|_| Ok(None)).collect()) };
    let input_files = InputFiles::new(inputs.iter().chain(&arguments.compute.model));
    let into_directory = output.is_dir() || inputs.len() > 1 || arguments.inputs.iter().any(|input| input.is_dir());
    if !into_directory {
        if output != Path::new(DASH) && arguments.format.is_none() {
            KeypointFormat::from_path(output)?;
        }
        input_files.refuse_as_output(output)?;
        return Ok(vec![Ok(Some(output.clone()))]);
    }
    if output == Path::new(DASH) {
        bail!("the standard output can hold the keypoints of one input only; for several inputs give a directory");
    }
    let extension = arguments.format.unwrap_or(KeypointFormat::Ply).extension();
    std::fs::create_dir_all(output).with_context(|| format!("cannot make the directory {}", output.display()))?;
    let outputs = in_folder(output, inputs, extension, arguments.number_results).into_iter();
    let checked = outputs.map(|output| {
        let output = output?;
        input_files.refuse_as_output(&output)?;
        Ok(Some(output))
    });
    Ok(checked.collect())
}

/// The parts that all clouds of a run share.
#[derive(Clone, Copy)]
struct Job<'a> {
    chooser: &'a Chooser,
    arguments: &'a DetectArguments,
    control: &'a Control,
}

/// A cloud with its source and the destination of its keypoints.
struct Item<'a> {
    input: &'a Path,
    /// The name in messages.
    name: &'a str,
    output: Option<&'a Path>,
    /// The topic and the time of a cloud of a recording, for the report.
    recorded: Option<Value>,
    contents: Contents,
    /// When reading began.
    start: Instant,
    /// The progress bar, which is suspended while a hint is printed.
    bar: &'a Bar,
}

impl Job<'_> {
    /// Processes one input from file to file.
    fn process_file(&self, input: &Path, name: &str, output: Option<&Path>, bar: &Bar) -> Result<Processed> {
        let start = Instant::now();
        let contents = self.arguments.input.read_contents(input, self.chooser.seed())?;
        self.process(Item { input, name, output, recorded: None, contents, start, bar })
    }

    /// Detects the keypoints of a cloud and writes them.
    fn process(&self, item: Item) -> Result<Processed> {
        let Item { input, name, output, recorded, contents, start, bar } = item;
        let Contents { cloud, crs, mut notes, .. } = contents;
        let Self { arguments, control, .. } = *self;
        let read = start.elapsed().as_secs_f64();
        let chosen = self.chooser.for_cloud(&cloud).with_context(|| name.to_owned())?;
        let origin = chosen.origin;
        let num_points = cloud.points.len();
        bar.suspend(|| detail_of(&chosen));
        // Each note is printed once per run, for the first cloud that has it; `--json` reports it for every cloud.
        let mut add_notes = |more: Vec<String>| {
            bar.suspend(|| terminal::hints_once(name, &more));
            notes.extend(more);
        };
        // These notes come before the detection, which may take minutes at the wrong scale.
        add_notes(chosen.notes());
        let detection = chosen.detect(control).with_context(|| name.to_owned())?;
        add_notes(detection.note(&chosen.options.detect).into_iter().collect());
        let mut origin_to_add = [0.0; 3];
        if let Some(output) = output {
            let source = KeypointSource { crs, ..KeypointSource::new(input, origin) };
            write(output, arguments.format, &detection, &source)?;
            origin_to_add = output_origin(output, adds_origin(output, arguments.format), origin);
        }
        let timing = detection.timing;
        let total = start.elapsed().as_secs_f64();
        let seconds = [read, timing.encode, timing.occupancy, timing.refine, timing.nms, total];
        let report = if arguments.json {
            let origins = [origin, origin_to_add];
            let mut line = json_line(input, output, num_points, origins, &detection, &seconds, &notes);
            if let Some(line) = line.as_object_mut() {
                line.insert("model".into(), chosen.name.clone().into());
                line.extend(recorded.map(|recorded| ("recorded".into(), recorded)));
            }
            Report::json(&line)?
        } else {
            let mut report = table(name, output, num_points, origin, &detection, total)?;
            if chosen.by == ChosenBy::Cloud {
                report.line(format!("model: {}, as the cloud looks; --model NAME names another", chosen.name));
            }
            report
        };
        Ok(Processed { report, seconds, num_points, counts: detection.counts })
    }
}

/// Whether the file format holds the coordinates with the origin added.
fn adds_origin(output: &Path, format: Option<KeypointFormat>) -> bool {
    match format {
        Some(format) => format != KeypointFormat::Pcd,
        // The standard output gets a PLY, to which the origin is added.
        None => io::adds_origin(output),
    }
}

/// Writes keypoints to a file or to the standard output. The format is the given one, or else follows from the
/// extension.
fn write(output: &Path, format: Option<KeypointFormat>, detection: &Detection, source: &KeypointSource) -> Result<()> {
    let keypoints = &detection.keypoints;
    if output == Path::new(DASH) {
        let mut bytes = Vec::new();
        format.unwrap_or(KeypointFormat::Ply).write(&mut bytes, keypoints, source)?;
        return terminal::print_bytes(&bytes);
    }
    let cannot = || format!("cannot write {}", output.display());
    match format {
        Some(format) => io::write_atomically(output, |file| format.write(file, keypoints, source)).with_context(cannot),
        None => Ok(io::write_keypoints(output, keypoints, source)?),
    }
}

/// The JSON report of one input. `origins` are the origin of the points and the offset to add to the output's
/// coordinates.
fn json_line(
    input: &Path,
    output: Option<&Path>,
    num_points: usize,
    origins: [[f64; 3]; 2],
    detection: &Detection,
    seconds: &Seconds,
    notes: &[String],
) -> Value {
    let [origin, output_origin] = origins;
    json!({
        "input": input.display().to_string(),
        "output": output.map(|output| output.display().to_string()),
        "num_points": num_points,
        "num_skipped": detection.num_skipped,
        "num_encoded": detection.num_encoded,
        "origin": origin,
        "output_origin": output_origin,
        "normalization": detection.normalization,
        "voxel_size": detection.voxel_size,
        "counts": detection.counts,
        "notes": notes,
        "timing_seconds": STAGES.into_iter().zip(seconds).collect::<BTreeMap<_, _>>(),
        "keypoints": detection.keypoints.iter().map(|keypoint| io::keypoint_json(keypoint, origin)).collect::<Vec<_>>(),
    })
}

fn table(
    name: &str,
    output: Option<&Path>,
    num_points: usize,
    origin: [f64; 3],
    detection: &Detection,
    total: f64,
) -> Result<Report> {
    let keypoints = &detection.keypoints;
    let mut report = Report::default();
    let mut first = format!("{name}: {} keypoints from {num_points} points", keypoints.len());
    if detection.num_skipped > 0 {
        write!(first, " ({} skipped: not finite, withheld or outliers)", detection.num_skipped)?;
    }
    if detection.num_encoded + detection.num_skipped < num_points {
        write!(first, " ({} encoded)", detection.num_encoded)?;
    }
    report.line(format!("{first} in {total:.3} s"));
    if !keypoints.is_empty() {
        let [x, y, z] = ["x", "y", "z"];
        report.heading(format!(
            "{:>4} {x:>12} {y:>12} {z:>12} {:>9} {:>10} {:>9} {:>8}",
            "#", "saliency", "confidence", "occupancy", "nearest"
        ));
    }
    for (rank, k) in keypoints.iter().take(TABLE_ROWS).enumerate() {
        let [x, y, z] = add_origin(k.position, origin);
        let (saliency, occupancy, nearest) = (k.saliency, k.occupancy, k.nearest_index);
        let rank = rank + 1;
        let confidence = k.confidence.map_or("-".into(), |probability| format!("{probability:.2}"));
        report.line(format!(
            "{rank:>4} {x:>12.5} {y:>12.5} {z:>12.5} {saliency:>9.4} {confidence:>10} {occupancy:>9.4} {nearest:>8}"
        ));
    }
    match output {
        Some(output) if output == Path::new(DASH) => (),
        Some(output) => report.line(format!("written to {}", output.display())),
        None if keypoints.len() > TABLE_ROWS => {
            report.line(format!("… {} more; -o FILE writes all", keypoints.len() - TABLE_ROWS))
        }
        None => (),
    }
    Ok(report)
}

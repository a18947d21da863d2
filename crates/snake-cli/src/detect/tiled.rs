//! `snake-cli detect --tile`: clouds that do not fit into memory.

use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Result, anyhow, bail};
use snake_core::{Builtin, Control, Detection, Progress, TileDetector};
use snake_io::{KeypointFormat, KeypointSource};
use snake_tiles::{Error, Tile, TiledRun};

use super::args::DetectArguments;
use crate::inputs::{DASH, output_origin};
use crate::output::InputFiles;
use crate::terminal::{self, Report};
use crate::{FAILURE, SUCCESS};

/// Detects the keypoints of one large cloud. Files and tiles that cannot be read are reported, and the run continues.
pub fn run(arguments: &DetectArguments, inputs: &[PathBuf], side: f64, output: &Path) -> Result<u8> {
    let start = Instant::now();
    check(arguments, inputs, output)?;
    let model = arguments.compute.load_model(Builtin::Scenes)?;
    let mut options = model.options.resolve(&arguments.options.values())?;
    if !arguments.options.has("max_keypoints") {
        options.detect.max_keypoints = usize::MAX;
    }
    let detector = TileDetector::new(&model.model, &options)?;
    let read = arguments.input.options(options.encode.seed);
    let folder = arguments.tiles.tile_folder.clone().unwrap_or_else(|| with_suffix(output, ".tiles"));
    let bar = terminal::progress(1)?;
    bar.set_message("reading the points");
    let run = TiledRun::prepare(detector, inputs, &read, side, &folder).map_err(|error| explained(error, &folder))?;
    bar.finish();
    for failure in run.failures() {
        terminal::error(&anyhow!("{}", failure.reason));
    }
    let failed = detect(&run, &folder)?;
    let progress = Progress::default();
    let bar = terminal::stages(&progress)?;
    bar.set_message(output.display().to_string());
    let finished = run.finish_detected(&run.detected()?, &Control::new().progress(&progress))?;
    bar.finish();
    let mut detection = Detection::default();
    detection.keypoints = finished.keypoints.iter().map(|keypoint| keypoint.keypoint).collect();
    let source = KeypointSource { crs: run.crs().cloned(), ..KeypointSource::new(&inputs[0], run.origin()) };
    super::write(output, arguments.format, &detection, &source)?;
    output_origin(output, super::adds_origin(output, arguments.format), run.origin());
    let (num_points, num_skipped) = run.num_points();
    let counts = finished.counts;
    let mut report = Report::default();
    report.line(format!(
        "{} keypoints from {num_points} points ({num_skipped} not finite, withheld or noise) in {} tiles in {:.1} s",
        counts.keypoints,
        run.tiles().len(),
        start.elapsed().as_secs_f64()
    ));
    if let Some(voxel_size) = run.options().encode.voxel_size {
        report.line(format!("voxels of {voxel_size}"));
    }
    report.line(format!(
        "{} queries, {} occupied, {} above the saliency threshold",
        counts.queries, counts.occupied, counts.above_threshold
    ));
    report.line(format!("written to {}", output.display()));
    terminal::print_report(&report)?;
    if failed > 0 || !run.failures().is_empty() {
        return Ok(FAILURE);
    }
    if arguments.tiles.tile_folder.is_none()
        && let [other, ..] = &run.remove()?[..]
    {
        terminal::warn(&format!("{} stays: no run wrote `{}` in it", folder.display(), other.display()));
    }
    Ok(SUCCESS)
}

/// Refuses arguments that cannot be combined with tiles.
fn check(arguments: &DetectArguments, inputs: &[PathBuf], output: &Path) -> Result<()> {
    if inputs.iter().any(|input| input == Path::new(DASH)) || output == Path::new(DASH) {
        bail!("--tile reads its inputs twice and needs files; the standard input and output cannot be used");
    }
    if arguments.input.input_format.is_some() {
        bail!("--input-format cannot be used with --tile; rename the inputs");
    }
    if output.is_dir() {
        bail!("{}: is a directory; --tile writes one file", output.display());
    }
    if arguments.format.is_none() {
        KeypointFormat::from_path(output)?;
    }
    InputFiles::new(inputs.iter().chain(&arguments.compute.model)).refuse_as_output(output)
}

/// Detects the tiles that have no result yet. Returns how many of them failed.
fn detect(run: &TiledRun, folder: &Path) -> Result<usize> {
    let points = |tiles: &mut dyn Iterator<Item = &Tile>| tiles.map(|tile| tile.num_points).sum::<u64>();
    let all = points(&mut run.tiles().iter());
    let bar = terminal::progress(all as usize)?;
    let open: Vec<&Tile> = run.tiles().iter().filter(|tile| !run.is_detected(tile)).collect();
    bar.begin_at((all - points(&mut open.iter().copied())) as usize);
    let mut failed = 0;
    for (number, tile) in open.iter().enumerate() {
        bar.set_message(format!(
            "points, tile {} of {}",
            run.tiles().len() - open.len() + number + 1,
            run.tiles().len()
        ));
        match run.detect(tile, &Control::default()) {
            Ok(()) => (),
            Err(error) if is_full(&error) || matches!(error, Error::Refused { .. }) => {
                return Err(explained(error, folder));
            }
            Err(error) => {
                failed += 1;
                let [[west, south], [east, north]] = run.bounds(tile);
                let place = format!("the tile from x {west:.2}, y {south:.2} to x {east:.2}, y {north:.2} is left out");
                bar.suspend(|| terminal::error(&anyhow::Error::from(error).context(place)));
            }
        }
        bar.advance(tile.num_points);
    }
    bar.finish();
    if failed == run.tiles().len() {
        bail!("all {failed} tiles failed");
    }
    Ok(failed)
}

/// Whether the disk has no room for further tiles.
fn is_full(error: &Error) -> bool {
    let full = [ErrorKind::StorageFull, ErrorKind::QuotaExceeded, ErrorKind::FileTooLarge];
    matches!(error, Error::Core(snake_core::Error::Io { source, .. }) if full.contains(&source.kind()))
}

/// An error of the run, with the advice to repeat it if the disk is full.
fn explained(error: Error, folder: &Path) -> anyhow::Error {
    let is_full = is_full(&error);
    let error = anyhow::Error::from(error);
    if is_full {
        error.context(format!(
            "the disk is full; the detected tiles in {} stay, and once there is room the same command continues",
            folder.display()
        ))
    } else {
        error
    }
}

fn with_suffix(path: &Path, suffix: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(suffix);
    name.into()
}

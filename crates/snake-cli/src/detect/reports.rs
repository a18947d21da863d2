//! The reports of all inputs, printed in the order of the inputs.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::Instant;

use anyhow::{Error, Result, anyhow};
use snake_core::Counts;

use super::args::DetectArguments;
use crate::inputs::DASH;
use crate::terminal::{self, Bar, Report};
use crate::timing::{self, Seconds};
use crate::{ERROR, FAILURE, SUCCESS};

/// Number of inputs that a line at the end of a run names, at most.
const NAMED_INPUTS: usize = 10;

/// How a report is printed: to the standard output, or elsewhere if that carries the keypoints.
type Print = fn(&Report) -> Result<()>;

/// The figures of an input that was processed.
pub struct Processed {
    pub report: Report,
    pub seconds: Seconds,
    pub num_points: usize,
    pub counts: Counts,
}

/// The sum of the results of a run.
struct Summary {
    start: Instant,
    num_clouds: usize,
    num_points: usize,
    /// Number of keypoints: of all clouds, the fewest of one cloud, and the most of one cloud.
    num_keypoints: [usize; 3],
    /// The clouds without keypoints.
    empty: Vec<String>,
}

impl Summary {
    fn new() -> Self {
        Self {
            start: Instant::now(),
            num_clouds: 0,
            num_points: 0,
            num_keypoints: [0, usize::MAX, 0],
            empty: Vec::new(),
        }
    }

    fn add(&mut self, input: String, num_points: usize, num_keypoints: usize) {
        self.num_clouds += 1;
        self.num_points += num_points;
        let [all, fewest, most] = self.num_keypoints;
        self.num_keypoints = [all + num_keypoints, fewest.min(num_keypoints), most.max(num_keypoints)];
        if num_keypoints == 0 {
            self.empty.push(input);
        }
    }

    fn report(&self, output: &Path) -> Report {
        let mut report = Report::default();
        let Self { num_clouds, num_points, num_keypoints: [all, fewest, most], .. } = self;
        if *num_clouds == 0 {
            return report;
        }
        let seconds = self.start.elapsed().as_secs_f64();
        report.line(format!(
            "{all} keypoints ({fewest} to {most} a cloud) from {num_points} points in {num_clouds} clouds in {seconds:.3} s"
        ));
        if !self.empty.is_empty() {
            let (number, names) = (self.empty.len(), listed(&self.empty));
            report.line(format!(
                "{number} without keypoints: {names}: try a lower --saliency-threshold or --set occupancy_threshold=0.3"
            ));
        }
        report.line(format!("written to {}", output.display()));
        report
    }
}

/// The first names as a list, with `…` if there are more.
fn listed(names: &[String]) -> String {
    let more = if names.len() > NAMED_INPUTS { ", …" } else { "" };
    names[..names.len().min(NAMED_INPUTS)].join(", ") + more
}

/// A result with the name of its input.
type Named = (Print, String, Result<Processed>);

/// The reports of a run.
pub struct Reports<'a> {
    arguments: &'a DetectArguments,
    pub bar: Bar,
    /// Results that wait for the results of earlier inputs.
    waiting: BTreeMap<usize, Named>,
    num_reported: usize,
    failed: Vec<String>,
    timings: Vec<Seconds>,
    /// Replaces the reports of several inputs if their keypoints are written to files.
    summary: Option<Summary>,
    /// The first error of writing to the standard output.
    unprinted: Option<Error>,
}

impl<'a> Reports<'a> {
    pub fn new(arguments: &'a DetectArguments, bar: Bar, are_several: bool) -> Self {
        let (waiting, failed, timings) = Default::default();
        let is_summed = are_several && arguments.output.is_some() && !arguments.json;
        let summary = is_summed.then(Summary::new);
        Self { arguments, bar, waiting, num_reported: 0, failed, timings, summary, unprinted: None }
    }

    /// Adds the result of an input and prints all results whose turn it is. Returns whether further results are
    /// needed. They are not needed if they would only be printed and the standard output accepts no more data.
    pub fn add(&mut self, index: usize, input: String, output: Option<&Path>, result: Result<Processed>) -> bool {
        // With `-o -` the standard output carries only the keypoints.
        let print: Print = match output {
            Some(output) if output == Path::new(DASH) => terminal::print_aside,
            _ if self.arguments.json => terminal::print,
            _ => terminal::print_report,
        };
        self.waiting.insert(index, (print, input, result));
        while let Some(named) = self.waiting.remove(&self.num_reported) {
            self.report(named);
            self.num_reported += 1;
            self.bar.step();
        }
        self.arguments.output.is_some() || !(self.unprinted.is_some() || terminal::stdout_ended())
    }

    fn report(&mut self, (print, input, result): Named) {
        let printed = self.bar.suspend(|| match result {
            Ok(Processed { report, seconds, num_points, counts }) => {
                let Counts { queries, occupied, above_threshold, .. } = counts;
                terminal::detail("queries", || {
                    format!("{queries}, {occupied} occupied, {above_threshold} above the saliency threshold")
                });
                terminal::detail("seconds", || timing::line(&seconds));
                self.timings.push(seconds);
                match &mut self.summary {
                    Some(summary) => summary.add(input, num_points, counts.keypoints),
                    None => return print(&report),
                }
                Ok(())
            }
            Err(error) => {
                self.failed.push(input);
                terminal::error(&error);
                Ok(())
            }
        });
        if let Err(error) = printed {
            if self.arguments.output.is_some() {
                self.bar.suspend(|| terminal::error(&error));
            }
            self.unprinted.get_or_insert(error);
        }
    }

    /// Prints the failures and the times of the run.
    pub fn finish(self, load_model: f64) -> Result<u8> {
        let Self { arguments, num_reported, failed, timings, summary, mut unprinted, .. } = self;
        self.bar.finish();
        if let (Some(summary), Some(output)) = (summary, &arguments.output)
            && let Err(error) = terminal::print_report(&summary.report(output))
        {
            terminal::error(&error);
            unprinted.get_or_insert(error);
        }
        let is_reported = unprinted.is_none();
        if let (Some(error), None) = (unprinted, &arguments.output) {
            return Err(error);
        }
        if !failed.is_empty() && num_reported > 1 {
            terminal::error(&anyhow!("{} of {} inputs failed: {}", failed.len(), num_reported, listed(&failed)));
        }
        if arguments.timing && !timings.is_empty() {
            terminal::print_to_stderr(&timing::summary(load_model, &timings));
        }
        Ok(match failed.len() {
            0 if is_reported => SUCCESS,
            n if n < num_reported => FAILURE,
            _ => ERROR,
        })
    }
}

//! The reports of all inputs, printed in the order of the inputs.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::ExitCode;

use anyhow::{Error, Result, anyhow};

use super::args::DetectArguments;
use crate::inputs::DASH;
use crate::terminal::{self, Bar, Report};
use crate::timing::{self, Seconds};

/// The most failed inputs that the last line of a run names.
const NAMED_FAILURES: usize = 10;

/// How a report is printed: to the standard output, or elsewhere if that carries the keypoints.
type Print = fn(&Report) -> Result<()>;

/// What is known of an input that was processed.
pub struct Processed {
    pub report: Report,
    pub seconds: Seconds,
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
    /// The first error of the standard output.
    unprinted: Option<Error>,
}

impl<'a> Reports<'a> {
    pub fn new(arguments: &'a DetectArguments, bar: Bar) -> Self {
        let (waiting, failed, timings) = Default::default();
        Self { arguments, bar, waiting, num_reported: 0, failed, timings, unprinted: None }
    }

    /// Adds the result of an input and prints all results whose turn it is. Returns whether further results are needed;
    /// they are not if they would only be printed and the standard output accepts no more data.
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
            Ok(Processed { report, seconds }) => {
                terminal::detail("seconds", || timing::line(&seconds));
                self.timings.push(seconds);
                print(&report)
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
    pub fn finish(self, load_model: f64) -> Result<ExitCode> {
        let Self { arguments, num_reported, failed, timings, unprinted, .. } = self;
        self.bar.finish();
        let is_reported = unprinted.is_none();
        if let (Some(error), None) = (unprinted, &arguments.output) {
            return Err(error);
        }
        if !failed.is_empty() && num_reported > 1 {
            let more = if failed.len() > NAMED_FAILURES { ", …" } else { "" };
            let names = failed[..failed.len().min(NAMED_FAILURES)].join(", ");
            terminal::error(&anyhow!("{} of {} inputs failed: {names}{more}", failed.len(), num_reported));
        }
        if arguments.timing && !timings.is_empty() {
            terminal::print_to_stderr(&timing::summary(load_model, &timings));
        }
        Ok(ExitCode::from(match failed.len() {
            0 if is_reported => 0,
            n if n < num_reported => 1,
            _ => 2,
        }))
    }
}

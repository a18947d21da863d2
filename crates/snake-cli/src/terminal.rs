//! All printing goes through this module: results to the standard output, everything else to the standard error.
//!
//! Text for people passes through [`printable`] line by line, so that file names, option values and the environment
//! cannot control the terminal. A closed standard output or error never stops the work.

use std::collections::BTreeSet;
use std::fmt::Display;
use std::io::{self, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, OnceLock, PoisonError};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use console::{Term, style};
use indicatif::{HumanDuration, ProgressBar, ProgressDrawTarget, ProgressStyle};
use serde::Serialize;
use snake_core::{Field, Progress, Stage, is_harmful, printable, shortened};

/// How much is printed.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default)]
pub enum Verbosity {
    /// Requested data, and errors.
    Quiet,
    /// Also tables, warnings and progress.
    #[default]
    Normal,
    /// Also the loaded model, the options and the time.
    Verbose,
}

static VERBOSITY: OnceLock<Verbosity> = OnceLock::new();

/// Sets how much is printed; only the first call has an effect.
pub fn set_verbosity(verbosity: Verbosity) {
    VERBOSITY.get_or_init(|| verbosity);
}

fn verbosity() -> Verbosity {
    VERBOSITY.get().copied().unwrap_or_default()
}

/// Lines of printable text.
#[derive(Default)]
pub struct Report(String);

impl Report {
    /// A JSON value on one line. Harmful characters become JSON escapes, so that the value stays the same.
    pub fn json(value: &impl Serialize) -> Result<Self> {
        let escape = |c: char| if is_harmful(c) { format!("\\u{:04x}", u32::from(c)) } else { c.to_string() };
        let text = serde_json::to_string(value)?;
        let text = if text.contains(is_harmful) { text.chars().map(escape).collect() } else { text };
        Ok(Self(text + "\n"))
    }

    /// Adds a line.
    pub fn line(&mut self, text: impl AsRef<str>) {
        self.0 += &printable(text.as_ref());
        self.0 += "\n";
    }

    /// Adds a line in bold.
    pub fn heading(&mut self, text: impl AsRef<str>) {
        self.0 += &format!("{}\n", style(printable(text.as_ref())).bold());
    }
}

impl<S: AsRef<str>> FromIterator<S> for Report {
    fn from_iter<I: IntoIterator<Item = S>>(lines: I) -> Self {
        let mut report = Self::default();
        lines.into_iter().for_each(|line| report.line(line));
        report
    }
}

/// Set when the standard output accepts no more data.
static STDOUT_ENDED: AtomicBool = AtomicBool::new(false);

/// Whether the standard output accepts no more data, as after `| head`. Results that are only printed are then not
/// needed.
pub fn stdout_ended() -> bool {
    STDOUT_ENDED.load(Ordering::Relaxed)
}

/// Prints requested bytes. A reader that closes the pipe, as `| head` does, is not an error. After any failure nothing
/// more is printed.
pub fn print_bytes(bytes: &[u8]) -> Result<()> {
    if stdout_ended() {
        return Ok(());
    }
    let mut stdout = io::stdout().lock();
    let Err(error) = stdout.write_all(bytes).and_then(|()| stdout.flush()) else { return Ok(()) };
    STDOUT_ENDED.store(true, Ordering::Relaxed);
    match error.kind() {
        io::ErrorKind::BrokenPipe => Ok(()),
        _ => Err(error).context("cannot write to standard output"),
    }
}

/// Prints a JSON value on one line.
pub fn print_json(value: &impl Serialize) -> Result<()> {
    print(&Report::json(value)?)
}

/// Prints requested lines.
pub fn print(report: &Report) -> Result<()> {
    print_bytes(report.0.as_bytes())
}

/// Prints a report for people; nothing with `--quiet`.
pub fn print_report(report: &Report) -> Result<()> {
    if verbosity() == Verbosity::Quiet { Ok(()) } else { print(report) }
}

/// [`print_report`] to the standard error, where the standard output carries a file.
pub fn print_aside(report: &Report) -> Result<()> {
    if verbosity() > Verbosity::Quiet {
        print_to_stderr(report);
    }
    Ok(())
}

/// Prints to the standard error. A failure is ignored, because it cannot be reported.
pub fn print_to_stderr(report: &Report) {
    let _ = io::stderr().lock().write_all(report.0.as_bytes());
}

/// Prints a line to the standard error, with its topic in front.
fn say(topic: impl Display, text: &str) {
    print_to_stderr(&Report(format!("{topic} {}\n", printable(&with_flags(text)))));
}

/// A text in which options of reading are named as flags. The libraries name them as options: `columns` 1,2,3.
fn with_flags(text: &str) -> String {
    let flags = [
        ("`columns` ", "--columns "),
        ("`format` ", "--input-format "),
        ("`topic` ", "--topic "),
        ("`folder` ", "--tile-folder "),
    ];
    flags.iter().fold(text.to_owned(), |text, (option, flag)| text.replace(option, flag))
}

/// Prints an error on one line, followed by the causes that its text does not contain.
pub fn error(error: &anyhow::Error) {
    let mut text = error.to_string();
    for cause in error.chain().skip(1).map(ToString::to_string) {
        if !text.ends_with(&cause) {
            text += &format!(": {cause}");
        }
    }
    say_error(&text);
}

fn say_error(text: &str) {
    say(style("error:").for_stderr().red().bold(), &shortened(text));
}

/// Prints an error in the command line, with advice below it.
pub fn usage_error(text: &str) {
    let mut lines = text.trim_end().lines();
    let first = lines.next().unwrap_or_default();
    say_error(first.strip_prefix("error: ").unwrap_or(first));
    print_to_stderr(&lines.collect());
}

/// Prints information for a waiting user.
fn note(text: &str) {
    say(style("note:").for_stderr().bold(), &shortened(text));
}

/// Prints a warning; nothing with `--quiet`.
pub fn warn(text: &str) {
    if verbosity() > Verbosity::Quiet {
        say(style("warning:").for_stderr().yellow().bold(), &shortened(text));
    }
}

/// Prints advice; nothing with `--quiet`.
pub fn hint(text: &str) {
    if verbosity() > Verbosity::Quiet {
        note(text);
    }
}

/// Prints each piece of advice on a cloud.
pub fn hints<'a>(name: &str, hints: impl IntoIterator<Item = &'a String>) {
    hints.into_iter().for_each(|text| hint(&format!("{name}: {text}")));
}

/// Prints pieces of advice that no other cloud of the run had, whatever their numbers.
pub fn hints_once(name: &str, texts: &[String]) {
    static SAID: Mutex<BTreeSet<String>> = Mutex::new(BTreeSet::new());
    let is_new = |text: &&String| {
        let words = text.replace(|c: char| c.is_ascii_digit() || c == '.', "");
        SAID.lock().unwrap_or_else(PoisonError::into_inner).insert(words)
    };
    hints(name, texts.iter().filter(is_new));
}

/// Names what is wrong with a cloud, which its field leaves out.
pub fn hint_findings(name: &str, field: &Field) {
    hints(name, &field.findings());
}

/// Prints a line about `topic` with `--verbose`.
pub fn detail(topic: &str, text: impl FnOnce() -> String) {
    if verbosity() == Verbosity::Verbose {
        say(style(format!("{topic}:")).for_stderr().bold(), &text());
    }
}

/// Delay before a bar appears. Shorter work is over before the bar could be read.
const BAR_AFTER: Duration = Duration::from_secs(1);
/// Time between two updates of a bar.
const BAR_INTERVAL: Duration = Duration::from_millis(200);

/// Time between two progress lines when there is no terminal for a bar.
const LINE_INTERVAL: Duration = Duration::from_secs(10);

/// A bar that appears after a second. With several steps it shows the remaining time. If the standard error is not a
/// terminal, a line every ten seconds replaces the bar. With `--quiet` there is neither.
pub fn progress(steps: usize) -> Result<Bar> {
    let template = if steps > 1 { "{bar:30} {pos}/{len} {msg} (ETA {eta})" } else { "{spinner} {msg} ({elapsed})" };
    shown_later(steps, template, steps_done)
}

/// A bar for one long call, like [`progress`]. It shows the current stage of the model with its remaining time.
pub fn stages(progress: &Progress) -> Result<Bar> {
    let progress = progress.clone();
    shown_later(1, "{bar:30} {prefix}: {msg}", move |bar| {
        let Some(stage) = progress.stage() else {
            bar.set_prefix("reading");
            return format!("reading {}", bar.message());
        };
        bar.set_length(stage.total.max(1));
        bar.set_position(stage.done);
        bar.set_prefix(match stage.remaining() {
            Some(remaining) => format!("{} (ETA {:#})", stage.name, HumanDuration(remaining)),
            None => stage.name.into(),
        });
        format!("{}: {}", bar.message(), stage_line(&stage))
    })
}

/// A bar for several calls, like [`progress`]. Each call shows the current stage of the model.
pub fn calls(number: usize, progress: &Progress) -> Result<Bar> {
    let progress = progress.clone();
    shown_later(number, "{bar:30} {pos}/{len} {msg} (ETA {eta})", move |bar| {
        let Some(stage) = progress.stage() else { return steps_done(bar) };
        format!("{}: {}", steps_done(bar), stage_line(&stage))
    })
}

fn steps_done(bar: &ProgressBar) -> String {
    format!("{} of {} done, {}", bar.position(), bar.length().unwrap_or_default(), bar.message())
}

fn stage_line(stage: &Stage) -> String {
    match stage.remaining() {
        Some(left) => format!("{}, {} of {}, about {} left", stage.name, stage.done, stage.total, HumanDuration(left)),
        None => stage.name.into(),
    }
}

/// A progress bar.
#[derive(Clone)]
pub struct Bar(ProgressBar);

impl Bar {
    /// Shows the current item.
    pub fn set_message(&self, message: impl AsRef<str>) {
        self.0.set_message(printable(message.as_ref()).into_owned());
    }

    /// Starts the bar at this many steps, which do not count for the remaining time.
    pub fn begin_at(&self, steps: usize) {
        self.0.set_position(steps as u64);
        self.0.reset_eta();
    }

    /// Counts a step.
    pub fn step(&self) {
        self.0.inc(1);
    }

    /// Counts several steps.
    pub fn advance(&self, steps: u64) {
        self.0.inc(steps);
    }

    /// Hides the bar while something else is printed.
    pub fn suspend<T>(&self, print: impl FnOnce() -> T) -> T {
        self.0.suspend(print)
    }

    /// Removes the bar.
    pub fn finish(self) {
        self.0.finish_and_clear();
    }
}

/// A bar that appears after [`BAR_AFTER`]. `update` refreshes the bar while it is shown, and returns the line that is
/// printed instead when there is no terminal.
fn shown_later(
    steps: usize,
    template: &str,
    mut update: impl FnMut(&ProgressBar) -> String + Send + 'static,
) -> Result<Bar> {
    let bar = ProgressBar::with_draw_target(Some(steps as u64), ProgressDrawTarget::hidden());
    bar.set_style(ProgressStyle::with_template(template)?);
    if verbosity() > Verbosity::Quiet {
        let shown = bar.downgrade();
        let running = move || shown.upgrade().filter(|bar| !bar.is_finished());
        let is_terminal = Term::stderr().is_term();
        let mut last_line = Instant::now();
        std::thread::spawn(move || {
            std::thread::sleep(BAR_AFTER);
            if let Some(bar) = running().filter(|_| is_terminal) {
                bar.set_draw_target(ProgressDrawTarget::stderr());
            }
            while let Some(bar) = running() {
                let line = update(&bar);
                bar.tick();
                if !is_terminal && last_line.elapsed() >= LINE_INTERVAL {
                    last_line = Instant::now();
                    note(&line);
                }
                drop(bar);
                std::thread::sleep(BAR_INTERVAL);
            }
        });
    }
    Ok(Bar(bar))
}

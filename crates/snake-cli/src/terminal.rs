//! Everything that is printed goes through here: results to the standard output, all else to the standard error.
//!
//! Text for people is printed line by line, each through [`printable`]: names of files, values of options and the
//! environment cannot steer the terminal. A standard output or error that takes no more never stops the work.

use std::borrow::Cow;
use std::fmt::Display;
use std::io::{self, Write};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use console::{Term, style};
use indicatif::{HumanDuration, ProgressBar, ProgressDrawTarget, ProgressStyle};
use serde::Serialize;
use snake_core::{Progress, Stage};

/// How much is said.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default)]
pub enum Verbosity {
    /// Data that was asked for, and errors.
    Quiet,
    /// Also tables, warnings and progress.
    #[default]
    Normal,
    /// Also what was loaded, the options and the time.
    Verbose,
}

static VERBOSITY: OnceLock<Verbosity> = OnceLock::new();

/// Sets how much is said; only the first call counts.
pub fn set_verbosity(verbosity: Verbosity) {
    VERBOSITY.get_or_init(|| verbosity);
}

fn verbosity() -> Verbosity {
    VERBOSITY.get().copied().unwrap_or_default()
}

/// The text on one line. Characters that end the line, steer the terminal or change the direction of writing are shown
/// as escapes, such as `\n` and `\u{1b}`.
pub fn printable(text: &str) -> Cow<'_, str> {
    if !text.contains(is_harmful) {
        return text.into();
    }
    text.chars().map(|c| if is_harmful(c) { c.escape_debug().to_string() } else { c.to_string() }).collect()
}

/// Control characters, separators of lines and paragraphs, and bidirectional controls.
fn is_harmful(c: char) -> bool {
    c.is_control()
        || matches!(c, '\u{61c}' | '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
}

/// Lines that can be printed.
#[derive(Default)]
pub struct Report(String);

impl Report {
    /// A JSON value on one line. Harmful characters are escaped as JSON has it: the value stays the same.
    pub fn json(value: &impl Serialize) -> Result<Self> {
        let escape = |c: char| match is_harmful(c) {
            true => format!("\\u{:04x}", u32::from(c)),
            false => c.to_string(),
        };
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

/// Set once the standard output takes no more.
static STDOUT_ENDED: AtomicBool = AtomicBool::new(false);

/// Whether the standard output takes no more, as after `| head`: what is only printed need not be computed.
pub fn stdout_ended() -> bool {
    STDOUT_ENDED.load(Ordering::Relaxed)
}

/// Prints bytes that were asked for. A reader that closed the pipe, as `| head` does, had enough: that is no error. After
/// any failure nothing more is printed.
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

/// Prints lines that were asked for.
pub fn print(report: &Report) -> Result<()> {
    print_bytes(report.0.as_bytes())
}

/// Prints what is for people; nothing with `--quiet`.
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

/// Prints to the standard error. Nobody can be told that it takes no more.
pub fn print_to_stderr(report: &Report) {
    let _ = io::stderr().lock().write_all(report.0.as_bytes());
}

/// A line on the standard error after a word that says what it is.
fn say(topic: impl Display, text: &str) {
    print_to_stderr(&Report(format!("{topic} {}\n", printable(text))));
}

/// An error on one line, with those of its causes that it does not name itself.
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
    say(style("error:").for_stderr().red().bold(), text);
}

/// An error in the command line, with advice below it.
pub fn usage_error(text: &str) {
    let mut lines = text.trim_end().lines();
    let first = lines.next().unwrap_or_default();
    say_error(first.strip_prefix("error: ").unwrap_or(first));
    print_to_stderr(&lines.collect());
}

/// What the user may want to know while waiting.
fn note(text: &str) {
    say(style("note:").for_stderr().bold(), text);
}

/// What the user should know though it is no error; nothing with `--quiet`.
pub fn warn(text: &str) {
    if verbosity() > Verbosity::Quiet {
        say(style("warning:").for_stderr().yellow().bold(), text);
    }
}

/// A line for `--verbose`, about `topic`.
pub fn detail(topic: &str, text: impl FnOnce() -> String) {
    if verbosity() == Verbosity::Verbose {
        say(style(format!("{topic}:")).for_stderr().bold(), &text());
    }
}

/// What takes less is over before a bar could be read.
const BAR_AFTER: Duration = Duration::from_secs(1);
/// Time between two pictures of a bar.
const BAR_INTERVAL: Duration = Duration::from_millis(200);

/// Time between two lines where there is no terminal for a bar.
const LINE_INTERVAL: Duration = Duration::from_secs(10);
/// How many windows there are is said beforehand if they take longer.
const LONG: Duration = Duration::from_secs(10);

/// A bar that shows itself after a second, with the expected time where there are several steps. Where the standard error
/// is no terminal, a line every ten seconds takes its place. Neither with `--quiet`.
pub fn progress(steps: usize) -> Result<Bar> {
    let template = if steps > 1 { "{bar:30} {pos}/{len} {msg} (ETA {eta})" } else { "{spinner} {msg} ({elapsed})" };
    shown_later(steps, template, steps_done)
}

/// Like [`progress`], a bar of one long call: the stages that a model counts, each with the time that it is expected to
/// take.
pub fn stages(progress: &Progress) -> Result<Bar> {
    let (progress, mut windows) = (progress.clone(), Windows::default());
    shown_later(1, "{bar:30} {prefix}: {msg}", move |bar| {
        let Some(stage) = progress.stage() else {
            bar.set_prefix("reading");
            return format!("reading {}", bar.message());
        };
        windows.announce(bar, &stage);
        bar.set_length(stage.total.max(1));
        bar.set_position(stage.done);
        bar.set_prefix(match stage.remaining() {
            Some(remaining) => format!("{} (ETA {:#})", stage.name, HumanDuration(remaining)),
            None => stage.name.into(),
        });
        format!("{}: {}", bar.message(), stage_line(&stage))
    })
}

/// Like [`progress`], a bar of several calls, each of which has the stages that a model counts.
pub fn calls(number: usize, progress: &Progress) -> Result<Bar> {
    let (progress, mut windows) = (progress.clone(), Windows::default());
    shown_later(number, "{bar:30} {pos}/{len} {msg} (ETA {eta})", move |bar| {
        let Some(stage) = progress.stage() else { return steps_done(bar) };
        windows.announce(bar, &stage);
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

/// What was said of the windows of a cloud.
#[derive(Default)]
struct Windows {
    /// Time since the stage began, when it was last looked at.
    elapsed: Duration,
    announced: bool,
}

impl Windows {
    /// Says once for each cloud how many windows it has and how long they take, if that is long.
    fn announce(&mut self, bar: &ProgressBar, stage: &Stage) {
        self.announced &= stage.name == "windows" && stage.elapsed >= self.elapsed;
        self.elapsed = stage.elapsed;
        let remaining = stage.remaining().filter(|remaining| stage.elapsed >= BAR_AFTER && *remaining >= LONG);
        if let (Some(remaining), false, "windows") = (remaining, self.announced, stage.name) {
            self.announced = true;
            let time = HumanDuration(stage.elapsed + remaining);
            let text = format!("{}: {} windows, about {time} in all", bar.message(), stage.total);
            // The bar is locked meanwhile: even its message cannot be read.
            bar.suspend(|| note(&text));
        }
    }
}

/// A progress bar.
pub struct Bar(ProgressBar);

impl Bar {
    /// Shows what is worked on.
    pub fn set_message(&self, message: impl AsRef<str>) {
        self.0.set_message(printable(message.as_ref()).into_owned());
    }

    /// Begins at this many steps, which took no time.
    pub fn begin_at(&self, steps: usize) {
        self.0.set_position(steps as u64);
        self.0.reset_eta();
    }

    /// Counts a step.
    pub fn step(&self) {
        self.0.inc(1);
    }

    /// Hides the bar while something else is printed.
    pub fn suspend<T>(&self, print: impl FnOnce() -> T) -> T {
        self.0.suspend(print)
    }

    /// Takes the bar away.
    pub fn finish(self) {
        self.0.finish_and_clear();
    }
}

/// A bar that is brought up to date by `update` for as long as it is shown; the text that this gives is the line that takes
/// its place where there is no terminal.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_harmful_characters_are_escaped() {
        for harmless in ["", "a b.ply", "C:\\scans\\é \"x\" 'y'.ply", "扫描 🐍", "فارسی\u{200c}ها"] {
            assert_eq!(printable(harmless), harmless);
        }
        let harmful = "\u{1b}[1m\r\n\t\u{0}\u{7f}\u{85}\u{202e}\u{2066}\u{2028}\u{200f}\u{61c}";
        let shown = printable(harmful);
        assert_eq!(shown, "\\u{1b}[1m\\r\\n\\t\\0\\u{7f}\\u{85}\\u{202e}\\u{2066}\\u{2028}\\u{200f}\\u{61c}");
    }
}

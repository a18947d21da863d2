//! What is said, and where: results on the standard output, all else on the standard error.

use std::io::{self, Write};
use std::sync::OnceLock;
use std::time::Duration;

use anyhow::{Context, Result};
use console::style;
use indicatif::{HumanDuration, ProgressBar, ProgressDrawTarget, ProgressStyle};
use snake_core::Progress;

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

/// Prints data that was asked for, such as JSON. A reader that has closed the pipe (`| head`) ends the program quietly.
pub fn print(text: &str) -> Result<()> {
    print_bytes(text.as_bytes())
}

/// [`print`] of what need not be text.
pub fn print_bytes(bytes: &[u8]) -> Result<()> {
    let mut stdout = io::stdout().lock();
    match stdout.write_all(bytes).and_then(|()| stdout.flush()) {
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => std::process::exit(0),
        outcome => outcome.context("cannot write to standard output"),
    }
}

/// Prints what is for people; nothing with `--quiet`.
pub fn print_report(text: &str) -> Result<()> {
    if verbosity() == Verbosity::Quiet { Ok(()) } else { print(text) }
}

/// [`print_report`] to the standard error, where the standard output carries a file.
pub fn print_aside(text: &str) -> Result<()> {
    if verbosity() > Verbosity::Quiet {
        eprint!("{text}");
    }
    Ok(())
}

/// An error on one line, with those of its causes that it does not name itself.
pub fn error(error: &anyhow::Error) {
    let mut text = error.to_string();
    for cause in error.chain().skip(1).map(ToString::to_string) {
        if !text.ends_with(&cause) {
            text += &format!(": {cause}");
        }
    }
    eprintln!("{} {text}", style("error:").for_stderr().red().bold());
}

/// What the user should know though it is no error; nothing with `--quiet`.
pub fn warn(text: &str) {
    if verbosity() > Verbosity::Quiet {
        eprintln!("{} {text}", style("warning:").for_stderr().yellow().bold());
    }
}

/// A line for `--verbose`, about `topic`.
pub fn detail(topic: &str, text: impl FnOnce() -> String) {
    if verbosity() == Verbosity::Verbose {
        eprintln!("{} {}", style(format!("{topic}:")).for_stderr().bold(), text());
    }
}

/// What takes less is over before a bar could be read.
const BAR_AFTER: Duration = Duration::from_secs(1);
/// Time between two pictures of a bar.
const BAR_INTERVAL: Duration = Duration::from_millis(200);

/// A bar that shows itself after a second, with the expected time where there are several steps. It is drawn on a
/// terminal only, and not with `--quiet`.
pub fn progress(steps: usize) -> Result<ProgressBar> {
    let template = if steps > 1 { "{bar:30} {pos}/{len} {msg} (ETA {eta})" } else { "{spinner} {msg} ({elapsed})" };
    shown_later(steps, template, |_| ())
}

/// Like [`progress`], a bar of one long call: the stages that a model counts, each with the time that it is expected to
/// take.
pub fn stages(progress: &Progress) -> Result<ProgressBar> {
    let progress = progress.clone();
    shown_later(1, "{bar:30} {prefix}: {msg}", move |bar| {
        let Some(stage) = progress.stage() else { return bar.set_prefix("reading") };
        bar.set_length(stage.total.max(1));
        bar.set_position(stage.done);
        bar.set_prefix(match stage.remaining() {
            Some(remaining) => format!("{} (ETA {:#})", stage.name, HumanDuration(remaining)),
            None => stage.name.into(),
        });
    })
}

/// A bar that is brought up to date by `update` for as long as it is shown.
fn shown_later(steps: usize, template: &str, update: impl Fn(&ProgressBar) + Send + 'static) -> Result<ProgressBar> {
    let bar = ProgressBar::with_draw_target(Some(steps as u64), ProgressDrawTarget::hidden());
    bar.set_style(ProgressStyle::with_template(template)?);
    if verbosity() > Verbosity::Quiet {
        let shown = bar.downgrade();
        let running = move || shown.upgrade().filter(|bar| !bar.is_finished());
        std::thread::spawn(move || {
            std::thread::sleep(BAR_AFTER);
            if let Some(bar) = running() {
                bar.set_draw_target(ProgressDrawTarget::stderr());
            }
            while let Some(bar) = running() {
                update(&bar);
                bar.tick();
                drop(bar);
                std::thread::sleep(BAR_INTERVAL);
            }
        });
    }
    Ok(bar)
}

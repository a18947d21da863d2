//! The program `snake-cli`, keypoints from point-cloud files, as a function: the Python package has the same command.
#![forbid(unsafe_code)]

mod align;
mod args;
mod completions;
mod detect;
mod field;
mod flags;
mod inputs;
mod interrupt;
mod model;
mod output;
mod patterns;
mod reconstruct;
mod register;
mod render;
mod set;
mod setup;
mod terminal;
mod timing;
mod view;

use std::ffi::OsString;
use std::panic::{AssertUnwindSafe, catch_unwind};

use anyhow::{Result, anyhow};
use clap::builder::Resettable;
use clap::error::{ContextKind, ContextValue, ErrorKind};
use clap::{Arg, CommandFactory, FromArgMatches};

use args::{Arguments, Command};
use snake_core::{printable, shortened};

/// The exit codes: everything was done; some inputs failed, or the result is not what a flag requires; nothing was done.
const SUCCESS: u8 = 0;
const FAILURE: u8 = 1;
const ERROR: u8 = 2;

/// Runs the program with the words of a command line; the first is its name. Returns the exit code. Ctrl-C ends the
/// process, unless SIGINT has a handler already or is ignored.
pub fn run(words: &[OsString]) -> u8 {
    let arguments = match parsed(words) {
        Ok(arguments) => arguments,
        Err(error) => return explain(error, words),
    };
    terminal::set_verbosity(arguments.verbosity());
    ended(|| run_command(&arguments.command))
}

/// The exit code of a command. Its error is printed; of a panic, the place is printed already.
fn ended(command: impl FnOnce() -> Result<u8>) -> u8 {
    let defect = |_| Err(anyhow!("a defect of the program ended the command; please report the text above"));
    catch_unwind(AssertUnwindSafe(command)).unwrap_or_else(defect).unwrap_or_else(|error| {
        terminal::error(&error);
        ERROR
    })
}

/// The arguments of a command line.
fn parsed<T: Into<OsString> + Clone>(words: impl IntoIterator<Item = T>) -> Result<Arguments, clap::Error> {
    let mut command = without_empty_variables(Arguments::command());
    let mut matches = command.try_get_matches_from_mut(words)?;
    Arguments::from_arg_matches_mut(&mut matches).map_err(|error| error.format(&mut command))
}

/// A variable of the environment that is empty counts as none.
fn without_empty_variables(command: clap::Command) -> clap::Command {
    let is_empty = |arg: &Arg| arg.get_env().and_then(std::env::var_os).is_some_and(|value| value.is_empty());
    let command = command.mut_args(|arg| if is_empty(&arg) { arg.env(Resettable::Reset) } else { arg });
    command.mut_subcommands(without_empty_variables)
}

fn run_command(command: &Command) -> Result<u8> {
    interrupt::end_between_files()?;
    match command {
        Command::Align(arguments) => return align::run(arguments),
        Command::Detect(arguments) => return detect::run(arguments),
        Command::Field(arguments) => field::run(arguments)?,
        Command::Reconstruct(arguments) => reconstruct::run(arguments)?,
        Command::Register(arguments) => return register::run(arguments),
        Command::View(arguments) => view::run(arguments)?,
        Command::Model { file } => model::run(file.as_deref())?,
        Command::Options => set::list()?,
        Command::Schema => terminal::print_bytes(include_bytes!("schema.json"))?,
        Command::Completions { shell } => completions::print(*shell)?,
    }
    Ok(SUCCESS)
}

/// Prints the requested help, or the error in the command line.
fn explain(error: clap::Error, words: &[OsString]) -> u8 {
    let code = if error.use_stderr() { ERROR } else { SUCCESS };
    match error.kind() {
        ErrorKind::DisplayHelp | ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand | ErrorKind::DisplayVersion => {
            // The help quotes no arguments, so it is safe to print.
            let _ = error.print();
        }
        _ => {
            let error = with_printable_arguments(error, words);
            match error.get(ContextKind::InvalidArg) {
                Some(ContextValue::String(flag)) if error.kind() == ErrorKind::UnknownArgument => {
                    let instead = set::instead_of(flag);
                    terminal::usage_error(&instead.map_or_else(
                        || error.render().to_string(),
                        |instead| format!("error: {flag} is the name of an option: {instead}\n"),
                    ));
                }
                _ => terminal::usage_error(&error.render().to_string()),
            }
        }
    }
    code
}

/// The same error with the arguments in printable form, of bounded length. The error quotes the arguments in several places, and a line
/// break in an argument would look like a line of clap's own text.
fn with_printable_arguments(error: clap::Error, words: &[OsString]) -> clap::Error {
    let shown = |text: &str| printable(&shortened(text)).into_owned();
    let mut error = parsed(words.iter().map(|word| shown(&word.to_string_lossy()))).err().unwrap_or(error);
    // The value of an environment variable is not among the arguments.
    if let Some(ContextValue::String(value)) = error.get(ContextKind::InvalidValue) {
        let value = shown(value);
        error.insert(ContextKind::InvalidValue, ContextValue::String(value));
    }
    error
}

#[cfg(test)]
mod tests {
    #[test]
    fn a_panic_is_an_error() {
        assert_eq!(super::ended(|| panic!("no such case")), super::ERROR);
    }
}

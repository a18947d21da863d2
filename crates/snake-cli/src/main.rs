//! `snake-cli`: keypoints from point-cloud files.
#![forbid(unsafe_code)]

mod align;
mod args;
mod completions;
mod config;
mod detect;
mod disturb;
mod eval;
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
use std::process::ExitCode;

use anyhow::Result;
use clap::builder::Resettable;
use clap::error::{ContextKind, ContextValue, ErrorKind};
use clap::{Arg, CommandFactory, FromArgMatches};

use args::{Arguments, Command};
use snake_core::{printable, shortened};

fn main() -> ExitCode {
    let arguments = match parsed(std::env::args_os()) {
        Ok(arguments) => arguments,
        Err(error) => return explain(error),
    };
    terminal::set_verbosity(arguments.verbosity());
    run(&arguments.command).unwrap_or_else(|error| {
        terminal::error(&error);
        ExitCode::from(2)
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

fn run(command: &Command) -> Result<ExitCode> {
    interrupt::end_between_files()?;
    match command {
        Command::Align(arguments) => return align::run(arguments),
        Command::Detect(arguments) => return detect::run(arguments),
        Command::Eval(command) => return eval::run(command),
        Command::Field(arguments) => field::run(arguments)?,
        Command::Reconstruct(arguments) => reconstruct::run(arguments)?,
        Command::Register(arguments) => return register::run(arguments),
        Command::View(arguments) => view::run(arguments)?,
        Command::Model { file } => model::run(file.as_deref())?,
        Command::Options => set::list()?,
        Command::Schema => terminal::print_bytes(include_bytes!("schema.json"))?,
        Command::Completions { shell } => completions::print(*shell)?,
        Command::Manual { folder } => completions::write_manual(folder)?,
    }
    Ok(ExitCode::SUCCESS)
}

/// Prints the requested help, or the error in the command line.
fn explain(error: clap::Error) -> ExitCode {
    let code = ExitCode::from(if error.use_stderr() { 2 } else { 0 });
    match error.kind() {
        ErrorKind::DisplayHelp | ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand | ErrorKind::DisplayVersion => {
            // The help quotes no arguments, so it is safe to print.
            let _ = error.print();
        }
        _ => {
            let error = with_printable_arguments(error);
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
fn with_printable_arguments(error: clap::Error) -> clap::Error {
    let shown = |text: &str| printable(&shortened(text)).into_owned();
    let arguments = std::env::args_os().map(|argument| shown(&argument.to_string_lossy()));
    let mut error = parsed(arguments).err().unwrap_or(error);
    // The value of an environment variable is not among the arguments.
    if let Some(ContextValue::String(value)) = error.get(ContextKind::InvalidValue) {
        let value = shown(value);
        error.insert(ContextKind::InvalidValue, ContextValue::String(value));
    }
    error
}

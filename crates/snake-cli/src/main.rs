//! `snake-cli`: keypoints from point-cloud files.
#![forbid(unsafe_code)]

mod args;
mod detect;
mod eval;
mod field;
mod inputs;
mod interrupt;
mod model;
mod reconstruct;
mod register;
mod render;
mod setup;
mod terminal;
mod timing;
mod view;

use std::process::ExitCode;

use anyhow::Result;
use clap::{CommandFactory, Parser};
use clap_complete::Shell;

use args::{Arguments, Command};

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    terminal::set_verbosity(arguments.verbosity());
    run(&arguments.command).unwrap_or_else(|error| {
        terminal::error(&error);
        ExitCode::from(2)
    })
}

fn run(command: &Command) -> Result<ExitCode> {
    interrupt::end_between_files()?;
    match command {
        Command::Detect(arguments) => return detect::run(arguments),
        Command::Eval(command) => eval::run(command)?,
        Command::Field(arguments) => field::run(arguments)?,
        Command::Reconstruct(arguments) => reconstruct::run(arguments)?,
        Command::Register(arguments) => register::run(arguments)?,
        Command::View(arguments) => view::run(arguments)?,
        Command::Model { file } => model::run(file.as_deref())?,
        Command::Completions { shell } => complete(*shell)?,
    }
    Ok(ExitCode::SUCCESS)
}

/// Prints a shell's completions.
fn complete(shell: Shell) -> Result<()> {
    let mut script = Vec::new();
    clap_complete::generate(shell, &mut Arguments::command(), "snake-cli", &mut script);
    terminal::print(&String::from_utf8_lossy(&script))
}

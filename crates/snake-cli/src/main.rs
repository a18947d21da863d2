//! `snake-cli`: keypoints from point-cloud files.

mod args;
mod detect;
mod eval;
mod model;
mod reconstruct;
mod register;
mod timing;

use std::io::{self, Write};
use std::process::ExitCode;

use anyhow::{Context, Result};
use clap::Parser;

use args::{Arguments, Command};

fn main() -> ExitCode {
    let outcome = match Arguments::parse().command {
        Command::Detect(arguments) => detect::run(&arguments),
        Command::Eval(command) => eval::run(&command).map(|()| ExitCode::SUCCESS),
        Command::Reconstruct(arguments) => reconstruct::run(&arguments).map(|()| ExitCode::SUCCESS),
        Command::Register(arguments) => register::run(&arguments).map(|()| ExitCode::SUCCESS),
        Command::Model { file } => model::run(file.as_deref()).map(|()| ExitCode::SUCCESS),
    };
    outcome.unwrap_or_else(|error| {
        eprintln!("error: {error:#}");
        ExitCode::from(2)
    })
}

/// Prints to stdout; a reader that has closed it (`| head`) ends the program quietly.
fn print(text: &str) -> Result<()> {
    let mut stdout = io::stdout().lock();
    match stdout.write_all(text.as_bytes()).and_then(|()| stdout.flush()) {
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => std::process::exit(0),
        outcome => outcome.context("cannot write to standard output"),
    }
}

//! Completion scripts for shells.

use anyhow::Result;
use clap::CommandFactory;
use clap_complete::Shell;

use crate::args::Arguments;
use crate::terminal;

/// Prints the completion script of a shell.
pub fn print(shell: Shell) -> Result<()> {
    let mut script = Vec::new();
    clap_complete::generate(shell, &mut Arguments::command(), "snake-cli", &mut script);
    if shell == Shell::Bash {
        // In the cases of sub-commands the generator takes the dash of the program's name for a sub-command.
        script = String::from_utf8(script)?.replace("snake__subcmd__cli", "snake__cli").into_bytes();
    }
    terminal::print_bytes(&script)
}

//! Completion scripts for shells, and manual pages.

use std::path::Path;

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

/// Writes `snake-cli.1`, `snake-cli-detect.1` and so on to a folder.
#[cfg(feature = "manual")]
pub fn write_manual(folder: &Path) -> Result<()> {
    use anyhow::Context;

    let named = || folder.display().to_string();
    std::fs::create_dir_all(folder).with_context(named)?;
    clap_mangen::generate_to(Arguments::command(), folder).with_context(named)
}

/// Refuses to write the manual pages, which need another crate.
#[cfg(not(feature = "manual"))]
pub fn write_manual(folder: &Path) -> Result<()> {
    anyhow::bail!("{}: this build lacks the feature `manual`; {}", folder.display(), crate::features::advice("manual"))
}

//! Ctrl-C: the program ends at once, but never in the middle of writing a file.

use anyhow::Result;
use console::Term;
use snake_io as io;

use crate::terminal;

/// The exit code after Ctrl-C, by the convention of shells: 128 plus the number of SIGINT.
const INTERRUPTED: i32 = 130;

/// Installs a handler for Ctrl-C. The handler waits for the file that is being written and ends the program with exit
/// code 130. If the process ignores SIGINT, as a shell's background jobs do, it continues to ignore it.
pub fn end_between_files() -> Result<()> {
    let outcome = ctrlc::try_set_handler(|| {
        let _files = io::hold_writes();
        let terminal = Term::stderr();
        if terminal.is_term() {
            // The line may hold a progress bar.
            let _ = terminal.clear_line();
        }
        terminal::print_to_stderr(&["interrupted"].into_iter().collect());
        std::process::exit(INTERRUPTED);
    });
    match outcome {
        Ok(()) | Err(ctrlc::Error::MultipleHandlers) => Ok(()),
        Err(error) => Err(error.into()),
    }
}

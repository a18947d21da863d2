//! Ctrl-C: the program ends at once, but never within a file that it writes.

use anyhow::Result;
use console::Term;
use snake_io as io;

use crate::terminal;

/// The exit code of a program that Ctrl-C ended, as shells have it: 128 and the number of SIGINT.
const INTERRUPTED: i32 = 130;

/// From now on Ctrl-C waits for the file that is being written, a moment, and ends the program with exit code 130. Where
/// it is ignored, as by a shell's background jobs, that stays so.
pub fn end_between_files() -> Result<()> {
    let outcome = ctrlc::try_set_handler(|| {
        let _files = io::hold_writes();
        let terminal = Term::stderr();
        if terminal.is_term() {
            // The bar may stand there.
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

//! The program `snake-cli`.

use std::ffi::OsString;
use std::io::Write;

use pyo3::prelude::*;

/// Runs `snake-cli` with these words, the first of which is its name, and returns its exit code.
#[pyfunction]
pub fn run_command(py: Python<'_>, words: Vec<OsString>) -> u8 {
    py.detach(|| {
        let code = snake_keypoints::run(&words);
        // Rust flushes it only at the end of a Rust program.
        let _ = std::io::stdout().flush();
        code
    })
}

//! Converts errors of the crates to Python exceptions.

use std::path::PathBuf;

use pyo3::PyErr;
use pyo3::exceptions::{PyOSError, PyTimeoutError, PyValueError};
use snake_core::{Error, shortened, shortened_value};

/// A ValueError with a text of bounded length.
pub fn value_error(text: &str) -> PyErr {
    PyValueError::new_err(shortened(text).into_owned())
}

/// The exception for an error of the core. `Io` becomes an OSError with errno and file name, which gives
/// FileNotFoundError and similar subclasses, a missed deadline a TimeoutError. Any other error becomes a ValueError.
pub fn py_error(error: impl Into<Error>) -> PyErr {
    match error.into() {
        Error::Io { path, source } => os_error(path, &source),
        Error::DeadlineExceeded => PyTimeoutError::new_err(Error::DeadlineExceeded.to_string()),
        other => value_error(&other.to_string()),
    }
}

/// The exception for an error of reading a file, by the same rule.
pub fn file_error(error: snake_io::Error) -> PyErr {
    match error {
        snake_io::Error::Io { path, source } => os_error(path, &source),
        other => value_error(&other.to_string()),
    }
}

/// The exception for an error of a run in tiles, by the same rule.
pub fn tiles_error(error: snake_tiles::Error) -> PyErr {
    match error {
        snake_tiles::Error::Core(error) => py_error(error),
        snake_tiles::Error::Input(error) => file_error(error),
        snake_tiles::Error::File { path, source } => os_error(path, &source),
        other => value_error(&other.to_string()),
    }
}

fn os_error(path: PathBuf, source: &std::io::Error) -> PyErr {
    let text = source.to_string();
    let reason = text.split(" (os error").next().unwrap_or_default().to_owned();
    PyOSError::new_err((source.raw_os_error(), reason, shortened_value(&path.display())))
}

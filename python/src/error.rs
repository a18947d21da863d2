//! Converts errors of the crates to Python exceptions.

use pyo3::PyErr;
use pyo3::exceptions::{PyOSError, PyTimeoutError, PyValueError};
use snake_core::{Error, shortened, shortened_value};

/// A ValueError with a text of bounded length.
pub fn value_error(text: &str) -> PyErr {
    PyValueError::new_err(shortened(text).into_owned())
}

/// The exception for an error of the core. `Io` becomes an OSError with errno and file name, which gives
/// FileNotFoundError and similar subclasses. A missed deadline becomes a TimeoutError, any other error a ValueError.
pub fn py_error(error: Error) -> PyErr {
    match error {
        Error::Io { path, source } => {
            let text = source.to_string();
            let reason = text.split(" (os error").next().unwrap_or_default().to_owned();
            PyOSError::new_err((source.raw_os_error(), reason, shortened_value(&path.display())))
        }
        Error::DeadlineExceeded => PyTimeoutError::new_err(Error::DeadlineExceeded.to_string()),
        other => value_error(&other.to_string()),
    }
}

/// The exception for an error of a run in tiles, by the same rules.
pub fn tiles_error(error: snake_tiles::Error) -> PyErr {
    match error {
        snake_tiles::Error::Core(error) => py_error(error),
        other => value_error(&other.to_string()),
    }
}

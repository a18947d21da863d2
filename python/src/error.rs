//! The core's errors as Python exceptions.

use pyo3::PyErr;
use pyo3::exceptions::{PyOSError, PyValueError};
use snake_core::Error;

/// `Io` becomes an OSError with errno and file name (so FileNotFoundError and its kin), the rest a ValueError.
pub fn py_error(error: Error) -> PyErr {
    match error {
        Error::Io { path, source } => {
            let text = source.to_string();
            let reason = text.split(" (os error").next().unwrap_or_default().to_owned();
            PyOSError::new_err((source.raw_os_error(), reason, path.into_os_string()))
        }
        other => PyValueError::new_err(other.to_string()),
    }
}

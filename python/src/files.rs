//! Files of clouds and meshes.

use std::path::PathBuf;

use pyo3::prelude::*;
use snake_io::{Contents, ReadOptions, read_contents};

use crate::error::py_error;
use crate::warn;

/// Reads a file. Each note about it gives a UserWarning.
pub fn contents(py: Python<'_>, path: PathBuf, options: ReadOptions) -> PyResult<Contents> {
    let contents = py.detach(|| read_contents(&path, &options)).map_err(py_error)?;
    warn(py, &contents.notes)?;
    Ok(contents)
}

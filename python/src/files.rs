//! Files of clouds and meshes.

use std::path::PathBuf;

use pyo3::prelude::*;
use snake_io::{Contents, ReadOptions, read_contents};

use crate::error::file_error;

/// Reads a file. Vertices that stand in for the surface of a mesh give a UserWarning.
pub fn contents(py: Python<'_>, path: PathBuf, options: ReadOptions) -> PyResult<Contents> {
    let contents = py.detach(|| read_contents(&path, &options)).map_err(file_error)?;
    if contents.unsampled_faces > 0 {
        let what = format!("{} is a mesh of {} faces", path.display(), contents.unsampled_faces);
        let (number, advice) = (contents.cloud.points.len(), "sample=N of read_points draws N points from the surface");
        py.import("warnings")?.call_method1("warn", (format!("{what}: its {number} vertices are taken; {advice}"),))?;
    }
    Ok(contents)
}

//! Files of clouds and meshes.

use std::path::PathBuf;

use pyo3::prelude::*;
use snake_io::{Contents, ReadOptions, read_contents};

use crate::error::file_error;

/// Reads a file. Vertices that stand in for the surface of a mesh, and a face with most of it, give a UserWarning.
pub fn contents(py: Python<'_>, path: PathBuf, options: ReadOptions) -> PyResult<Contents> {
    let contents = py.detach(|| read_contents(&path, &options)).map_err(file_error)?;
    if contents.unsampled_faces > 0 {
        // The same words for all files, so that Python says them once.
        let text =
            "the file is a mesh: its vertices are taken; sample=N of read_points draws N points from its surface";
        py.import("warnings")?.call_method1("warn", (text,))?;
    }
    if contents.dominant_face.is_some() {
        let text = "one face holds most of the mesh's surface, and so of the samples";
        py.import("warnings")?.call_method1("warn", (text,))?;
    }
    Ok(contents)
}

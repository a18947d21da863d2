//! `snake_rs.read_points`.

use std::path::PathBuf;

use numpy::PyArray2;
use pyo3::prelude::*;
use snake_core::add_origin;
use snake_io::{Cloud, Column, Columns, ReadOptions, read_contents};

use crate::arrays;
use crate::error::file_error;

/// Reads a point cloud or a mesh: (N, 3) float64, in the file's order, units and frame.
///
/// The extension says which format: ply, pcd, xyz, txt, csv, pts, npy, npz, las, laz, obj, off or stl. Of a mesh, `sample`
/// draws that many points from the surface, evenly by area, instead of taking its vertices; `seed` is that of the draw.
/// Without `sample`, a mesh gives a UserWarning. Of text and numpy arrays, `columns` are those of x, y and z: three names of
/// the header, or indices from 0; by default the header says them, and without one they are the first three. Points that
/// are not finite come through. Coordinates keep about 7 digits of the cloud's size. Raises OSError when the file cannot
/// be read, ValueError when it is not what its name says, its columns cannot be told or it has no surface to draw from.
#[pyfunction]
#[pyo3(signature = (path, sample=None, seed=0, columns=None))]
pub fn read_points(
    py: Python<'_>,
    path: PathBuf,
    sample: Option<usize>,
    seed: u64,
    columns: Option<[ColumnLike; 3]>,
) -> PyResult<Bound<'_, PyArray2<f64>>> {
    let columns = columns.map(|columns| Columns(columns.map(Column::from)));
    let contents = py.detach(|| read_contents(&path, &ReadOptions { sample, seed, columns })).map_err(file_error)?;
    let Cloud { points, origin } = contents.cloud;
    if contents.unsampled_faces > 0 {
        let what = format!("{} is a mesh of {} faces", path.display(), contents.unsampled_faces);
        let advice = format!("its {} vertices are taken; sample=N draws N points from the surface", points.len());
        py.import("warnings")?.call_method1("warn", (format!("{what}: {advice}"),))?;
    }
    arrays::rows(py, points.iter().flat_map(|&point| add_origin(point, origin)).collect(), 3)
}

/// A column as Python gives it.
#[derive(FromPyObject)]
pub enum ColumnLike {
    Index(usize),
    Name(String),
}

impl From<ColumnLike> for Column {
    fn from(column: ColumnLike) -> Self {
        match column {
            ColumnLike::Index(index) => Self::Index(index),
            ColumnLike::Name(name) => Self::Name(name),
        }
    }
}

//! `snake_rs.read_points`.

use std::path::PathBuf;

use numpy::PyArray2;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use snake_core::add_origin;
use snake_io::{Cloud, Column, Columns, ReadOptions};

use crate::arrays;
use crate::files::contents;

/// Reads a point cloud or a mesh: (N, 3) float64, in the file's order, units and frame.
///
/// The extension determines the format: ply, pcd, xyz, txt, csv, pts, asc, npy, npz, las, laz, e57, obj, off, stl, gltf or glb; and the
/// folder, for sweeps of KITTI and nuScenes. For a mesh,
/// `sample` draws that many points from the surface, uniformly by area, and `seed` determines the draw. Without
/// `sample`, a mesh gives its vertices and a UserWarning. For text and numpy arrays, `columns` selects x, y and z:
/// three names in the header, or numbers from 1 as for `--columns`. The default is x, y and z of the header, or without a header the first
/// three columns. Points that are not finite are kept. Points that a LAS or LAZ file marks as withheld or classifies as noise (7 and
/// 18) are NaN, unless `keep_withheld` is set. Coordinates keep about 7 digits relative to the cloud's size.
/// Raises OSError when the file cannot be read. Raises ValueError when the content does not match the extension, when
/// the columns are ambiguous, or when there is no surface to sample.
#[pyfunction]
#[pyo3(signature = (path, sample=None, seed=0, columns=None, keep_withheld=false))]
pub fn read_points(
    py: Python<'_>,
    path: PathBuf,
    sample: Option<usize>,
    seed: u64,
    columns: Option<[ColumnLike; 3]>,
    keep_withheld: bool,
) -> PyResult<Bound<'_, PyArray2<f64>>> {
    let columns = columns.map(chosen).transpose()?;
    let options = ReadOptions::default().with_sample(sample).with_seed(seed).with_columns(columns);
    let Cloud { points, origin } = contents(py, path, options.with_keep_withheld(keep_withheld))?.cloud;
    arrays::rows(py, points.iter().flat_map(|&point| add_origin(point, origin)).collect(), 3)
}

/// A column in Python: a number from 1, as on the command line, or a name.
#[derive(FromPyObject)]
pub enum ColumnLike {
    Number(usize),
    Name(String),
}

fn chosen(columns: [ColumnLike; 3]) -> PyResult<Columns> {
    if columns.iter().any(|column| matches!(column, ColumnLike::Number(0))) {
        return Err(PyValueError::new_err("columns: columns count from 1; the first three are (1, 2, 3)"));
    }
    Ok(Columns(columns.map(|column| match column {
        ColumnLike::Number(number) => Column::Index(number - 1),
        ColumnLike::Name(name) => Column::Name(name),
    })))
}

//! `snake_rs.read_points`.

use std::path::PathBuf;

use numpy::{PyArray1, PyArray2, PyArrayMethods};
use pyo3::prelude::*;
use snake_core::io::{ReadOptions, read_cloud};

use crate::threads;

/// Reads a point cloud or a mesh: (N, 3) float64, in the file's order, units and frame.
///
/// The extension says which format: ply, pcd, xyz, txt, csv, pts, npy, npz, las, laz, obj, off or stl. Of a mesh, `sample`
/// draws that many points from the surface, evenly by area, instead of taking its vertices; `seed` is that of the draw.
/// Points that are not finite come through. Coordinates keep about 7 digits of the cloud's size. Raises OSError when the
/// file cannot be read, ValueError when it is not what its name says or has no surface to draw from.
#[pyfunction]
#[pyo3(signature = (path, sample=None, seed=0))]
pub fn read_points(
    py: Python<'_>,
    path: PathBuf,
    sample: Option<usize>,
    seed: u64,
) -> PyResult<Bound<'_, PyArray2<f64>>> {
    let cloud = threads::run(py, || read_cloud(&path, &ReadOptions { sample, seed }))?;
    let row =
        |point: &[f32; 3]| -> [f64; 3] { std::array::from_fn(|axis| f64::from(point[axis]) + cloud.origin[axis]) };
    let rows: Vec<[f64; 3]> = cloud.points.iter().map(row).collect();
    let number = rows.len();
    PyArray1::from_vec(py, rows.into_flattened()).reshape([number, 3])
}

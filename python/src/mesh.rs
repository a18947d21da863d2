//! `snake_rs.Mesh`.

use numpy::{PyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyTuple;

use crate::arrays::{self, Positions, Precision};

/// A closed surface of T triangles with V shared vertices; made by `Field.mesh`. It can be pickled.
#[pyclass(frozen, get_all, module = "snake_rs")]
pub struct Mesh {
    /// Positions (V, 3), in the cloud's frame and units: float32 if the cloud was float32 or float16, else float64.
    vertices: Positions,
    /// Unit normals (V, 3) float32 at the vertices, pointing out of the occupied volume.
    normals: Py<PyArray2<f32>>,
    /// Vertex indices (T, 3) uint32, counterclockwise when seen from outside.
    triangles: Py<PyArray2<u32>>,
    /// Notes on it, a list of sentences: that it is empty, or that its shell is open.
    notes: Vec<String>,
}

impl Mesh {
    /// Converts the core's mesh to arrays.
    pub fn from_core(py: Python<'_>, mesh: snake_core::Mesh, origin: [f64; 3], precision: Precision) -> PyResult<Self> {
        let notes = mesh.notes();
        Ok(Self {
            notes,
            vertices: Positions::new(py, &mesh.vertices, origin, precision)?,
            normals: arrays::rows(py, mesh.normals.into_flattened(), 3)?.unbind(),
            triangles: arrays::rows(py, mesh.triangles.into_flattened(), 3)?.unbind(),
        })
    }
}

#[pymethods]
impl Mesh {
    #[new]
    #[pyo3(signature = (vertices, normals, triangles, notes=vec![]))]
    fn new(vertices: Positions, normals: Py<PyArray2<f32>>, triangles: Py<PyArray2<u32>>, notes: Vec<String>) -> Self {
        Self { vertices, normals, triangles, notes }
    }

    fn __getnewargs__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        (&self.vertices, &self.normals, &self.triangles, &self.notes).into_pyobject(py)
    }

    fn __repr__(&self, py: Python<'_>) -> String {
        let [vertices, triangles] = [self.normals.bind(py).shape()[0], self.triangles.bind(py).shape()[0]];
        format!("Mesh({vertices} vertices, {triangles} triangles)")
    }
}

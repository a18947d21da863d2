//! Arrays and names in and out: points are checked and copied once, results become numpy arrays without a copy.

use numpy::{
    PyArray1, PyArray2, PyArrayDescrMethods, PyArrayMethods, PyReadonlyArray2, PyUntypedArray, PyUntypedArrayMethods,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use snake_core::Point;

/// Copies an array-like `(N, 3)` of float32 or float64 while the GIL is held: once it is released, another thread may
/// write into the array. numpy's own conversion deals with strides, byte order and alignment.
pub fn points(what: &str, value: &Bound<PyAny>) -> PyResult<Vec<Point>> {
    let numpy = value.py().import("numpy")?;
    let given = numpy.call_method1("asarray", (value,))?;
    let array = given.cast::<PyUntypedArray>()?;
    let is_float = array.dtype().kind() == b'f' && [4, 8].contains(&array.dtype().itemsize());
    if !is_float || array.ndim() != 2 || array.shape()[1] != 3 {
        let found = format!("{} of shape {}", array.dtype(), array.getattr("shape")?);
        return Err(PyValueError::new_err(format!(
            "{what}: expected float32 or float64 of shape (N, 3), found {found}"
        )));
    }
    let aligned: PyReadonlyArray2<f32> = numpy.call_method1("require", (array, "float32", "CA"))?.extract()?;
    Ok(aligned.as_slice()?.as_chunks().0.to_vec())
}

/// Values `(N,)`.
pub fn values<T: numpy::Element>(py: Python<'_>, values: Vec<T>) -> Bound<'_, PyArray1<T>> {
    PyArray1::from_vec(py, values)
}

/// Rows `(N, columns)` from flat values.
pub fn rows<T: numpy::Element>(py: Python<'_>, flat: Vec<T>, columns: usize) -> PyResult<Bound<'_, PyArray2<T>>> {
    let rows = flat.len() / columns;
    PyArray1::from_vec(py, flat).reshape([rows, columns])
}

/// What a name stands for.
pub fn named<T: Copy>(option: &str, name: &str, known: [(&str, T); 2]) -> PyResult<T> {
    let found = known.iter().find(|(known, _)| *known == name).map(|(_, value)| *value);
    found.ok_or_else(|| {
        let [(first, _), (second, _)] = known;
        PyValueError::new_err(format!("option `{option}` is {name}: allowed is {first} or {second}"))
    })
}

//! Arrays and names in and out: points are checked and copied once, results become numpy arrays without a copy.

use numpy::{
    PyArray1, PyArray2, PyArrayDescrMethods, PyArrayMethods, PyReadonlyArray2, PyUntypedArray, PyUntypedArrayMethods,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use snake_core::Point;

/// Copies points `(N, 3)` while the GIL is held: once it is released, another thread may write into the array. They are
/// what numpy takes for an array of real numbers (numpy's own, tensors of torch, vectors of Open3D, vertices of trimesh),
/// or an object that has such `points` or `vertices`; numpy's conversion deals with types, strides, byte order and
/// alignment.
pub fn points(what: &str, value: &Bound<PyAny>) -> PyResult<Vec<Point>> {
    let numpy = value.py().import("numpy")?;
    let given = as_array(&numpy, what, value)?;
    let array = given.cast::<PyUntypedArray>()?;
    let is_real = matches!(array.dtype().kind(), b'f' | b'i' | b'u');
    if !is_real || array.ndim() != 2 || array.shape()[1] != 3 {
        let found = format!("{} of shape {}", array.dtype(), array.getattr("shape")?);
        return Err(PyValueError::new_err(format!("{what}: expected real numbers of shape (N, 3), found {found}")));
    }
    let aligned: PyReadonlyArray2<f32> = numpy.call_method1("require", (array, "float32", "CA"))?.extract()?;
    Ok(aligned.as_slice()?.as_chunks().0.to_vec())
}

/// What numpy makes of a value, or of the points or vertices that it has.
fn as_array<'py>(numpy: &Bound<'py, PyModule>, what: &str, value: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
    if !value.hasattr("__array__")? && !value.hasattr("__dlpack__")? {
        for part in ["points", "vertices"] {
            if let Some(part) = value.getattr_opt(part)? {
                return converted(numpy, what, &part);
            }
        }
    }
    converted(numpy, what, value)
}

/// What numpy makes of a value; nothing is copied that need not be. An exception of the value's own conversion is passed
/// on as it is, one of numpy's becomes a ValueError that begins with `what`.
fn converted<'py>(numpy: &Bound<'py, PyModule>, what: &str, value: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
    if value.hasattr("__array__")? {
        return numpy.call_method1("asarray", (value,));
    }
    if value.hasattr("__dlpack__")? {
        return numpy.call_method1("from_dlpack", (value,));
    }
    numpy.call_method1("asarray", (value,)).map_err(|error| {
        let refused = PyValueError::new_err(format!("{what}: {}", error.value(value.py())));
        refused.set_cause(value.py(), Some(error));
        refused
    })
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

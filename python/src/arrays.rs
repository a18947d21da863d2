//! Converts arrays and names. Points are checked and copied once; results become numpy arrays without a copy.

use numpy::{
    PyArray1, PyArray2, PyArrayDescrMethods, PyArrayMethods, PyReadonlyArray2, PyUntypedArray, PyUntypedArrayMethods,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyList, PyString, PyTuple};
use snake_core::{Cloud, Point, RigidTransform, add_origin, excerpt, subtract_origin};
use snake_io::ReadOptions;

use crate::error::{py_error, value_error};
use crate::files;

/// Rows `(N, 3)` of an array: `float32` for arrays of `float32` or `float16`, else `float64`, which holds the
/// coordinates of georeferenced scans.
pub enum Rows<'py> {
    Single(PyReadonlyArray2<'py, f32>),
    Double(PyReadonlyArray2<'py, f64>),
}

/// The floating-point type of positions, which follows the input points.
#[derive(Clone, Copy, PartialEq)]
pub enum Precision {
    Single,
    Double,
}

/// Positions `(N, 3)` as a numpy array of one of the two types.
#[derive(FromPyObject, IntoPyObjectRef)]
pub enum Positions {
    Single(Py<PyArray2<f32>>),
    Double(Py<PyArray2<f64>>),
}

impl Rows<'_> {
    /// Copies the rows, relative to an origin if they are far from zero, and returns their type. The GIL must be held,
    /// because another thread may write to the array once it is released.
    pub fn cloud(&self) -> PyResult<(Cloud, Precision)> {
        Ok(match self {
            Self::Single(rows) => {
                let positions = rows.as_slice()?.as_chunks().0.iter().map(|point: &[f32; 3]| point.map(f64::from));
                (Cloud::from_positions(positions), Precision::Single)
            }
            Self::Double(rows) => {
                (Cloud::from_positions(rows.as_slice()?.as_chunks().0.iter().copied()), Precision::Double)
            }
        })
    }

    /// Copies the rows relative to the given origin.
    pub fn relative_to(&self, origin: [f64; 3]) -> PyResult<Vec<Point>> {
        Ok(match self {
            Self::Single(rows) => {
                let points = rows.as_slice()?.as_chunks().0.iter();
                points.map(|point: &[f32; 3]| subtract_origin(point.map(f64::from), origin)).collect()
            }
            Self::Double(rows) => {
                let points = rows.as_slice()?.as_chunks().0.iter();
                points.map(|&position| subtract_origin(position, origin)).collect()
            }
        })
    }
}

impl Positions {
    /// An array of points, with the origin added.
    pub fn new(py: Python<'_>, points: &[Point], origin: [f64; 3], precision: Precision) -> PyResult<Self> {
        let positions = points.iter().flat_map(|&point| add_origin(point, origin));
        Ok(match precision {
            Precision::Single => Self::Single(rows(py, positions.map(|v| v as f32).collect(), 3)?.unbind()),
            Precision::Double => Self::Double(rows(py, positions.collect(), 3)?.unbind()),
        })
    }

    /// The numpy array.
    pub fn bind<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        match self {
            Self::Single(array) => array.bind(py).clone().into_any(),
            Self::Double(array) => array.bind(py).clone().into_any(),
        }
    }
}

/// The first three columns of an array of real numbers. The value is anything that numpy converts to such an array
/// (numpy arrays, torch tensors, Open3D vectors, trimesh vertices), or an object with such `points` or `vertices`.
/// Masked rows become NaN. numpy's conversion handles types, strides, byte order and alignment.
pub fn given_rows<'py>(what: &str, value: &Bound<'py, PyAny>) -> PyResult<Rows<'py>> {
    let (py, numpy) = (value.py(), value.py().import("numpy")?);
    let given = with_rows(as_array(&numpy, what, value)?)?;
    let array = given.cast::<PyUntypedArray>()?;
    let refused = |why: &str| -> PyResult<PyErr> {
        let shape = array.getattr("shape")?;
        let needed = "expected real numbers of shape (N, 3) or more columns, or (H, W, 3), found";
        Ok(PyValueError::new_err(format!("{what}: {needed} {} of shape {shape}{why}", array.dtype())))
    };
    let (kind, size) = (array.dtype().kind(), array.dtype().itemsize());
    let is_real = matches!(kind, b'f' | b'i' | b'u');
    if is_real && array.ndim() == 2 && array.shape()[1] == 2 {
        return Err(refused(": points of a plane need a third column, numpy.c_[points, numpy.zeros(len(points))]")?);
    }
    if !is_real || array.ndim() != 2 || array.shape()[1] < 3 {
        return Err(refused("")?);
    }
    if let &[rows @ (3 | 4), columns] = array.shape()
        && columns > MAX_COLUMNS
    {
        return Err(refused(&format!(": a point is a row, so transpose {columns} points in {rows} rows"))?);
    }
    let dtype = if kind == b'f' && size <= 4 { "float32" } else { "float64" };
    let columns = given.get_item((pyo3::types::PySlice::full(py), pyo3::types::PySlice::new(py, 0, 3, 1)))?;
    let is_masked = given.is_instance(&numpy.getattr("ma")?.getattr("MaskedArray")?)?;
    let filled = if is_masked {
        columns.call_method1("astype", (dtype,))?.call_method1("filled", (f64::NAN,))?
    } else {
        columns
    };
    let required = numpy.call_method1("require", (filled, dtype, "CA"))?;
    Ok(match dtype {
        "float32" => Rows::Single(required.extract()?),
        _ => Rows::Double(required.extract()?),
    })
}

/// The rows `(H W, C)` of an organised array `(H, W, C)`, in the order of `reshape`. Other arrays stay as they are.
fn with_rows(given: Bound<PyAny>) -> PyResult<Bound<PyAny>> {
    match *given.cast::<PyUntypedArray>()?.shape() {
        [height, width, columns] if (3..=MAX_COLUMNS).contains(&columns) => {
            given.call_method1("reshape", (height * width, columns))
        }
        _ => Ok(given),
    }
}

/// Maximum number of columns of rows of points. More columns are the points of a transposed array.
const MAX_COLUMNS: usize = 16;

/// A rigid transform (4, 4).
pub fn transform(what: &str, value: &Bound<PyAny>) -> PyResult<RigidTransform> {
    let list = value.py().import("numpy")?.call_method1("asarray", (value,))?.call_method0("tolist")?;
    let refused = |_| value_error(&format!("{what}: expected a transform of shape (4, 4), found {value}"));
    RigidTransform::from_matrix(list.extract().map_err(refused)?).map_err(|error| match error {
        snake_geometry::Error::Input { reason, .. } => PyValueError::new_err(format!("{what}: {reason}")),
        other => py_error(other),
    })
}

/// The rows of an array, without subtracting an origin.
pub fn points(what: &str, value: &Bound<PyAny>) -> PyResult<Vec<Point>> {
    given_rows(what, value)?.relative_to([0.0; 3])
}

/// The rows of an array, or the points of a file, as a cloud.
pub fn cloud(what: &str, value: &Bound<PyAny>) -> PyResult<(Cloud, Precision)> {
    let (cloud, precision, _) = cloud_with_notes(what, value)?;
    Ok((cloud, precision))
}

/// [`cloud`] with the notes about the file.
pub fn cloud_with_notes(what: &str, value: &Bound<PyAny>) -> PyResult<(Cloud, Precision, Vec<String>)> {
    // A text is a path. Other values are paths only if they say so, as pathlib's do.
    if value.is_instance_of::<PyString>() || value.hasattr("__fspath__")? {
        let contents = files::contents(value.py(), value.extract()?, ReadOptions::default())?;
        return Ok((contents.cloud, Precision::Double, contents.notes));
    }
    if let Some(clouds) = list_of_clouds(value)? {
        let reason = format!("{what}: expected one cloud, found a list of {}", clouds.len());
        return Err(PyValueError::new_err(reason));
    }
    let (cloud, precision) = given_rows(what, value)?.cloud()?;
    Ok((cloud, precision, Vec::new()))
}

/// The items of a list or tuple of clouds; `None` for anything else, such as a list of rows.
pub fn list_of_clouds<'py>(value: &Bound<'py, PyAny>) -> PyResult<Option<Vec<Bound<'py, PyAny>>>> {
    if !value.is_instance_of::<PyList>() && !value.is_instance_of::<PyTuple>() {
        return Ok(None);
    }
    let items: Vec<Bound<PyAny>> = value.try_iter()?.collect::<PyResult<_>>()?;
    let Some(first) = items.first() else { return Ok(None) };
    // A row is a sequence of numbers.
    let is_sequence = |item: &Bound<PyAny>| item.len().is_ok() && !item.is_instance_of::<PyString>();
    let is_row = is_sequence(first) && first.get_item(0).is_ok_and(|item| !is_sequence(&item));
    let is_number = first.extract::<f64>().is_ok();
    Ok((!is_row && !is_number).then_some(items))
}

/// Converts a value, or its points or vertices, to a numpy array. The points are the attribute `xyz` (laspy), `positions`
/// in `point` (Open3D tensor clouds), `points` or `vertices`.
fn as_array<'py>(numpy: &Bound<'py, PyModule>, what: &str, value: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
    if let Some(columns) = columns_of_frame(what, value)? {
        return converted(numpy, what, &columns);
    }
    if !value.hasattr("__array__")? && !value.hasattr("__dlpack__")? {
        for part in ["point", "vertex"] {
            if let Some(part) = value.getattr_opt(part)? {
                let positions = part.get_item("positions");
                let empty = |_| PyValueError::new_err(format!("{what}: no points: it has no `positions`"));
                return converted(numpy, what, &positions.map_err(empty)?);
            }
        }
        for part in ["xyz", "points", "vertices"] {
            if let Some(part) = value.getattr_opt(part)? {
                return converted(numpy, what, &part);
            }
        }
    }
    let array = converted(numpy, what, value)?;
    with_columns(numpy, array)
}

/// The columns x, y and z, in any order, of a pandas or polars frame or an Arrow table. `None` for anything else, and for
/// a frame whose columns are numbered. Other names are refused, because the first three columns may be anything.
fn columns_of_frame<'py>(what: &str, value: &Bound<'py, PyAny>) -> PyResult<Option<Bound<'py, PyAny>>> {
    let Some(names) = value.getattr_opt("column_names")?.or(value.getattr_opt("columns")?) else { return Ok(None) };
    let Ok(names) = names.try_iter() else { return Ok(None) };
    let names: Vec<Bound<PyAny>> = names.collect::<PyResult<_>>()?;
    if names.iter().all(|name| name.extract::<i64>().is_ok()) {
        return Ok(None);
    }
    let names: Vec<String> = names.iter().map(|name| Ok(name.str()?.to_string())).collect::<PyResult<_>>()?;
    if !AXES.iter().all(|axis| names.iter().filter(|name| name == axis).count() == 1) {
        let listed = excerpt(&names.join(", "), 300);
        let reason = format!(
            "{what}: the columns of the frame are {listed}: expected x, y and z, each once; choose three others by \
             frame[[\"a\", \"b\", \"c\"]].to_numpy()"
        );
        return Err(PyValueError::new_err(reason));
    }
    let axes = PyList::new(value.py(), AXES)?;
    let chosen =
        if value.hasattr("select")? { value.call_method1("select", (axes,))? } else { value.get_item(axes)? };
    Ok(Some(chosen))
}

/// The names of the columns with coordinates.
const AXES: [&str; 3] = ["x", "y", "z"];

/// An array whose rows have the named fields x, y and z, as `(N, 3)`. Other arrays stay as they are.
fn with_columns<'py>(numpy: &Bound<'py, PyModule>, array: Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
    let names: Option<Vec<String>> = array.getattr("dtype")?.getattr("names")?.extract()?;
    if !names.is_some_and(|names| AXES.iter().all(|axis| names.iter().any(|name| name == axis))) {
        return Ok(array);
    }
    let columns: Vec<Bound<PyAny>> =
        AXES.iter().map(|axis| array.get_item(axis)?.call_method0("ravel")).collect::<PyResult<_>>()?;
    numpy.call_method1("column_stack", (columns,))
}

/// Converts a value to a numpy array, without a copy where possible. An exception from the value's own conversion is
/// passed on unchanged. An exception from numpy becomes a ValueError that begins with `what`.
fn converted<'py>(numpy: &Bound<'py, PyModule>, what: &str, value: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
    // A tensor that records its gradient, or that is on another device, has no array.
    let tensor =
        if value.hasattr("requires_grad")? { &value.call_method0("detach")?.call_method0("cpu")? } else { value };
    let value = tensor;
    if value.hasattr("__array__")? {
        let masked = numpy.getattr("ma")?.getattr("MaskedArray")?;
        // `asanyarray` keeps the mask of a masked array.
        let convert = if value.is_instance(&masked)? { "asanyarray" } else { "asarray" };
        return numpy.call_method1(convert, (value,));
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

/// An array `(N,)` of values.
pub fn values<T: numpy::Element>(py: Python<'_>, values: Vec<T>) -> Bound<'_, PyArray1<T>> {
    PyArray1::from_vec(py, values)
}

/// An array `(N, columns)` from flat values.
pub fn rows<T: numpy::Element>(py: Python<'_>, flat: Vec<T>, columns: usize) -> PyResult<Bound<'_, PyArray2<T>>> {
    let rows = flat.len() / columns;
    PyArray1::from_vec(py, flat).reshape([rows, columns])
}

/// The value with the given name among `known`.
pub fn named<T: Copy>(option: &str, name: &str, known: [(&str, T); 2]) -> PyResult<T> {
    let value = known.iter().find(|(known, _)| *known == name).map(|(_, value)| *value);
    value.ok_or_else(|| {
        let [(first, _), (second, _)] = known;
        value_error(&format!("option `{option}` is {name}: allowed is {first} or {second}"))
    })
}

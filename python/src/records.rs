//! Results as Python objects: classes and documentation come from the core's tables, values from its JSON.

use numpy::{PyArray1, PyArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};
use serde::Serialize;
use serde_json::Value;
use snake_geometry::{Record, RecordInfo, RecordKind};
use snake_registration::RECORDS;

use crate::options;

/// Adds the classes of all results to the module.
pub fn add_classes(module: &Bound<'_, PyModule>) -> PyResult<()> {
    let make = module.py().import("snake_rs._records")?.getattr("make")?;
    for record in RECORDS {
        let fields: Vec<_> = record.fields().map(|field| (field.name, field.doc)).collect();
        module.add(record.name, make.call1((record.name, record.doc, fields))?)?;
    }
    Ok(())
}

/// Converts a result to an object of its class.
pub fn to_python<'py, T: Record + Serialize>(py: Python<'py>, result: &T) -> PyResult<Bound<'py, PyAny>> {
    let value = serde_json::to_value(result).map_err(|error| PyValueError::new_err(error.to_string()))?;
    object(py, T::INFO, &value)
}

fn object<'py>(py: Python<'py>, record: &RecordInfo, value: &Value) -> PyResult<Bound<'py, PyAny>> {
    let given = PyDict::new(py);
    for field in record.fields() {
        given.set_item(field.name, converted(py, &(field.kind)(), &value[field.name])?)?;
    }
    py.import("snake_rs._core")?.getattr(record.name)?.call((), Some(&given))
}

fn converted<'py>(py: Python<'py>, kind: &RecordKind, value: &Value) -> PyResult<Bound<'py, PyAny>> {
    match (kind, value) {
        (RecordKind::Optional(kind), value) if !value.is_null() => converted(py, kind, value),
        (RecordKind::Record(record), value) => object(py, record, value),
        (RecordKind::List(item), Value::Array(rows)) if is_row(item) => {
            let numbers = rows.iter().flat_map(|row| row.as_array().into_iter().flatten());
            let flat: Vec<f64> = numbers.filter_map(Value::as_f64).collect();
            let shape = [rows.len(), flat.len() / rows.len().max(1)];
            Ok(PyArray1::from_vec(py, flat).reshape(shape)?.into_any())
        }
        (RecordKind::List(item), Value::Array(values)) => {
            let values = values.iter().map(|value| converted(py, item, value)).collect::<PyResult<Vec<_>>>()?;
            Ok(PyList::new(py, values)?.into_any())
        }
        (_, value) => options::to_python(py, value),
    }
}

/// Whether a list of such items is a matrix.
fn is_row(kind: &RecordKind) -> bool {
    matches!(kind, RecordKind::List(item) if matches!(**item, RecordKind::Number))
}

//! Converts keyword arguments to the core's options. Names and types come from the core's serialisation, so there is no
//! second list of options here.

use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList, PyString};
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Map, Number, Value};
use snake_core::{Options, in_words, option_names, shortened};

use crate::error::{py_error, value_error};

/// The part of [`Options`] that `Model.encode` takes.
pub const ENCODE: [&str; 1] = ["/encode"];
/// The part that `Field.detect` takes.
pub const DETECT: [&str; 1] = ["/detect"];
/// All parts, and the options that belong to no part.
pub const ALL: [&str; 3] = ["/encode", "/detect", ""];

/// The options of one call: the recommended options or the named `preset`, overridden by the other keywords. Each
/// keyword must belong to one of the `parts`.
pub fn resolve(
    function: &str,
    parts: &[&str],
    recommended: &Options,
    given: Option<&Bound<PyDict>>,
) -> PyResult<Options> {
    recommended.resolve(&values(function, parts, given)?).map_err(py_error)
}

/// The keywords of one call as JSON, including `preset`, with the right types. Each must belong to one of the `parts`.
pub fn values(function: &str, parts: &[&str], given: Option<&Bound<PyDict>>) -> PyResult<Map<String, Value>> {
    let mut values = Map::new();
    let mut tree = tree(&Options::default())?;
    for (name, value) in given.into_iter().flatten() {
        let name: String = name.extract()?;
        if name == "preset" {
            if !value.is_none() {
                values.insert(name, value.str()?.to_cow()?.into());
            }
            continue;
        }
        let Some(part) = parts.iter().find(|part| options_of(&tree, part).any(|option| *option == name)) else {
            let known = parts.iter().flat_map(|part| options_of(&tree, part)).map(String::as_str);
            return Err(unexpected(function, &name, std::iter::once("preset").chain(known)));
        };
        let pointer = format!("{part}/{name}");
        set::<Options>(&mut tree, &pointer, &name, &value)?;
        values.insert(name, tree.pointer(&pointer).cloned().unwrap_or_default());
    }
    Ok(values)
}

/// The names of the options of one part, without nested parts.
fn options_of<'a>(tree: &'a Value, part: &str) -> impl Iterator<Item = &'a String> {
    let entries = tree.pointer(part).and_then(Value::as_object).into_iter().flatten();
    entries.filter(|(_, value)| !value.is_object()).map(|(name, _)| name)
}

/// The options of a function without presets: the defaults, overridden by the keywords. `T` may be a pair of structs.
pub fn of<T: Default + Serialize + DeserializeOwned>(function: &str, given: Option<&Bound<PyDict>>) -> PyResult<T> {
    let mut options = T::default();
    let mut tree = serde_json::to_value(&options).map_err(|e| PyValueError::new_err(e.to_string()))?;
    for (name, value) in given.into_iter().flatten() {
        let name: String = name.extract()?;
        let known = option_names(&tree);
        let Some((group, _)) = known.iter().find(|(_, option)| *option == name) else {
            return Err(unexpected(function, &name, known.iter().map(|(_, option)| *option)));
        };
        let place = format!("{group}/{name}");
        options = set(&mut tree, &place, &name, &value)?;
    }
    Ok(options)
}

fn unexpected<'a>(function: &str, name: &str, known: impl Iterator<Item = &'a str>) -> PyErr {
    let known = known.collect::<Vec<_>>().join(", ");
    let reason = format!("{function}() got an unexpected keyword argument '{name}'; its options are {known}");
    PyTypeError::new_err(shortened(&reason).into_owned())
}

/// Sets one option and returns all options. Options are set one at a time, so that an error can name the option.
fn set<T: DeserializeOwned>(tree: &mut Value, pointer: &str, name: &str, value: &Bound<PyAny>) -> PyResult<T> {
    let refused = |reason: String| value_error(&format!("option `{name}` is {value}: {reason}"));
    let given = json(value, 2).ok_or_else(|| refused("expected finite numbers, a string or a bool".into()))?;
    if let Some(slot) = tree.pointer_mut(pointer) {
        *slot = given;
    }
    serde_json::from_value(tree.clone()).map_err(|e| refused(in_words(&e)))
}

/// The options as one flat dict, for `detect(points, model, **flat)`.
pub fn flat<'py>(py: Python<'py>, preset: &Options) -> PyResult<Bound<'py, PyDict>> {
    let options = PyDict::new(py);
    // The conversion goes through text, so that 0.7 in float32 becomes 0.7 and not 0.699999988.
    let text = serde_json::to_string(preset).map_err(|e| PyValueError::new_err(e.to_string()))?;
    let parts = py.import("json")?.call_method1("loads", (text,))?;
    for (name, value) in parts.cast::<PyDict>()? {
        match value.cast::<PyDict>() {
            Ok(part) => options.update(part.as_mapping())?,
            Err(_) => options.set_item(name, value)?,
        }
    }
    Ok(options)
}

fn tree(preset: &Options) -> PyResult<Value> {
    serde_json::to_value(preset).map_err(|e| PyValueError::new_err(e.to_string()))
}

/// Converts JSON to Python objects. Numbers keep their bits.
pub fn to_python<'py>(py: Python<'py>, value: &Value) -> PyResult<Bound<'py, PyAny>> {
    Ok(match value {
        Value::Null => py.None().into_bound(py),
        Value::Bool(flag) => flag.into_pyobject(py)?.to_owned().into_any(),
        Value::Number(number) => match (number.as_u64(), number.as_f64()) {
            (Some(whole), _) => whole.into_pyobject(py)?.into_any(),
            (None, number) => number.into_pyobject(py)?.into_any(),
        },
        Value::String(text) => text.into_pyobject(py)?.into_any(),
        Value::Array(items) => {
            let items: Vec<_> = items.iter().map(|item| to_python(py, item)).collect::<PyResult<_>>()?;
            PyList::new(py, items)?.into_any()
        }
        Value::Object(entries) => {
            let dict = PyDict::new(py);
            for (name, value) in entries {
                dict.set_item(name, to_python(py, value)?)?;
            }
            dict.into_any()
        }
    })
}

/// Maximum number of items of a sequence: a matrix has four rows of four.
const MAX_ITEMS: usize = 16;

/// Converts None, bool, str and finite numbers, including numpy's, and sequences of them that are nested at most `depth`
/// times, to JSON. Any other value gives `None`.
pub fn json(value: &Bound<PyAny>, depth: usize) -> Option<Value> {
    if value.is_none() {
        Some(Value::Null)
    } else if let Ok(text) = value.cast::<PyString>() {
        Some(text.to_cow().ok()?.into())
    } else if let Ok(flag) = value.extract::<bool>() {
        Some(flag.into())
    } else if let Ok(integer) = value.extract::<u64>() {
        Some(integer.into())
    } else if let Ok(integer) = value.extract::<i64>() {
        Some(integer.into())
    } else if let Ok(number) = value.extract() {
        Number::from_f64(number).map(Value::Number)
    } else if depth > 0 && value.len().ok()? <= MAX_ITEMS {
        value.try_iter().ok()?.map(|item| json(&item.ok()?, depth - 1)).collect()
    } else {
        None
    }
}

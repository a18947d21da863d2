//! Parts of results: classes whose attributes are their content, printed and pickled.

use pyo3::prelude::*;
use pyo3::types::PyTuple;

/// Defines a class with these attributes, which are also the arguments of a new object.
macro_rules! part {
    ($(#[$attribute:meta])* $name:ident { $($(#[$doc:meta])* $field:ident: $kind:ty,)* }) => {
        $(#[$attribute])*
        #[pyclass(frozen, get_all, module = "snake_rs")]
        pub struct $name { $($(#[$doc])* pub $field: $kind,)* }

        #[pymethods]
        impl $name {
            #[new]
            #[allow(clippy::too_many_arguments, reason = "the state of a pickle")]
            fn new($($field: $kind),*) -> Self {
                Self { $($field),* }
            }

            fn __getnewargs__<'py>(this: &Bound<'py, Self>) -> PyResult<Bound<'py, pyo3::types::PyTuple>> {
                $crate::part::attributes(this, [$(stringify!($field)),*])
            }

            fn __repr__(this: &Bound<'_, Self>) -> PyResult<String> {
                $crate::part::printed(this, stringify!($name), [$(stringify!($field)),*])
            }
        }
    };
}
pub(crate) use part;

/// The attributes of an object by name: the content of a pickle.
pub fn attributes<'py, const N: usize>(object: &Bound<'py, PyAny>, names: [&str; N]) -> PyResult<Bound<'py, PyTuple>> {
    let values = names.iter().map(|name| object.getattr(*name)).collect::<PyResult<Vec<_>>>()?;
    PyTuple::new(object.py(), values)
}

/// A class with its attributes, arrays by their shape.
pub fn printed<const N: usize>(object: &Bound<'_, PyAny>, class: &str, names: [&str; N]) -> PyResult<String> {
    let printed = |name: &&str| -> PyResult<String> {
        let value = object.getattr(*name)?;
        Ok(match value.getattr_opt("shape")? {
            Some(shape) => format!("{name}=array of shape {shape}"),
            None => format!("{name}={}", value.repr()?),
        })
    };
    Ok(format!("{class}({})", names.iter().map(printed).collect::<PyResult<Vec<_>>>()?.join(", ")))
}

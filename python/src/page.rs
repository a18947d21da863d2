//! The page of `snake_rs.view`.

use std::path::PathBuf;

use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use snake_core::Length;
use snake_view::{Page, ShownCloud, ShownPair, viridis};

use crate::error::py_error;
use crate::{arrays, model, options, threads, warn};

/// A length in Python: a number of cloud units, or text such as "6r".
#[derive(FromPyObject)]
pub enum LengthLike {
    /// In the cloud's units.
    Units(f64),
    /// Text that the core parses.
    Text(String),
}

impl LengthLike {
    fn length(self) -> PyResult<Length> {
        match self {
            Self::Units(length) => Ok(Length::Units(length)),
            Self::Text(text) => text.parse().map_err(py_error),
        }
    }
}

/// The page that shows a cloud, or two, with their keypoints, as HTML. Arguments are those of `view`.
#[pyfunction]
#[pyo3(signature = (points, second=None, model=None, name=None, epsilon=None, t_first_second=None, **options))]
#[expect(clippy::too_many_arguments, reason = "keywords in Python")]
pub fn page(
    py: Python<'_>,
    points: &Bound<'_, PyAny>,
    second: Option<&Bound<'_, PyAny>>,
    model: Option<&Bound<'_, PyAny>>,
    name: Option<&str>,
    epsilon: Option<LengthLike>,
    t_first_second: Option<&Bound<'_, PyAny>>,
    options: Option<&Bound<'_, PyDict>>,
) -> PyResult<String> {
    // `view(points, "scenes")` names a model, and `view(a, b)` a second cloud.
    let (second, model) = match second {
        Some(value) if model.is_none() && model::is_model(value) => (None, second),
        _ => (second, model),
    };
    if second.is_none() && (epsilon.is_some() || t_first_second.is_some()) {
        return Err(PyValueError::new_err("`epsilon` and `t_first_second` need two clouds"));
    }
    let epsilon = epsilon.map(LengthLike::length).transpose()?;
    let t_first_second = t_first_second.map(|value| arrays::transform("t_first_second", value)).transpose()?;
    let chooser = model::chooser(py, model, &options::values("view", &options::ALL, options)?)?;
    let named = |given: Option<&str>, what: &str, value: &Bound<'_, PyAny>, unnamed: &str| {
        let (cloud, _) = arrays::cloud(what, value)?;
        let path: Option<PathBuf> = value.extract().ok();
        let name = given.map(str::to_owned).or(path.map(|path| path.display().to_string()));
        PyResult::Ok((name.unwrap_or_else(|| unnamed.into()), cloud))
    };
    let unnamed = if second.is_some() { "first" } else { "cloud" };
    let mut clouds = vec![named(name, "points", points, unnamed)?];
    clouds.extend(second.map(|second| named(None, "second", second, "second")).transpose()?);
    let (page, notes) = threads::run_with_signals(py, |control| {
        let mut shown: Vec<ShownCloud> = Vec::new();
        // Both clouds of a pair use the model that suits the first.
        let first = chooser.for_cloud(&clouds[0].1)?;
        shown.push(ShownCloud::detect(&first, clouds[0].0.clone(), control)?);
        for (name, cloud) in &clouds[1..] {
            shown.push(ShownCloud::detect(&first.with_cloud(cloud)?, name.clone(), control)?);
        }
        let findings = shown.iter().flat_map(|cloud| cloud.field.findings());
        let notes: Vec<String> = first.note.iter().cloned().chain(findings).collect();
        let pair = match &shown[..] {
            [first, second] => Some(ShownPair::aligned([first, second], t_first_second, epsilon, control)?),
            _ => None,
        };
        Ok((Page { clouds: shown, pair, options: first.options, model_name: first.name, colors: viridis() }, notes))
    })?;
    warn(py, &notes)?;
    page.html().map_err(|error| PyValueError::new_err(error.to_string()))
}

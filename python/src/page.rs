//! The page of `snake_rs.view`.

use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use snake_view::{Page, ShownCloud, viridis};

use crate::{arrays, model, options, threads};

/// The page that shows a cloud with its keypoints, as HTML. Arguments are those of `detect`, and the name of the cloud.
#[pyfunction]
#[pyo3(signature = (points, model=None, name="cloud", **options))]
pub fn page(
    py: Python<'_>,
    points: &Bound<'_, PyAny>,
    model: Option<&Bound<'_, PyAny>>,
    name: &str,
    options: Option<&Bound<'_, PyDict>>,
) -> PyResult<String> {
    let model_name = match model {
        None => "compact".to_owned(),
        Some(model) => model.str()?.to_cow()?.into_owned(),
    };
    let model = model::given_or_builtin(py, model)?;
    let options = options::resolve("view", &options::ALL, model.recommended(), options)?;
    let (cloud, _) = arrays::cloud("points", points)?;
    let cloud = cloud.for_normalization(options.encode.normalization);
    let shown =
        threads::run_with_signals(py, |control| ShownCloud::detect(&model, &options, name.into(), &cloud, control))?;
    let page = Page { clouds: vec![shown], pair: None, options, model_name, colors: viridis() };
    page.html().map_err(|error| PyValueError::new_err(error.to_string()))
}

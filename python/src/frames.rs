//! `snake_rs.FrameDetector`.

use std::sync::{Mutex, PoisonError};

use pyo3::prelude::*;
use pyo3::types::PyDict;
use snake_core as core;

use crate::error::py_error;
use crate::keypoints::Keypoints;
use crate::model::{self, Model};
use crate::threads::{self, Watch};
use crate::{arrays, options, warn};

/// A model with its options, for clouds that come one after another, such as the sweeps of a laser scanner. The memory of one
/// cloud's volumes is used again for the next.
///
/// `model` and `options` are those of `snake_rs.detect`. Raises as `snake_rs.detect` does.
#[pyclass(frozen, module = "snake_rs")]
pub struct FrameDetector {
    model: Py<Model>,
    detector: Mutex<core::FrameDetector>,
}

#[pymethods]
impl FrameDetector {
    #[new]
    #[pyo3(signature = (model, **options))]
    fn new(py: Python<'_>, model: &Bound<'_, PyAny>, options: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        let model = model::given(py, model)?;
        let core = model.get().core();
        let options = options::resolve("FrameDetector", &options::ALL, core.recommended(), options)?;
        let detector = core::FrameDetector::new(core.clone(), options).map_err(py_error)?;
        Ok(Self { model: model.unbind(), detector: Mutex::new(detector) })
    }

    /// The keypoints of the next cloud, those of `snake_rs.detect` to the bit, with the notes on its file and those of
    /// `snake_rs.Field.detect`. `points` is one cloud of `snake_rs.detect`, as are `deadline` and `progress`.
    #[pyo3(signature = (points, *, deadline=None, progress=None))]
    fn detect(
        &self,
        py: Python<'_>,
        points: &Bound<'_, PyAny>,
        deadline: Option<f64>,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<Keypoints> {
        let watch = Watch::new(deadline, progress)?;
        let (cloud, precision, mut notes) = arrays::cloud_with_notes("points", points)?;
        let (cloud, detection, findings) = threads::run_watched(py, watch, |control| {
            let mut detector = self.detector.lock().unwrap_or_else(PoisonError::into_inner);
            let cloud = cloud.for_normalization(detector.options().encode.normalization);
            let mut detection = core::Detection::default();
            detector.detect_into_with(&cloud.points, &mut detection, control)?;
            let note = detection.note(&detector.options().detect);
            Ok((cloud, detection, detector.findings().iter().cloned().chain(note).collect::<Vec<_>>()))
        })?;
        warn(py, &findings)?;
        notes.extend(findings);
        let named = self.model.get().named();
        let source = (named.name, named.model.digest(), notes);
        Keypoints::from_detection(py, detection, cloud.origin, precision, Some(cloud), source)
    }

    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        Ok(format!("FrameDetector({})", self.model.bind(py).repr()?))
    }
}

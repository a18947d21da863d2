//! `snake_rs.Keypoints`.

use numpy::{PyArray1, PyArrayMethods};
use pyo3::exceptions::PyImportError;
use pyo3::prelude::*;
use pyo3::types::{IntoPyDict, PyDict, PyTuple};
use snake_core::{Detection, Point};

use crate::arrays::{self, Positions, Precision};

/// K keypoints, sorted by decreasing saliency, with the counts and times of their detection. It can be pickled.
#[pyclass(frozen, get_all, module = "snake_rs")]
pub struct Keypoints {
    /// Positions (K, 3), in the cloud's frame and units: float32 if the cloud was float32 or float16, else float64.
    points: Positions,
    /// Saliency (K,) float32 in [0, 1]: the score that keypoints are ranked by.
    saliency: Py<PyArray1<f32>>,
    /// Occupancy (K,) float32 at the positions.
    occupancy: Py<PyArray1<f32>>,
    /// Index (K,) int64 of the nearest input point, in the input array with its skipped points.
    nearest_index: Py<PyArray1<i64>>,
    /// Number of input points that were skipped because they are not finite.
    num_skipped: usize,
    /// Number of "windows" that were encoded, and the number of queries after each step: "queries", "occupied",
    /// "above_threshold", "keypoints".
    counts: Py<PyDict>,
    /// Seconds of each step: "encode" (0 for `Field.detect`), "occupancy", "refine", "nms".
    timing_seconds: Py<PyDict>,
}

impl Keypoints {
    /// Converts the core's result to arrays and dicts.
    pub fn from_detection(
        py: Python<'_>,
        detection: Detection,
        origin: [f64; 3],
        precision: Precision,
    ) -> PyResult<Self> {
        let Detection { keypoints, num_skipped, counts, timing, .. } = detection;
        let counts = [
            ("windows", counts.windows),
            ("queries", counts.queries),
            ("occupied", counts.occupied),
            ("above_threshold", counts.above_threshold),
            ("keypoints", counts.keypoints),
        ];
        let timing = [
            ("encode", timing.encode),
            ("occupancy", timing.occupancy),
            ("refine", timing.refine),
            ("nms", timing.nms),
        ];
        let points: Vec<Point> = keypoints.iter().map(|k| k.position).collect();
        Ok(Self {
            points: Positions::new(py, &points, origin, precision)?,
            saliency: arrays::values(py, keypoints.iter().map(|k| k.saliency).collect()).unbind(),
            occupancy: arrays::values(py, keypoints.iter().map(|k| k.occupancy).collect()).unbind(),
            nearest_index: arrays::values(py, keypoints.iter().map(|k| k.nearest_index as i64).collect()).unbind(),
            num_skipped,
            counts: counts.into_py_dict(py)?.unbind(),
            timing_seconds: timing.into_py_dict(py)?.unbind(),
        })
    }
}

#[pymethods]
impl Keypoints {
    #[new]
    fn new(
        points: Positions,
        saliency: Py<PyArray1<f32>>,
        occupancy: Py<PyArray1<f32>>,
        nearest_index: Py<PyArray1<i64>>,
        num_skipped: usize,
        counts: Py<PyDict>,
        timing_seconds: Py<PyDict>,
    ) -> Self {
        Self { points, saliency, occupancy, nearest_index, num_skipped, counts, timing_seconds }
    }

    /// The keypoints as an `open3d.geometry.PointCloud`, in the cloud's frame. Raises ImportError without Open3D.
    fn to_open3d<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let open3d = py.import("open3d").map_err(|error| {
            let missing = PyImportError::new_err("Keypoints.to_open3d needs Open3D: pip install open3d");
            missing.set_cause(py, Some(error));
            missing
        })?;
        let points = self.points.bind(py).call_method1("astype", ("float64",))?;
        let vector = open3d.getattr("utility")?.call_method1("Vector3dVector", (points,))?;
        open3d.getattr("geometry")?.call_method1("PointCloud", (vector,))
    }

    fn __getnewargs__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        let Self { points, saliency, occupancy, nearest_index, num_skipped, counts, timing_seconds } = self;
        (points, saliency, occupancy, nearest_index, num_skipped, counts, timing_seconds).into_pyobject(py)
    }

    fn __len__(&self, py: Python<'_>) -> PyResult<usize> {
        self.saliency.bind(py).len()
    }

    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        let saliency = self.saliency.bind(py).try_readonly()?;
        let range = match saliency.as_slice()? {
            [] => String::new(),
            all => format!(
                ", saliency {:.2}..{:.2}",
                all.iter().copied().fold(f32::INFINITY, f32::min),
                all.iter().copied().fold(f32::NEG_INFINITY, f32::max)
            ),
        };
        let counts = self.counts.bind(py);
        Ok(format!("Keypoints({}{range}, counts {counts})", self.__len__(py)?))
    }
}

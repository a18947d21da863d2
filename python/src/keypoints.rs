//! `snake_rs.Keypoints`.

use std::path::PathBuf;

use numpy::{PyArray1, PyArrayMethods};
use pyo3::exceptions::{PyImportError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{IntoPyDict, PyDict, PyIterator, PyList, PySlice, PyTuple};
use snake_core::{self as core, Counts, Detection, Point};
use snake_io::{KeypointSource, write_keypoints};

use crate::arrays::{self, Positions, Precision};
use crate::error::file_error;

/// One keypoint.
#[pyclass(frozen, get_all, module = "snake_rs")]
pub struct Keypoint {
    /// Position (3,), in the cloud's frame and units.
    position: Py<PyAny>,
    /// Saliency in [0, 1].
    saliency: f32,
    /// Occupancy at the position.
    occupancy: f32,
    /// Index of the nearest input point.
    nearest_index: i64,
}

#[pymethods]
impl Keypoint {
    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        let position = self.position.bind(py).call_method0("tolist")?;
        Ok(format!("Keypoint(position {position}, saliency {:.3}, occupancy {:.3})", self.saliency, self.occupancy))
    }
}

/// K keypoints, sorted by decreasing saliency, with the counts and times of their detection. It can be pickled.
///
/// It is a sequence: `keypoints[0]` is a `Keypoint`, and a slice, a mask or an array of indices gives `Keypoints` again.
/// `numpy.asarray` gives the positions (K, 3).
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
            counts: counts_dict(py, &counts)?.unbind(),
            timing_seconds: timing.into_py_dict(py)?.unbind(),
        })
    }
}

/// The counts by name.
pub fn counts_dict<'py>(py: Python<'py>, counts: &Counts) -> PyResult<Bound<'py, PyDict>> {
    let counts = [
        ("windows", counts.windows),
        ("queries", counts.queries),
        ("occupied", counts.occupied),
        ("above_threshold", counts.above_threshold),
        ("keypoints", counts.keypoints),
    ];
    counts.into_py_dict(py)
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

    /// The columns x, y, z, saliency, occupancy and nearest_index, a dict of arrays (K,): `pandas.DataFrame(k.to_dict())`.
    fn to_dict<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let columns = PyDict::new(py);
        let points = self.points.bind(py);
        for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
            columns.set_item(name, points.get_item((PySlice::full(py), axis))?)?;
        }
        columns.set_item("saliency", &self.saliency)?;
        columns.set_item("occupancy", &self.occupancy)?;
        columns.set_item("nearest_index", &self.nearest_index)?;
        Ok(columns)
    }

    /// Writes the keypoints to a file; the extension determines the format: ply, pcd, npy, csv, json or keypointnet.json.
    /// The file is written whole or not at all. Raises OSError when it cannot be written and ValueError for another extension.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        let (cloud, _) = arrays::cloud("points", &self.points.bind(py))?;
        let (saliency, occupancy) = (self.saliency.bind(py).try_readonly()?, self.occupancy.bind(py).try_readonly()?);
        let nearest_index = self.nearest_index.bind(py).try_readonly()?;
        let scores = saliency.as_slice()?.iter().zip(occupancy.as_slice()?).zip(nearest_index.as_slice()?);
        let keypoint = |(&position, ((&saliency, &occupancy), &index)): (&Point, ((&f32, &f32), &i64))| {
            core::Keypoint { position, saliency, occupancy, nearest_index: index as usize }
        };
        let keypoints: Vec<core::Keypoint> = cloud.points.iter().zip(scores).map(keypoint).collect();
        let source = KeypointSource::new(&path, cloud.origin);
        py.detach(|| write_keypoints(&path, &keypoints, &source)).map_err(file_error)
    }

    /// The positions, for `numpy.asarray`.
    #[pyo3(signature = (dtype=None, copy=None))]
    fn __array__<'py>(
        &self,
        py: Python<'py>,
        dtype: Option<Bound<'py, PyAny>>,
        copy: Option<bool>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let points = self.points.bind(py);
        let dtype = dtype.map_or_else(|| points.getattr("dtype"), Ok)?;
        let is_same = dtype.eq(points.getattr("dtype")?)?;
        match copy {
            Some(false) if !is_same => {
                Err(PyValueError::new_err(format!("the positions cannot be {dtype} without a copy")))
            }
            Some(true) => points.call_method1("astype", (dtype,)),
            _ if is_same => Ok(points),
            _ => points.call_method1("astype", (dtype,)),
        }
    }

    fn __getitem__<'py>(&self, py: Python<'py>, index: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
        let points = self.points.bind(py).get_item(index)?;
        let [saliency, occupancy] = [&self.saliency, &self.occupancy].map(|values| values.bind(py).get_item(index));
        let (saliency, occupancy, nearest) = (saliency?, occupancy?, self.nearest_index.bind(py).get_item(index)?);
        if points.getattr("ndim")?.extract::<usize>()? == 1 {
            let (saliency, occupancy, nearest_index) = (saliency.extract()?, occupancy.extract()?, nearest.extract()?);
            let keypoint = Keypoint { position: points.unbind(), saliency, occupancy, nearest_index };
            return Ok(Bound::new(py, keypoint)?.into_any());
        }
        let contiguous = |values: Bound<'py, PyAny>| values.call_method0("copy");
        let some = Self {
            points: contiguous(points)?.extract()?,
            saliency: contiguous(saliency)?.extract()?,
            occupancy: contiguous(occupancy)?.extract()?,
            nearest_index: contiguous(nearest)?.extract()?,
            num_skipped: self.num_skipped,
            counts: self.counts.clone_ref(py),
            timing_seconds: self.timing_seconds.clone_ref(py),
        };
        Ok(Bound::new(py, some)?.into_any())
    }

    fn __iter__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyIterator>> {
        let all = (0..self.__len__(py)?).map(|index| self.__getitem__(py, &index.into_pyobject(py)?.into_any()));
        PyList::new(py, all.collect::<PyResult<Vec<_>>>()?)?.try_iter()
    }

    /// A picture of the keypoints for notebooks.
    fn _repr_html_<'py>(slf: &Bound<'py, Self>) -> PyResult<Bound<'py, PyAny>> {
        slf.py().import("snake_rs._picture")?.call_method1("html", (slf,))
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

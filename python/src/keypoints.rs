//! `snake_rs.Keypoints`.

use std::path::PathBuf;
use std::sync::{Arc, OnceLock};

use numpy::{PyArray1, PyArray2, PyArray3, PyArrayMethods};
use pyo3::exceptions::{PyImportError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{IntoPyDict, PyDict, PyIterator, PyList, PySlice, PyTuple};
use snake_core::{self as core, Chosen, Cloud, Counts, Detection, Point};
use snake_io::{KeypointSource, adds_origin, origin_note, write_keypoints};
use snake_registration::{FPFH_DIMENSION, describe_keypoints};

use crate::arrays::{self, Positions, Precision};
use crate::error::py_error;
use crate::{threads, warn};

/// One keypoint. It can be pickled.
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
    /// Probability in [0, 1] that another view finds it again; None if the model's file has no map of confidences.
    confidence: Option<f32>,
    /// Covariance (3, 3) of the position, see `Keypoints.covariance`.
    covariance: Py<PyAny>,
}

#[pymethods]
impl Keypoint {
    #[new]
    fn new(
        position: Py<PyAny>,
        saliency: f32,
        occupancy: f32,
        nearest_index: i64,
        confidence: Option<f32>,
        covariance: Py<PyAny>,
    ) -> Self {
        Self { position, saliency, occupancy, nearest_index, confidence, covariance }
    }

    /// The content of a pickle: the arguments of a new keypoint.
    fn __getnewargs__(&self, py: Python<'_>) -> (Py<PyAny>, f32, f32, i64, Option<f32>, Py<PyAny>) {
        let Self { position, saliency, occupancy, nearest_index, confidence, covariance } = self;
        (position.clone_ref(py), *saliency, *occupancy, *nearest_index, *confidence, covariance.clone_ref(py))
    }

    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        let position = self.position.bind(py).call_method0("tolist")?;
        Ok(format!("Keypoint(position {position}, saliency {:.3}, occupancy {:.3})", self.saliency, self.occupancy))
    }
}

/// K keypoints, best first, with the counts and times of their detection. It can be pickled.
///
/// It is a sequence: `keypoints[0]` is a `Keypoint`, and a slice, a mask or an array of indices gives `Keypoints` again.
/// `numpy.asarray` gives the positions (K, 3).
#[pyclass(frozen, module = "snake_rs")]
pub struct Keypoints {
    /// Positions (K, 3), in the cloud's frame and units: float32 if the cloud was float32 or float16, else float64.
    #[pyo3(get)]
    points: Positions,
    /// Saliency (K,) float32 in [0, 1]. Keypoints are ranked by it, in scenes also by how well the points determine their place.
    #[pyo3(get)]
    saliency: Py<PyArray1<f32>>,
    /// Occupancy (K,) float32 at the positions.
    #[pyo3(get)]
    occupancy: Py<PyArray1<f32>>,
    /// Index (K,) int64 of the nearest input point, in the input array with its skipped points.
    #[pyo3(get)]
    nearest_index: Py<PyArray1<i64>>,
    /// Confidence (K,) float32: the probability that another view of the same surface finds a keypoint again, within 4 % of the
    /// radius of an object, two voxels of a scene; not a number if the model's file has no map of confidences.
    #[pyo3(get)]
    confidence: Py<PyArray1<f32>>,
    /// Covariance (K, 3, 3) float32 of the positions in squared units of the cloud, by the tangent planes of the points around
    /// each. It is infinite along directions that they leave open: one at an edge, two on a plane, all without a surface.
    #[pyo3(get)]
    covariance: Py<PyArray3<f32>>,
    /// Number of input points that were skipped because they are not finite, missing returns or outliers.
    #[pyo3(get)]
    num_skipped: usize,
    /// The number of queries after each step: "queries", "occupied", "above_threshold", "keypoints".
    #[pyo3(get)]
    counts: Py<PyDict>,
    /// Seconds of each step: "encode" (0 for `Field.detect`), "occupancy", "refine", "nms".
    #[pyo3(get)]
    timing_seconds: Py<PyDict>,
    /// The name of the model that found them; None for keypoints from a file.
    #[pyo3(get)]
    model: Option<String>,
    /// The size of a voxel of its volume, in cloud units; None for keypoints from a file.
    #[pyo3(get)]
    voxel_size: Option<f64>,
    /// Notes on them, a list of sentences: on the choice of the model, and on outliers and other faults of the cloud.
    #[pyo3(get)]
    notes: Vec<String>,
    /// The digest of the model's weights.
    weights: Option<String>,
    /// The cloud, for descriptors. Keypoints that were pickled or loaded have none.
    cloud: Option<Arc<Cloud>>,
    descriptors: OnceLock<Py<PyArray2<f32>>>,
}

impl Keypoints {
    /// The keypoints of a cloud, detected by the model that was chosen for it. `notes` are about this choice.
    pub fn chosen(
        py: Python<'_>,
        detection: Detection,
        mut notes: Vec<String>,
        chosen: &Chosen,
        cloud: &Cloud,
        precision: Precision,
    ) -> PyResult<Self> {
        let note = detection.note(&chosen.options.detect);
        warn(py, &note)?;
        notes.extend(note);
        let cloud = cloud.clone().for_normalization(chosen.options.encode.normalization);
        let source = (chosen.name.clone(), chosen.model.digest(), notes);
        Self::from_detection(py, detection, chosen.origin, precision, Some(cloud), source)
    }

    /// The name and the digest of the model that found them; `None` if it is not known.
    pub fn model(&self) -> Option<(&str, &str)> {
        self.model.as_deref().zip(self.weights.as_deref())
    }

    /// Converts the core's result to arrays and dicts.
    pub fn from_detection(
        py: Python<'_>,
        detection: Detection,
        origin: [f64; 3],
        precision: Precision,
        cloud: Option<Cloud>,
        (model, weights, notes): (String, &str, Vec<String>),
    ) -> PyResult<Self> {
        let Detection { keypoints, num_skipped, counts, timing, voxel_size, .. } = detection;
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
            confidence: arrays::values(py, keypoints.iter().map(|k| k.confidence.unwrap_or(f32::NAN)).collect())
                .unbind(),
            covariance: {
                let entries = keypoints.iter().flat_map(|k| k.covariance.rows()).flatten().collect();
                arrays::values(py, entries).reshape([keypoints.len(), 3, 3])?.unbind()
            },
            num_skipped,
            counts: counts_dict(py, &counts)?.unbind(),
            timing_seconds: timing.into_py_dict(py)?.unbind(),
            model: Some(model),
            weights: Some(weights.into()),
            // 0.1 instead of its nearest float32.
            voxel_size: voxel_size.and_then(|size| size.to_string().parse().ok()),
            notes,
            cloud: cloud.map(Arc::new),
            descriptors: OnceLock::new(),
        })
    }
}

/// The counts by name.
pub fn counts_dict<'py>(py: Python<'py>, counts: &Counts) -> PyResult<Bound<'py, PyDict>> {
    let counts = [
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
    #[pyo3(signature = (points, saliency, occupancy, nearest_index, confidence, covariance, num_skipped, counts, timing_seconds, descriptors=None, model=None, voxel_size=None, notes=vec![], weights=None))]
    #[expect(clippy::too_many_arguments, reason = "the state of a pickle")]
    fn new(
        points: Positions,
        saliency: Py<PyArray1<f32>>,
        occupancy: Py<PyArray1<f32>>,
        nearest_index: Py<PyArray1<i64>>,
        confidence: Py<PyArray1<f32>>,
        covariance: Py<PyArray3<f32>>,
        num_skipped: usize,
        counts: Py<PyDict>,
        timing_seconds: Py<PyDict>,
        descriptors: Option<Py<PyArray2<f32>>>,
        model: Option<String>,
        voxel_size: Option<f64>,
        notes: Vec<String>,
        weights: Option<String>,
    ) -> Self {
        let descriptors = descriptors.map_or_else(OnceLock::new, OnceLock::from);
        let cloud = None;
        Self {
            points,
            saliency,
            occupancy,
            nearest_index,
            confidence,
            covariance,
            num_skipped,
            counts,
            timing_seconds,
            model,
            voxel_size,
            notes,
            weights,
            cloud,
            descriptors,
        }
    }

    /// Descriptors (K, 33) float32 of the cloud around each keypoint: the square roots of FPFH histograms, which do not depend
    /// on how the cloud is turned. `match` compares those of two clouds of about the same size. They are computed when they are
    /// first asked for, from a copy of the cloud. Raises ValueError for keypoints from tiles, or that were pickled
    /// before their descriptors were asked for: their cloud is not known.
    #[getter]
    pub fn descriptors(&self, py: Python<'_>) -> PyResult<Py<PyArray2<f32>>> {
        if let Some(made) = self.descriptors.get() {
            return Ok(made.clone_ref(py));
        }
        let Some(cloud) = &self.cloud else {
            let reason = "descriptors: the cloud of these keypoints is not known, because they come from tiles or from a \
                          pickle; detect them again";
            return Err(PyValueError::new_err(reason));
        };
        let points = arrays::given_rows("points", &self.points.bind(py))?.relative_to(cloud.origin)?;
        let flat = threads::run_with_signals(py, |control| describe_keypoints(&cloud.points, &points, control))?;
        let made = arrays::rows(py, flat, FPFH_DIMENSION)?.unbind();
        Ok(self.descriptors.get_or_init(|| made).clone_ref(py))
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

    /// The columns x, y, z, saliency, occupancy, nearest_index and confidence, a dict of arrays (K,): `pandas.DataFrame(k.to_dict())`.
    fn to_dict<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let columns = PyDict::new(py);
        let points = self.points.bind(py);
        for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
            columns.set_item(name, points.get_item((PySlice::full(py), axis))?)?;
        }
        columns.set_item("saliency", &self.saliency)?;
        columns.set_item("occupancy", &self.occupancy)?;
        columns.set_item("nearest_index", &self.nearest_index)?;
        columns.set_item("confidence", &self.confidence)?;
        Ok(columns)
    }

    /// Writes the keypoints to a file; the extension determines the format: ply, pcd, npy, csv, json, keypointnet.json or laz.
    /// The file is written whole or not at all. Coordinates far from zero in a pcd file are relative to an origin that a UserWarning
    /// names, because other readers take only seven digits. Raises OSError when it cannot be written and ValueError for another extension.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        let (cloud, _) = arrays::cloud("points", &self.points.bind(py))?;
        let (saliency, occupancy) = (self.saliency.bind(py).try_readonly()?, self.occupancy.bind(py).try_readonly()?);
        let nearest_index = self.nearest_index.bind(py).try_readonly()?;
        let confidence = self.confidence.bind(py).try_readonly()?;
        let scores = saliency.as_slice()?.iter().zip(occupancy.as_slice()?).zip(confidence.as_slice()?);
        let scores = scores.zip(nearest_index.as_slice()?);
        let covariance = self.covariance.bind(py).try_readonly()?;
        let covariances = covariance.as_slice()?.as_chunks::<3>().0.as_chunks::<3>().0.iter();
        let rows = cloud.points.iter().zip(scores).zip(covariances);
        let keypoints =
            rows.map(|((&position, (((&saliency, &occupancy), &confidence), &index)), &rows)| core::Keypoint {
                position,
                saliency,
                occupancy,
                nearest_index: index as usize,
                confidence: (!confidence.is_nan()).then_some(confidence),
                covariance: rows.into(),
            });
        let keypoints: Vec<core::Keypoint> = keypoints.collect();
        let source = KeypointSource::new(&path, cloud.origin);
        py.detach(|| write_keypoints(&path, &keypoints, &source)).map_err(py_error)?;
        warn(py, origin_note(adds_origin(&path), cloud.origin))
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

    /// The positions, for `torch.as_tensor` and other users of DLPack.
    #[pyo3(signature = (**options))]
    fn __dlpack__<'py>(&self, py: Python<'py>, options: Option<&Bound<'py, PyDict>>) -> PyResult<Bound<'py, PyAny>> {
        self.points.bind(py).call_method("__dlpack__", (), options)
    }

    fn __dlpack_device__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.points.bind(py).call_method0("__dlpack_device__")
    }

    fn __getitem__<'py>(&self, py: Python<'py>, index: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
        let points = self.points.bind(py).get_item(index)?;
        let [saliency, occupancy, confidence] =
            [&self.saliency, &self.occupancy, &self.confidence].map(|values| values.bind(py).get_item(index));
        let (saliency, occupancy, confidence) = (saliency?, occupancy?, confidence?);
        let nearest = self.nearest_index.bind(py).get_item(index)?;
        let covariance = self.covariance.bind(py).get_item(index)?;
        if points.getattr("ndim")?.extract::<usize>()? == 1 {
            let (saliency, occupancy, nearest_index) = (saliency.extract()?, occupancy.extract()?, nearest.extract()?);
            let confidence = Some(confidence.extract::<f32>()?).filter(|probability| !probability.is_nan());
            let (position, covariance) = (points.unbind(), covariance.unbind());
            let keypoint = Keypoint { position, saliency, occupancy, nearest_index, confidence, covariance };
            return Ok(Bound::new(py, keypoint)?.into_any());
        }
        let contiguous = |values: Bound<'py, PyAny>| values.call_method0("copy");
        let some = Self {
            points: contiguous(points)?.extract()?,
            saliency: contiguous(saliency)?.extract()?,
            occupancy: contiguous(occupancy)?.extract()?,
            nearest_index: contiguous(nearest)?.extract()?,
            confidence: contiguous(confidence)?.extract()?,
            covariance: contiguous(covariance)?.extract()?,
            num_skipped: self.num_skipped,
            counts: self.counts.clone_ref(py),
            timing_seconds: self.timing_seconds.clone_ref(py),
            model: self.model.clone(),
            voxel_size: self.voxel_size,
            notes: self.notes.clone(),
            weights: self.weights.clone(),
            cloud: self.cloud.clone(),
            descriptors: match self.descriptors.get() {
                Some(all) => OnceLock::from(contiguous(all.bind(py).get_item(index)?)?.extract::<Py<PyArray2<f32>>>()?),
                None => OnceLock::new(),
            },
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
        let Self { points, saliency, occupancy, nearest_index, confidence, covariance, num_skipped, counts, .. } = self;
        let arrays = (points, saliency, occupancy, nearest_index, confidence, covariance).into_pyobject(py)?;
        let Self { timing_seconds, model, voxel_size, notes, weights, .. } = self;
        let descriptors = self.descriptors.get();
        let others =
            (num_skipped, counts, timing_seconds, descriptors, model, voxel_size, notes, weights).into_pyobject(py)?;
        arrays.as_sequence().concat(others.as_sequence())?.to_tuple()
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

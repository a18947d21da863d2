//! `snake_rs.Field`.

use numpy::{PyArray, PyArray1, PyArray2, PyArray4};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};
use snake_core::{self as core, Point};

use crate::arrays::{Positions, Precision};
use crate::keypoints::Keypoints;
use crate::mesh::Mesh;
use crate::{arrays, options, threads, warn};

/// Number of queries between two checks for signals: some hundredths of a second.
const QUERIES_PER_PART: usize = 1 << 14;

/// Values and gradients of Q queries.
type Pairs = (Vec<f32>, Vec<Point>);
/// Values and gradients as arrays `(Q,)` and `(Q, 3)`.
type ValuesAndGradients<'py> = (Bound<'py, PyArray1<f32>>, Bound<'py, PyArray2<f32>>);

/// Occupancy and saliency of one cloud at any point in space; made by `Model.encode`.
///
/// Queries are (Q, 3), in the same forms as the points of `detect`. Queries and gradients are in the cloud's frame and
/// units. Use float64 for queries far from zero, so that no digits are lost. A pickled field holds the cloud and the model,
/// and encodes the cloud again when it is loaded; its values keep their bits.
#[pyclass(frozen, module = "snake_rs")]
pub struct Field {
    core: core::Field,
    /// The model and the options that encoded the cloud: a field is restored by encoding it again.
    model: Py<PyAny>,
    /// The model with its name in results.
    named: core::NamedModel,
    options: core::EncodeOptions,
    /// Offset to add to all positions of the core's field.
    origin: [f64; 3],
    /// The type of the encoded cloud.
    precision: Precision,
}

impl Field {
    /// Encodes a cloud whose array had the given precision. `model` is the Python object of the named model.
    pub fn new(
        model: &Bound<PyAny>,
        named: core::NamedModel,
        cloud: &core::Cloud,
        options: core::EncodeOptions,
        precision: Precision,
    ) -> PyResult<Self> {
        let encode = |control: &core::Control| named.model.encode_with(&cloud.points, &options, control);
        let core = threads::run_with_signals(model.py(), encode)?;
        Ok(Self { core, model: model.clone().unbind(), named, options, origin: cloud.origin, precision })
    }

    /// The given cloud, with NaN for points that were skipped.
    fn given_points(&self) -> Vec<Point> {
        let mut given = vec![[f32::NAN; 3]; self.core.points().len() + self.core.num_skipped()];
        for (index, point) in self.core.points().iter().enumerate() {
            given[self.core.original_index(index)] = *point;
        }
        given
    }

    fn queries(&self, queries: &Bound<PyAny>) -> PyResult<Vec<Point>> {
        arrays::given_rows("queries", queries)?.relative_to(self.origin)
    }

    /// The answers to all queries, computed part by part without the GIL. A signal ends the call after a part.
    fn answers<T: Send>(
        &self,
        queries: &Bound<PyAny>,
        answer: fn(&core::Field, &[Point]) -> core::Result<T>,
    ) -> PyResult<Vec<T>> {
        let (py, queries) = (queries.py(), self.queries(queries)?);
        threads::run_with_signals(py, |control| {
            let parts = queries.chunks(QUERIES_PER_PART);
            parts.map(|part| control.check().and_then(|()| answer(&self.core, part))).collect()
        })
    }

    fn values<'py>(
        &self,
        queries: &Bound<'py, PyAny>,
        of: fn(&core::Field, &[Point]) -> core::Result<Vec<f32>>,
    ) -> PyResult<Bound<'py, PyArray1<f32>>> {
        Ok(arrays::values(queries.py(), self.answers(queries, of)?.concat()))
    }

    fn values_and_gradients<'py>(
        &self,
        queries: &Bound<'py, PyAny>,
        of: fn(&core::Field, &[Point]) -> core::Result<Pairs>,
    ) -> PyResult<ValuesAndGradients<'py>> {
        let (values, gradients): (Vec<_>, Vec<_>) = self.answers(queries, of)?.into_iter().unzip();
        let (py, gradients) = (queries.py(), gradients.concat());
        Ok((arrays::values(py, values.concat()), arrays::rows(py, gradients.into_flattened(), 3)?))
    }
}

#[pymethods]
impl Field {
    /// The parts of the cloud that were left out, a list of sentences.
    #[getter]
    pub fn notes(&self) -> Vec<String> {
        self.core.findings()
    }

    /// Occupancy of each query, the probability that it lies on the surface: (Q,) float32.
    fn occupancy<'py>(&self, queries: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyArray1<f32>>> {
        self.values(queries, core::Field::occupancy)
    }

    /// Saliency of each query, in [0, 1): (Q,) float32.
    fn saliency<'py>(&self, queries: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyArray1<f32>>> {
        self.values(queries, core::Field::saliency)
    }

    /// Occupancy (Q,) and its gradient (Q, 3) per cloud unit.
    fn occupancy_and_gradient<'py>(&self, queries: &Bound<'py, PyAny>) -> PyResult<ValuesAndGradients<'py>> {
        self.values_and_gradients(queries, core::Field::occupancy_and_gradient)
    }

    /// Saliency (Q,) and its gradient (Q, 3) per cloud unit.
    fn saliency_and_gradient<'py>(&self, queries: &Bound<'py, PyAny>) -> PyResult<ValuesAndGradients<'py>> {
        self.values_and_gradients(queries, core::Field::saliency_and_gradient)
    }

    /// Descriptors (Q, c_dim) float32: the L2-normalised feature of each query.
    fn descriptors<'py>(&self, queries: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let flat = self.answers(queries, core::Field::descriptors)?.concat();
        arrays::rows(queries.py(), flat, self.core.config().c_dim)
    }

    /// A copy of the feature volume, (C, D, H, W) float32, with D, H and W along z, y and x.
    #[getter]
    fn volume<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray4<f32>>> {
        Ok(PyArray::from_array(py, &self.core.volume().view().permuted_axes([3, 0, 1, 2])))
    }

    /// Center (3,), in the type of the cloud's points, and scale, in cloud units: `network = (cloud - center) / scale`.
    #[getter]
    fn normalization<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, f32)> {
        let core::Normalization { center, scale } = self.core.normalization();
        let center = Positions::new(py, &[center], self.origin, self.precision)?.bind(py).get_item(0)?;
        Ok((center, scale))
    }

    /// Rotation (3, 3) of the volume: `volume = R @ network`. It is the identity, save with the normalization
    /// "principal-axes".
    #[getter]
    fn orientation<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        Ok(PyArray2::from_vec2(py, &self.core.orientation().map(Vec::from))?)
    }

    /// Keypoints of the encoded cloud.
    ///
    /// Raises ValueError for an invalid value and TypeError for an unknown option. Options default to the values of `preset`,
    /// or else of the model's `recommended`. Those of "compact" are:
    ///
    #[doc = include_str!("help/detect.txt")]
    #[doc = include_str!("help/preset.txt")]
    #[pyo3(signature = (**options))]
    fn detect(&self, py: Python<'_>, options: Option<&Bound<PyDict>>) -> PyResult<Keypoints> {
        let preset = options::resolve("detect", &options::DETECT, self.core.recommended(), options)?;
        let detection = threads::run_with_signals(py, |control| self.core.detect_with(&preset.detect, control))?;
        let cloud = core::Cloud { points: self.core.points().to_vec(), origin: self.origin };
        let note = detection.note(&preset.detect);
        warn(py, &note)?;
        let notes = self.notes().into_iter().chain(note).collect();
        let source = (self.named.name.clone(), self.named.model.digest(), notes);
        Keypoints::from_detection(py, detection, self.origin, self.precision, Some(cloud), source)
    }

    /// The surface of the cloud: a closed mesh in the cloud's frame and units, by marching cubes of the occupancy at `level`, whose
    /// vertices then move to the middle of the shell.
    ///
    /// A thin wall has a mesh on both sides, and in the middle both lie on it. Raises ValueError for an invalid value and TypeError for an unknown option.
    /// The options are:
    ///
    #[doc = include_str!("help/mesh.txt")]
    #[pyo3(signature = (**options))]
    fn mesh(&self, py: Python<'_>, options: Option<&Bound<PyDict>>) -> PyResult<Mesh> {
        let options: core::MeshOptions = options::of("mesh", options)?;
        let mesh = threads::run_with_signals(py, |control| self.core.mesh_with(&options, control))?;
        warn(py, mesh.notes())?;
        Mesh::from_core(py, mesh, self.origin, self.precision)
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyTuple>)> {
        let (py, field) = (slf.py(), slf.get());
        let points = arrays::rows(py, field.given_points().into_flattened(), 3)?;
        let is_single = field.precision == Precision::Single;
        let options =
            serde_json::to_string(&field.options).map_err(|error| PyValueError::new_err(error.to_string()))?;
        let arguments = (points, field.origin, is_single, options).into_pyobject(py)?;
        Ok((field.model.bind(py).getattr("_restore_field")?, arguments))
    }

    fn __repr__(&self) -> String {
        let core::Normalization { center, scale } = self.core.normalization();
        let center = if self.origin == [0.0; 3] {
            format!("{center:?}")
        } else {
            format!("{:?}", core::add_origin(center, self.origin))
        };
        let (encoded, points) = (self.core.num_encoded(), self.core.points().len());
        format!("Field({encoded} of {points} points encoded, center {center}, scale {scale})")
    }
}

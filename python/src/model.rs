//! `snake_rs.Model`.

use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{IntoPyDict, PyBytes, PyDict, PyTuple};
use serde_json::{Map, Value};
use snake_core as core;
use snake_registration::RegisterOptions;

use crate::arrays::Precision;
use crate::error::{py_error, value_error};
use crate::field::Field;
use crate::{arrays, options, threads, warn};

/// A network with its weights, made by `Model.builtin`, `Model.load` or `Model.from_bytes`. It can be pickled.
#[pyclass(frozen, module = "snake_rs")]
pub struct Model {
    core: core::Model,
    origin: Origin,
}

/// The source from which a model is restored when it is unpickled.
enum Origin {
    Builtin(String),
    /// The content of a file, and its name if it is known.
    File(Arc<Vec<u8>>, Option<String>),
}

impl Model {
    /// The core's model.
    pub fn core(&self) -> &core::Model {
        &self.core
    }

    /// The model with its name in results.
    pub fn named(&self) -> core::NamedModel {
        let name = match &self.origin {
            Origin::Builtin(name) => format!("{name}, built-in"),
            Origin::File(_, name) => name.clone().unwrap_or_else(|| "without a name".into()),
        };
        core::NamedModel::new(self.core.clone(), name)
    }

    fn from_file(py: Python<'_>, file: Vec<u8>, name: Option<String>) -> PyResult<Self> {
        let core = threads::run(py, || core::Model::from_bytes(&file))?;
        Ok(Self { core, origin: Origin::File(Arc::new(file), name) })
    }
}

/// The chooser for calls without a model, which loads each built-in model once.
fn automatic() -> &'static core::Chooser {
    static CHOOSER: OnceLock<core::Chooser> = OnceLock::new();
    CHOOSER.get_or_init(core::Chooser::default)
}

/// The chooser of model and options for each cloud of a call, with the given values of options.
pub fn chooser(
    py: Python<'_>,
    model: Option<&Bound<'_, PyAny>>,
    values: &Map<String, Value>,
) -> PyResult<core::Chooser> {
    let chooser = match model {
        Some(model) => given(py, model)?.get().named().into(),
        None => automatic().clone(),
    };
    chooser.with_values(values).map_err(py_error)
}

/// The model for a registration to a cloud: the given one, or if the options run a model the one that suits the cloud.
pub fn for_registration(
    py: Python<'_>,
    model: Option<&Bound<'_, PyAny>>,
    options: &RegisterOptions,
    cloud: Option<&core::Cloud>,
) -> PyResult<Option<core::Model>> {
    let is_used = model.is_some() || options.needs_model();
    let (true, Some(cloud)) = (is_used, cloud) else { return Ok(None) };
    let chooser = chooser(py, model, &Map::new())?;
    threads::run(py, || Ok(Some(chooser.for_cloud(cloud)?.model)))
}

/// Whether a value is a model and not a cloud: a `Model`, the name of a model, or the path of a weight file.
pub fn is_model(value: &Bound<PyAny>) -> bool {
    value.is_instance_of::<Model>()
        || value.extract::<PathBuf>().is_ok_and(|path| {
            let is_name = path.to_str().is_some_and(|name| core::Model::NAMES.contains(&name));
            is_name || is_weight_file(&path)
        })
}

fn is_weight_file(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension == "safetensors")
}

/// The given model: a `Model`, the name of a built-in model, or the path of a weight file.
pub fn given<'py>(py: Python<'py>, model: &Bound<'py, PyAny>) -> PyResult<Bound<'py, Model>> {
    if let Ok(model) = model.cast::<Model>() {
        return Ok(model.clone());
    }
    let path: PathBuf = model.extract().map_err(|_| {
        PyTypeError::new_err(format!("model: expected a Model, a name or a path, found {}", model.get_type()))
    })?;
    let model = match path.to_str().filter(|name| core::Model::NAMES.contains(name)) {
        Some(name) => Model::py_builtin(py, name)?,
        None if path.extension().is_none() && !path.exists() => {
            let names = core::Model::NAMES.join(", ");
            let reason = format!("model: no built-in model {}; known are {names}", path.display());
            return Err(value_error(&reason));
        }
        None if !is_weight_file(&path) => {
            let reason =
                format!("model: {} is neither a built-in model nor a weight file (.safetensors)", path.display());
            return Err(value_error(&reason));
        }
        None => Model::load(py, path)?,
    };
    Bound::new(py, model)
}

#[pymethods]
impl Model {
    /// A model that comes with the package. "compact" is for objects. "standard" is also for objects; it is slower, and
    /// its keypoints repeat better. "scenes" is for rooms, sweeps and streets of any unit. Raises ValueError
    /// for any other name.
    #[staticmethod]
    #[pyo3(name = "builtin", signature = (name="compact"))]
    pub fn py_builtin(py: Python<'_>, name: &str) -> PyResult<Self> {
        let core = match core::Builtin::ALL.into_iter().find(|which| which.name() == name) {
            Some(which) => threads::run(py, || Ok(automatic().builtin(which).clone()))?,
            None => threads::run(py, || core::Model::named(name))?,
        };
        Ok(Self { core, origin: Origin::Builtin(name.into()) })
    }

    /// Reads a weight file (`*.safetensors`, written by `snake_training.export`).
    ///
    /// Raises OSError (FileNotFoundError, ...) when the file cannot be read, ValueError when it does not hold a
    /// network.
    #[staticmethod]
    fn load(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        let bytes = py.detach(|| core::read_weight_file(&path)).map_err(py_error)?;
        let name = path.file_name().map(|name| name.to_string_lossy().into_owned());
        Self::from_file(py, bytes, name)
    }

    /// A model from the bytes of a weight file; `name` is what its text shows. Raises ValueError when they do not hold a
    /// network.
    #[staticmethod]
    #[pyo3(signature = (data, name=None))]
    fn from_bytes(py: Python<'_>, data: &[u8], name: Option<String>) -> PyResult<Self> {
        Self::from_file(py, data.to_vec(), name)
    }

    /// The shape of the network, a dict with the names of `snake_training.model.NetworkConfig`.
    #[getter]
    fn config<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let config = self.core.config();
        let dict = [
            ("c_dim", config.c_dim),
            ("hidden_dim", config.hidden_dim),
            ("decoder_hidden_dim", config.decoder_hidden_dim),
            ("resnet_blocks", config.resnet_blocks),
            ("unet_levels", config.unet_levels),
            ("unet_base_channels", config.unet_base_channels),
            ("group_norm_groups", config.group_norm_groups),
        ]
        .into_py_dict(py)?;
        if let Some(frame) = config.frame() {
            let [x, y, z] = frame.resolution;
            dict.set_item("resolution", (x, y, z))?;
            dict.set_item("padding", frame.padding)?;
            dict.set_item("z_min", frame.z_bounds[0])?;
            dict.set_item("z_max", frame.z_bounds[1])?;
        }
        dict.set_item("scatter", config.scatter.name())?;
        Ok(dict)
    }

    /// All metadata of the weight file, a dict of strings.
    #[getter]
    fn metadata<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        self.core.metadata().into_py_dict(py)
    }

    /// Number of weights.
    #[getter]
    fn num_parameters(&self) -> usize {
        self.core.num_parameters()
    }

    /// The recommended options of these weights, as keyword arguments of `detect`. They are its defaults.
    #[getter]
    fn recommended<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        options::flat(py, self.core.recommended())
    }

    /// Encodes a cloud once; the field can then be queried any number of times.
    ///
    /// `points` is (N, 3), in the same forms as in `detect`; points that are not finite, missing returns and outliers are skipped. Raises
    /// ValueError for an invalid array or value, and TypeError for an unknown option. Options default to the values of
    /// `preset`, or else of `model.recommended`. Those of "compact" are:
    ///
    #[doc = include_str!("help/encode.txt")]
    #[doc = include_str!("help/preset.txt")]
    #[pyo3(signature = (points, **options))]
    fn encode(slf: &Bound<Self>, points: &Bound<PyAny>, options: Option<&Bound<PyDict>>) -> PyResult<Field> {
        let named = slf.get().named();
        let preset = options::resolve("encode", &options::ENCODE, named.model.recommended(), options)?;
        let (cloud, precision) = arrays::cloud("points", points)?;
        let cloud = cloud.for_normalization(preset.encode.normalization);
        let field = Field::new(slf, named, &cloud, preset.encode, precision)?;
        warn(slf.py(), field.notes())?;
        Ok(field)
    }

    /// Restores a pickled field: encodes its points again, which are relative to the origin.
    fn _restore_field(
        slf: &Bound<Self>,
        points: &Bound<PyAny>,
        origin: [f64; 3],
        is_single: bool,
        options: &str,
    ) -> PyResult<Field> {
        let options = serde_json::from_str(options).map_err(|error| PyValueError::new_err(error.to_string()))?;
        let precision = if is_single { Precision::Single } else { Precision::Double };
        let cloud = core::Cloud { points: arrays::points("points", points)?, origin };
        Field::new(slf, slf.get().named(), &cloud, options, precision)
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyTuple>)> {
        let (py, class) = (slf.py(), slf.get_type());
        match &slf.get().origin {
            Origin::File(file, name) => {
                Ok((class.getattr("from_bytes")?, (PyBytes::new(py, file), name).into_pyobject(py)?))
            }
            Origin::Builtin(name) => Ok((class.getattr("builtin")?, PyTuple::new(py, [name])?)),
        }
    }

    fn __repr__(&self) -> String {
        let config = self.core.config();
        let name = match &self.origin {
            Origin::Builtin(name) | Origin::File(_, Some(name)) => name,
            Origin::File(_, None) => "without a name",
        };
        format!(
            "Model({name}, {} parameters, volume {} of {} channels)",
            self.core.num_parameters(),
            config.volume,
            config.c_dim
        )
    }
}

//! The private module `snake_rs._core`: snake-core for Python. A thin shell that checks and copies arrays, releases the
//! GIL and calls the core; it computes nothing.

mod alignment;
mod arrays;
mod baselines;
mod command;
mod error;
mod field;
mod files;
mod frames;
mod io;
mod keypoints;
mod mesh;
mod model;
mod options;
mod page;
mod recording;
mod records;
mod registration;
mod remote;
mod steps;
mod threads;
mod tiled;

use numpy::{PyArray2, PyArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use snake_core::{Chooser, Chosen, Cloud, Error, parallel_map};
use snake_registration::{FPFH_DIMENSION, mutual_nearest};

use alignment::align;
use arrays::Precision;
use field::Field;
use frames::FrameDetector;
use io::read_points;
use keypoints::{Keypoint, Keypoints};
use mesh::Mesh;
use model::Model;
use recording::{RecordedCloud, Recording, read_recording};
use registration::{PreparedMap, estimate_normals, fpfh, register};
use threads::{Watch, get_num_threads, set_num_threads};
use tiled::{DetectedTiles, Tiles, tiles};

/// Detects the keypoints of a cloud in one call: `model.encode(points).detect()`. `model` is a `Model`, the name of a
/// built-in model ("compact", "standard" or "scenes") or the path of a weight file. Without one, options that only one kind of
/// model has name it: `voxel_size` "scenes", and `preset`, `normalization` and several `rotations` "compact". Else it is
/// "scenes" for a cloud that looks like a room, a sweep or terrain, and "compact" for others. `Keypoints.model` says which.
///
/// `points` (N, 3) are real numbers; additional columns are ignored. They can be a numpy array, a structured array with the
/// fields x, y and z, an organised array (H, W, 3), whose `nearest_index` is that of the array of all H W rows, a frame of pandas or polars or an Arrow table with such columns, a torch tensor or any other value with DLPack,
/// an Open3D cloud or mesh (also of `open3d.t`), a trimesh or laspy cloud, a cloud of `read_recording`, or any other value that numpy converts to such an array. The path of
/// a file is read as by `read_points`. Points are copied as float32. Coordinates far from zero are copied relative to an
/// origin, so that georeferenced scans in float64 keep their digits. Positions are returned as float32 if the points are
/// float32 or float16, else as float64. Masked points, points that are not finite, missing returns and outliers (points far beyond all others) are skipped
/// (`Keypoints.num_skipped`), but `nearest_index` counts them.
///
/// `options` are those of `Model.encode` and `Field.detect`. They default to the values of `preset`, or else of
/// `model.recommended`. With the built-in model "compact" the defaults are:
///
#[doc = include_str!("help/encode.txt")]
#[doc = include_str!("help/detect.txt")]
#[doc = include_str!("help/preset.txt")]
///
/// The call raises TimeoutError when it has not ended after `deadline` seconds. `progress` is called with the name of a stage, the
/// completed and all units of its work, at most every 20 ms; what it raises ends the call.
///
/// A UserWarning says if the cloud has outliers, is far from the scale that model and options are for, or if an option gave it
/// another model than it would have without it, if keypoints are few, and what the file says of its points. These texts are also in `Keypoints.notes`. Raises ValueError for an
/// invalid array or value, OSError for a file that cannot be read, and TypeError for an unknown option.
///
/// A list or tuple of clouds gives a list of `Keypoints`, in its order. The clouds are detected side by side on all cores; an
/// error names the cloud by its index.
#[pyfunction]
#[pyo3(signature = (points, model=None, *, deadline=None, progress=None, **options))]
fn detect(
    py: Python<'_>,
    points: &Bound<'_, PyAny>,
    model: Option<&Bound<'_, PyAny>>,
    deadline: Option<f64>,
    progress: Option<Py<PyAny>>,
    options: Option<&Bound<'_, PyDict>>,
) -> PyResult<Py<PyAny>> {
    let watch = Watch::new(deadline, progress)?;
    let values = options::values("detect", &options::ALL, options)?;
    let chooser = model::chooser(py, model, &values)?;
    if let Some(clouds) = arrays::list_of_clouds(points)? {
        return Ok(detect_all(py, &clouds, &chooser, watch)?.into_pyobject(py)?.into_any().unbind());
    }
    let (cloud, precision, mut notes) = arrays::cloud_with_notes("points", points)?;
    let chosen = threads::run(py, || chooser.for_cloud(&cloud))?;
    // Warns before the detection, which may take minutes at the wrong scale.
    warn(py, chosen.notes())?;
    notes.extend(chosen.notes());
    let detection = threads::run_watched(py, watch, |control| chosen.detect(control))?;
    let keypoints = Keypoints::chosen(py, detection, notes, &chosen, &cloud, precision)?;
    Ok(Bound::new(py, keypoints)?.into_any().unbind())
}

/// What `detect` chooses between the models of objects and of scenes by: numbers of a cloud `(N, 3)`, or None if it is too
/// small. `snake_training.cloud_kind` fits the weights of them.
#[pyfunction]
fn scene_signs(points: &Bound<'_, PyAny>) -> PyResult<Option<Vec<f64>>> {
    let (cloud, _) = arrays::cloud("points", points)?;
    Ok(snake_core::scene_signs(&cloud.points).map(Vec::from))
}

/// The keypoints of several clouds.
fn detect_all(py: Python<'_>, given: &[Bound<'_, PyAny>], chooser: &Chooser, watch: Watch) -> PyResult<Vec<Keypoints>> {
    let mut clouds: Vec<(Cloud, Precision, Vec<String>)> = Vec::with_capacity(given.len());
    for (index, value) in given.iter().enumerate() {
        clouds.push(arrays::cloud_with_notes(&format!("points[{index}]"), value)?);
    }
    let named = |index: usize, error: Error| match error {
        Error::Input { reason, .. } => Error::Input { what: "points", reason: format!("[{index}]: {reason}") },
        other => other,
    };
    let mut chosen: Vec<(Chosen, Vec<String>)> = Vec::with_capacity(given.len());
    for (index, (cloud, _, read)) in clouds.iter().enumerate() {
        let choice = threads::run(py, || chooser.for_cloud(cloud).map_err(|error| named(index, error)))?;
        warn(py, choice.notes().iter().map(|note| format!("points[{index}]: {note}")))?;
        let notes = read.iter().cloned().chain(choice.notes()).collect();
        chosen.push((choice, notes));
    }
    let detections = threads::run_watched(py, watch, |control| {
        let (counter, control) = (control.begin("clouds", chosen.len()), control.without_progress());
        parallel_map(chosen.len(), |index| {
            let detection = chosen[index].0.detect(&control).map_err(|error| named(index, error));
            counter.add(1);
            detection
        })
    })?;
    let keypoints = |((detection, (chosen, notes)), (cloud, precision, _)): ((_, (Chosen, _)), &(Cloud, _, _))| {
        Keypoints::chosen(py, detection, notes, &chosen, cloud, *precision)
    };
    detections.into_iter().zip(chosen).zip(&clouds).map(keypoints).collect()
}

/// Gives each text as a UserWarning.
fn warn(py: Python<'_>, texts: impl IntoIterator<Item = impl AsRef<str>>) -> PyResult<()> {
    let module = py.import("warnings")?;
    texts.into_iter().try_for_each(|text| module.call_method1("warn", (text.as_ref(),)).map(drop))
}

/// Matches the keypoints of two clouds: (M, 2) int64, rows `[index in a, index in b]` of keypoints each of whose `descriptors`
/// is the nearest to the other's, by rising index in a. Some are wrong: `register` finds the transform that many agree with.
/// Raises ValueError for keypoints of two models, which lie at other places of a cloud, and as `Keypoints.descriptors` does.
#[pyfunction(name = "match")]
fn match_keypoints<'py>(
    py: Python<'py>,
    a: &Bound<'py, Keypoints>,
    b: &Bound<'py, Keypoints>,
) -> PyResult<Bound<'py, PyArray2<i64>>> {
    // Models of one name can have other weights, and those of one file other options.
    if let [Some(one), Some(other)] = [a, b].map(|keypoints| keypoints.get().model())
        && one != other
    {
        let ((first, _), (second, _)) = (one, other);
        let reason = format!(
            "match: the keypoints are of two models, {first} and {second}, which find other places; detect both with one `model`"
        );
        return Err(PyValueError::new_err(reason));
    }
    let rows = |keypoints: &Bound<'py, Keypoints>| -> PyResult<Vec<f32>> {
        Ok(keypoints.get().descriptors(py)?.bind(py).try_readonly()?.as_slice()?.to_vec())
    };
    let (rows_a, rows_b) = (rows(a)?, rows(b)?);
    let pairs = threads::run(py, || mutual_nearest(&rows_a, &rows_b, FPFH_DIMENSION))?;
    arrays::rows(py, pairs.into_flattened().into_iter().map(|index| index as i64).collect(), 2)
}

#[pymodule]
mod _core {
    use pyo3::prelude::*;

    #[pymodule_export]
    use super::baselines::{farthest_points, harris3d, iss, random_points, sift3d, surface_variation};
    #[pymodule_export]
    use super::command::run_command;
    #[pymodule_export]
    use super::page::page;
    #[pymodule_export]
    use super::steps::{aggregate, decode, interpolate, interpolate_gradient, refine, suppress};
    #[pymodule_export]
    use super::{
        DetectedTiles, Field, FrameDetector, Keypoint, Keypoints, Mesh, Model, PreparedMap, RecordedCloud, Recording,
        Tiles, align, detect, estimate_normals, fpfh, get_num_threads, match_keypoints, read_points, read_recording,
        register, scene_signs, set_num_threads, tiles,
    };

    /// Initialises what pyo3, numpy and the kernels would initialise at their first use. During that the GIL is released,
    /// and a child forked at that time would wait forever.
    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        let points = super::arrays::rows(module.py(), vec![0_f64; 3], 3)?;
        super::arrays::cloud("points", points.as_any())?;
        // Reading an option tries every type that it can have, including numpy's types.
        super::options::json(points.as_any(), 0);
        snake_core::SimdLevel::current();
        super::records::add_classes(module)?;
        // The stub has all names; the public ones are in `snake_rs.__all__`.
        module.delattr("__all__")
    }

    #[pymodule_export]
    #[expect(non_upper_case_globals, reason = "Python's name for it")]
    const __version__: &str = env!("CARGO_PKG_VERSION");
}

//! `snake_rs.register`, `PreparedMap`, `estimate_normals` and `fpfh`.

use numpy::{PyArray1, PyArray2, PyArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};
use snake_core::Cloud;
use snake_registration as core;

use crate::model;
use crate::part::part;
use crate::threads::{self, Watch};
use crate::{arrays, options, warn};

/// A rigid transform between two clouds, with a verdict and figures of its quality. It can be pickled.
#[pyclass(frozen, module = "snake_rs")]
pub struct Registration(core::Registration);

part! {
/// Whether a transform can be relied on, with the evidence beside `fit` and `matches`.
Verdict {
    /// How likely the transform is right, in [0, 1].
    confidence: f64,
    /// Whether the transform can be relied on, as the right one of many: `confidence` is at least 0.5. Of rooms it is then
    /// within 15 degrees and 0.3 m of the truth; the last digits depend on the noise.
    is_reliable: bool,
    /// Whether the clouds leave more than one answer; `notes` say why. An ambiguous transform is not reliable.
    is_ambiguous: bool,
    /// Doubts about the clouds or the transform, in sentences.
    notes: Vec<String>,
    /// How well the overlap fixes the direction of motion that it fixes least: 0 if the source can slide or rotate.
    weakest_constraint: f64,
    /// By how much the overlap exceeds that of slides along the direction that is fixed least; below 0 if one fits better.
    slide_margin: f64,
    /// Share of the patches that also fit after a shift along a repeating structure, such as equal pillars; 0 if there is none.
    repeat_fit: f64,
    /// Share of the voxels of both clouds that lie where the other cloud's sensor saw through, in [0, 1].
    free_space_violation: f64,
}
}

part! {
/// How well two clouds fit under a transform.
Fit {
    /// Share of the source's voxels within `inlier_distance` of the target's, in [0, 1].
    fitness: f64,
    /// Root mean square distance of these voxels to the target's, in cloud units.
    rmse: f64,
    /// Distance below which voxels overlap and matches agree, in cloud units.
    inlier_distance: f64,
    /// Side of the voxels, in cloud units.
    voxel_size: f64,
    /// Information matrix (6, 6) float64 of a small rotation (radians), then translation, in the target's frame.
    information: Py<PyArray2<f64>>,
}
}

part! {
/// The matches of keypoints, and how many agree with a transform.
Matches {
    /// Number of matches.
    num_matches: usize,
    /// Number of matches that the transform brings within the inlier distance before ICP.
    num_inliers: usize,
    /// Root mean square distance of the inliers before ICP, in cloud units.
    rmse: f64,
    /// Number of matches that agree with the refined transform.
    num_agreeing: usize,
    /// Number of matches that agree with the best other transform; 0 without one.
    num_rival_agreeing: usize,
    /// Standard deviation of the matches that agree in the direction in which they are spread least, in cloud units.
    spread: f64,
}
}

part! {
/// The used part of a cloud.
CloudReport {
    /// Viewpoint that gave the normals their signs: "given", "origin" or "none".
    viewpoint: String,
    /// Number of points that were skipped because they are not finite, are outliers or stand for missing returns.
    num_skipped: usize,
}
}

impl Verdict {
    fn from_core(verdict: &core::Verdict) -> Self {
        Self {
            confidence: verdict.confidence,
            is_reliable: verdict.is_reliable,
            is_ambiguous: verdict.is_ambiguous,
            notes: verdict.notes.clone(),
            weakest_constraint: verdict.weakest_constraint,
            slide_margin: verdict.slide_margin,
            repeat_fit: verdict.repeat_fit,
            free_space_violation: verdict.free_space_violation,
        }
    }
}

impl Fit {
    fn from_core(py: Python<'_>, fit: &core::Fit) -> PyResult<Self> {
        let core::Fit { fitness, rmse, inlier_distance, voxel_size, information, .. } = *fit;
        Ok(Self { fitness, rmse, inlier_distance, voxel_size, information: matrix(py, information)? })
    }
}

#[pymethods]
impl Registration {
    /// The registration that a pickle holds: a dict with the content of `snake-cli register --json`.
    #[new]
    fn new(state: &Bound<'_, PyDict>) -> PyResult<Self> {
        let refused = || PyValueError::new_err("expected the state of a registration");
        let state = options::from_python(state, 6).ok_or_else(refused)?;
        serde_json::from_value(state).map(Self).map_err(|_| refused())
    }

    fn __getnewargs__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>,)> {
        let state = serde_json::to_value(&self.0).map_err(|error| PyValueError::new_err(error.to_string()))?;
        Ok((options::to_python(py, &state)?,))
    }

    /// Maps source points into the target's frame, (4, 4) float64: `p_target = R (scale p_source) + t`.
    #[getter]
    fn t_target_source(&self, py: Python<'_>) -> PyResult<Py<PyArray2<f64>>> {
        matrix(py, self.0.t_target_source.to_matrix())
    }

    /// Factor by which source points are multiplied first: 1 unless `estimate_scale` is set.
    #[getter]
    fn scale(&self) -> f64 {
        self.0.scale
    }

    /// Whether the transform can be relied on, and why or why not.
    #[getter]
    fn verdict(&self) -> Verdict {
        Verdict::from_core(&self.0.verdict)
    }

    /// How well the clouds fit under the transform.
    #[getter]
    fn fit(&self, py: Python<'_>) -> PyResult<Fit> {
        Fit::from_core(py, &self.0.fit)
    }

    /// The matches of keypoints, and how many agree with the transform.
    #[getter]
    fn matches(&self) -> Matches {
        let core::Matches { num_matches, num_inliers, rmse, .. } = self.0.matches;
        let core::Matches { num_agreeing, num_rival_agreeing, spread, .. } = self.0.matches;
        Matches { num_matches, num_inliers, rmse, num_agreeing, num_rival_agreeing, spread }
    }

    /// The used parts of source and target.
    #[getter]
    fn clouds(&self) -> (CloudReport, CloudReport) {
        let report = |cloud: &core::CloudReport| CloudReport {
            viewpoint: cloud.viewpoint.name().into(),
            num_skipped: cloud.num_skipped,
        };
        let [source, target] = &self.0.clouds;
        (report(source), report(target))
    }

    /// The best distinct transforms (4, 4), best first: `hypotheses` of them at most.
    #[getter]
    fn hypotheses(&self, py: Python<'_>) -> PyResult<Vec<Py<PyArray2<f64>>>> {
        self.0.hypotheses.iter().map(|hypothesis| matrix(py, hypothesis.t_target_source.to_matrix())).collect()
    }

    /// Seconds that the registration took.
    #[getter]
    fn seconds(&self) -> f64 {
        self.0.seconds
    }

    fn __repr__(&self) -> String {
        let core::Registration { verdict, fit, matches, seconds, .. } = &self.0;
        format!(
            "Registration({}, confidence {:.2}; {} of {} matches; fitness {:.3}; {seconds:.3} s)",
            verdict.word(),
            verdict.confidence,
            matches.num_inliers,
            matches.num_matches,
            fit.fitness
        )
    }
}

/// Finds the rigid transform that aligns one cloud to another, without an initial pose.
///
/// `source` (N, 3) and `target` (M, 3) have the same forms as in `detect` and the same units. They may overlap only
/// partly. Points that are not finite are skipped. Descriptors of the downsampled clouds are matched, transforms on
/// which many matches agree are compared on the clouds, and point-to-plane ICP refines the best. `verdict` says whether
/// to trust it: of rooms a reliable transform is within 15 degrees and 0.3 m of the truth. Only the detector "snake" and the descriptor "field" run a `model` (default: the
/// built-in one that suits the target, as in `detect`); no other loads one. A transform that is not reliable and each of the
/// verdict's notes give a UserWarning. `deadline` and `progress` are those of `detect`.
///
/// Raises ValueError for invalid arrays or values and when no transform fits, TypeError for an unknown option. Lengths are in
/// cloud units, or text such as "3r" in multiples of the coarser cloud's mean distance between nearest points. The options
/// are:
///
#[doc = include_str!("help/register.txt")]
#[pyfunction]
#[pyo3(signature = (source, target, model=None, *, deadline=None, progress=None, **options))]
pub fn register(
    py: Python<'_>,
    source: &Bound<'_, PyAny>,
    target: &Bound<'_, PyAny>,
    model: Option<&Bound<'_, PyAny>>,
    deadline: Option<f64>,
    progress: Option<Py<PyAny>>,
    options: Option<&Bound<'_, PyDict>>,
) -> PyResult<Registration> {
    let watch = Watch::new(deadline, progress)?;
    let (mut options, mut pair): (core::RegisterOptions, core::PairOptions) = options::of("register", options)?;
    let (source, _, from_source) = arrays::cloud_with_notes("source", source)?;
    let (target, _, from_target) = arrays::cloud_with_notes("target", target)?;
    let model = model::for_registration(py, model, &options, Some(&target))?;
    pair.place(&mut options, source.origin, target.origin);
    let (from, to) = (&source.points, &target.points);
    let near = threads::run_watched(py, watch, |control| {
        core::register_with(from, to, model.as_ref(), &options, &pair, control)
    })?;
    warn(py, near.verdict.warning().iter().chain(&near.verdict.notes))?;
    let near = near.with_notes_on_clouds([&from_source, &from_target]);
    Ok(Registration(near.between_origins(source.origin, target.origin)))
}

/// A map that many scans are registered to, such as a floor of rooms. It can be pickled.
///
/// `points` (M, 3) has the forms of `register`. Its voxels, normals and descriptors are made once and kept.
/// `voxel_size` has to be given: it follows from the size of the scans, such as 1/80 of their diameter. `viewpoint` (3,) is the
/// sensor's position in the map's frame, if one sensor saw it all. The other options and `model` are those of `register`; those of a
/// pair belong to the method.
///
/// Raises ValueError for invalid arrays or values, TypeError for an unknown option.
#[pyclass(frozen, module = "snake_rs")]
pub struct PreparedMap {
    map: core::PreparedMap,
    /// The content of a pickle, from which the map is prepared again.
    given: Given,
}

struct Given {
    cloud: Cloud,
    model: Option<Py<PyAny>>,
    viewpoint: Option<[f64; 3]>,
    options: core::RegisterOptions,
}

impl PreparedMap {
    fn prepare(py: Python<'_>, given: Given) -> PyResult<Self> {
        let Given { cloud, viewpoint, options, .. } = &given;
        let model = given.model.as_ref().map(|model| model.bind(py));
        let model = model::for_registration(py, model, options, Some(cloud))?;
        let map = threads::run_with_signals(py, |control| {
            core::PreparedMap::new(cloud, *viewpoint, model.as_ref(), options, control)
        })?;
        Ok(Self { map, given })
    }
}

#[pymethods]
impl PreparedMap {
    #[new]
    #[pyo3(signature = (points, model=None, *, viewpoint=None, **options))]
    fn new(
        points: &Bound<'_, PyAny>,
        model: Option<&Bound<'_, PyAny>>,
        viewpoint: Option<[f64; 3]>,
        options: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        let options = options::of("PreparedMap", options)?;
        let (cloud, _) = arrays::cloud("points", points)?;
        let model = model.map(|model| model.clone().unbind());
        Self::prepare(points.py(), Given { cloud, model, viewpoint, options })
    }

    /// Finds the transform from a scan (N, 3) to the map, as `register` does with the map as the target. The options are those
    /// of `register` for a pair: `source_viewpoint`, `initial` and `hypotheses`.
    #[pyo3(signature = (source, **options))]
    fn register(&self, source: &Bound<'_, PyAny>, options: Option<&Bound<'_, PyDict>>) -> PyResult<Registration> {
        let pair: core::PairOptions = options::of("PreparedMap.register", options)?;
        let (scan, _) = arrays::cloud("source", source)?;
        let registration = threads::run_with_signals(source.py(), |control| self.map.register(&scan, &pair, control))?;
        warn(source.py(), registration.verdict.warning().iter().chain(&registration.verdict.notes))?;
        Ok(Registration(registration))
    }

    /// Side of the voxels, in cloud units.
    #[getter]
    fn voxel_size(&self) -> f64 {
        self.map.lengths().voxel_size
    }

    /// Prepares a pickled map again. Its points are relative to the origin.
    #[staticmethod]
    fn _restore(
        points: &Bound<'_, PyAny>,
        origin: [f64; 3],
        model: Option<Py<PyAny>>,
        viewpoint: Option<[f64; 3]>,
        options: &str,
    ) -> PyResult<Self> {
        let options = serde_json::from_str(options).map_err(|error| PyValueError::new_err(error.to_string()))?;
        let cloud = Cloud { points: arrays::points("points", points)?, origin };
        Self::prepare(points.py(), Given { cloud, model, viewpoint, options })
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyTuple>)> {
        let (py, Given { cloud, model, viewpoint, options }) = (slf.py(), &slf.get().given);
        let points = arrays::rows(py, cloud.points.as_flattened().to_vec(), 3)?;
        let options = serde_json::to_string(options).map_err(|error| PyValueError::new_err(error.to_string()))?;
        let arguments = (points, cloud.origin, model, *viewpoint, options).into_pyobject(py)?;
        Ok((slf.get_type().getattr("_restore")?, arguments))
    }

    fn __repr__(&self) -> String {
        let (count, size) = (self.given.cloud.points.len(), self.voxel_size());
        format!("PreparedMap({count} points, voxels of {size:.3})")
    }
}

pub(crate) fn matrix<const N: usize>(py: Python<'_>, rows: [[f64; N]; N]) -> PyResult<Py<PyArray2<f64>>> {
    Ok(PyArray1::from_vec(py, rows.as_flattened().to_vec()).reshape([N, N])?.unbind())
}

/// Unit normals (N, 3) float32 of a cloud (N, 3). A normal is the direction of the least variance of the points nearer
/// than `radius`, oriented towards the cloud's mean. It is zero where fewer than three points are near.
#[pyfunction]
pub fn estimate_normals<'py>(points: &Bound<'py, PyAny>, radius: f64) -> PyResult<Bound<'py, PyArray2<f32>>> {
    let (py, (Cloud { points, .. }, _)) = (points.py(), arrays::cloud("points", points)?);
    let normals = threads::run_with_signals(py, |control| core::estimate_normals_with(&points, radius, control))?;
    arrays::rows(py, normals.into_flattened(), 3)
}

/// FPFH descriptors (N, 33) float32 of a cloud (N, 3) with unit normals (N, 3), from the points nearer than `radius`,
/// as in Open3D. A pair of points whose angle is next to the edge of a bin may be in the other bin.
#[pyfunction]
pub fn fpfh<'py>(
    points: &Bound<'py, PyAny>,
    normals: &Bound<'py, PyAny>,
    radius: f64,
) -> PyResult<Bound<'py, PyArray2<f32>>> {
    let py = points.py();
    let ((Cloud { points, .. }, _), normals) = (arrays::cloud("points", points)?, arrays::points("normals", normals)?);
    let flat = threads::run_with_signals(py, |control| core::fpfh_with(&points, &normals, radius, control))?;
    arrays::rows(py, flat, core::FPFH_DIMENSION)
}

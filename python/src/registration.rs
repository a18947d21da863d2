//! `snake_rs.register`, `PreparedMap`, `estimate_normals` and `fpfh`.

use numpy::PyArray2;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};
use snake_core::Cloud;
use snake_registration as core;

use crate::model;
use crate::threads::{self, Watch};
use crate::{arrays, options, records, warn};

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
pub fn register<'py>(
    py: Python<'py>,
    source: &Bound<'_, PyAny>,
    target: &Bound<'_, PyAny>,
    model: Option<&Bound<'_, PyAny>>,
    deadline: Option<f64>,
    progress: Option<Py<PyAny>>,
    options: Option<&Bound<'_, PyDict>>,
) -> PyResult<Bound<'py, PyAny>> {
    let watch = Watch::new(deadline, progress)?;
    let (options, mut pair): (core::RegisterOptions, core::PairOptions) = options::of("register", options)?;
    let (source, _, from_source) = arrays::cloud_with_notes("source", source)?;
    let (target, _, from_target) = arrays::cloud_with_notes("target", target)?;
    let model = model::for_registration(py, model, &options, Some(&target))?;
    pair.place(source.origin, target.origin);
    let (from, to) = (&source.points, &target.points);
    let near = threads::run_watched(py, watch, |control| {
        core::register_with(from, to, model.as_ref(), &options, &pair, control)
    })?;
    warn(py, near.verdict.warning().iter().chain(&near.verdict.notes))?;
    let near = near.with_notes_on_clouds([&from_source, &from_target]);
    records::to_python(py, &near.between_origins(source.origin, target.origin))
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
    /// of `register` for a pair: `source_viewpoint`, `initial` and `hypotheses`. `deadline` and `progress` are those of `detect`.
    #[pyo3(signature = (source, *, deadline=None, progress=None, **options))]
    fn register<'py>(
        &self,
        source: &Bound<'py, PyAny>,
        deadline: Option<f64>,
        progress: Option<Py<PyAny>>,
        options: Option<&Bound<'py, PyDict>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let watch = Watch::new(deadline, progress)?;
        let pair: core::PairOptions = options::of("PreparedMap.register", options)?;
        let (scan, _) = arrays::cloud("source", source)?;
        let registration =
            threads::run_watched(source.py(), watch, |control| self.map.register(&scan, &pair, control))?;
        warn(source.py(), registration.verdict.warning().iter().chain(&registration.verdict.notes))?;
        records::to_python(source.py(), &registration)
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

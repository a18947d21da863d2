//! `snake_rs.register` and its parts.

use numpy::{PyArray1, PyArray2, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};
use snake_core::Cloud;
use snake_registration as core;

use crate::model::{self, Model};
use crate::{arrays, options, threads};

/// A rigid transform between two clouds and how far it can be trusted; it can be pickled.
#[pyclass(frozen, get_all, module = "snake_rs")]
pub struct Registration {
    /// Maps source points into the target's frame, (4, 4) float64: `p_target = R p_source + t`.
    t_target_source: Py<PyArray2<f64>>,
    /// Correspondences that RANSAC's transform, from which ICP starts, brings near to each other.
    num_inliers: usize,
    /// Keypoints that are each other's nearest in descriptor space.
    num_correspondences: usize,
    /// Root mean square distance of these inliers under RANSAC's transform, in cloud units: how far apart keypoints of one
    /// place are found, not how exact `t_target_source` is.
    rmse: f64,
    /// Points of source and target that were skipped because they are not finite.
    num_skipped: (usize, usize),
    /// Time it took.
    seconds: f64,
}

#[pymethods]
impl Registration {
    #[new]
    fn new(
        t_target_source: Py<PyArray2<f64>>,
        num_inliers: usize,
        num_correspondences: usize,
        rmse: f64,
        num_skipped: (usize, usize),
        seconds: f64,
    ) -> Self {
        Self { t_target_source, num_inliers, num_correspondences, rmse, num_skipped, seconds }
    }

    fn __getnewargs__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        let Self { t_target_source, num_inliers, num_correspondences, rmse, num_skipped, seconds } = self;
        (t_target_source, num_inliers, num_correspondences, rmse, *num_skipped, seconds).into_pyobject(py)
    }

    fn __repr__(&self) -> String {
        let Self { num_inliers, num_correspondences, rmse, seconds, .. } = self;
        format!(
            "Registration(RANSAC: {num_inliers} of {num_correspondences} correspondences, rmse {rmse:.5}; {seconds:.3} s)"
        )
    }
}

/// Finds the rigid transform that brings one cloud onto another, with nothing known beforehand.
///
/// `source` and `target` are (N, 3) and (M, 3), as `detect` takes them, in the same units; they may be parts that overlap.
/// Points that are not finite are skipped.
/// Keypoints of `model` (default: the built-in one) are matched by descriptors, RANSAC finds the transform that most
/// matches agree on, and point-to-plane ICP refines it. Options: `detector` ("snake", the model's keypoints, or "iss",
/// "harris3d", "sift3d", "fps" or "random", points of the reduced clouds), `descriptor` ("fpfh", which turns with the
/// cloud, or "field", for clouds of about the same orientation), `max_keypoints`, `voxel_size`, `normal_radius`,
/// `feature_radius`, `inlier_distance` (cloud units, or text as "3r": multiples of the coarser cloud's mean distance
/// between nearest points; None: from the clouds), `edge_length_ratio`, `max_iterations`,
/// `confidence`, `seed`, `refine_steps` (0: no ICP). Raises ValueError for arrays or values that cannot be used and
/// when no transform fits, TypeError for an unknown option.
#[pyfunction]
#[pyo3(signature = (source, target, model=None, **options))]
pub fn register(
    py: Python<'_>,
    source: &Bound<'_, PyAny>,
    target: &Bound<'_, PyAny>,
    model: Option<&Bound<'_, Model>>,
    options: Option<&Bound<'_, PyDict>>,
) -> PyResult<Registration> {
    let model = model::given_or_builtin(py, model)?;
    let options = options::of("register", options)?;
    let ((source, _), (target, _)) = (arrays::cloud("source", source)?, arrays::cloud("target", target)?);
    let (from, to) = (&source.points, &target.points);
    let near = threads::run_with_signals(py, |control| core::register_with(from, to, &model, &options, control))?;
    let found = near.between_origins(source.origin, target.origin);
    let matrix = PyArray1::from_vec(py, found.t_target_source.as_flattened().to_vec()).reshape([4, 4])?;
    let core::Registration { num_inliers, num_correspondences, rmse, num_skipped, seconds, .. } = found;
    Ok(Registration::new(matrix.unbind(), num_inliers, num_correspondences, rmse, num_skipped.into(), seconds))
}

/// Unit normals (N, 3) float32 of a cloud (N, 3): the direction in which the points nearer than `radius` vary least,
/// on the side of the cloud's mean. Zero where fewer than three points are near.
#[pyfunction]
pub fn estimate_normals<'py>(points: &Bound<'py, PyAny>, radius: f64) -> PyResult<Bound<'py, PyArray2<f32>>> {
    let (py, (Cloud { points, .. }, _)) = (points.py(), arrays::cloud("points", points)?);
    let normals = threads::run(py, || core::estimate_normals(&points, radius))?;
    arrays::rows(py, normals.into_flattened(), 3)
}

/// FPFH (N, 33) float32 of a cloud (N, 3) with unit normals (N, 3), of the points nearer than `radius`; as Open3D.
#[pyfunction]
pub fn fpfh<'py>(
    points: &Bound<'py, PyAny>,
    normals: &Bound<'py, PyAny>,
    radius: f64,
) -> PyResult<Bound<'py, PyArray2<f32>>> {
    let py = points.py();
    let ((Cloud { points, .. }, _), normals) = (arrays::cloud("points", points)?, arrays::points("normals", normals)?);
    let flat = threads::run(py, || core::fpfh(&points, &normals, radius))?;
    arrays::rows(py, flat, core::FPFH_DIMENSION)
}

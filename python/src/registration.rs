//! `snake_rs.register`, `estimate_normals` and `fpfh`.

use numpy::{PyArray1, PyArray2, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};
use snake_core::Cloud;
use snake_registration as core;

use crate::model::{self, Model};
use crate::{arrays, options, threads};

/// A rigid transform between two clouds, with figures of its quality. It can be pickled.
#[pyclass(frozen, get_all, module = "snake_rs")]
pub struct Registration {
    /// Maps source points into the target's frame, (4, 4) float64: `p_target = R p_source + t`.
    t_target_source: Py<PyArray2<f64>>,
    /// Number of correspondences that are inliers of RANSAC's transform, from which ICP starts.
    num_inliers: usize,
    /// Number of correspondences: keypoints that are mutual nearest neighbours in descriptor space.
    num_correspondences: usize,
    /// Root mean square distance of the inliers under RANSAC's transform, in cloud units. It measures how far apart two
    /// keypoints of the same place are, not the accuracy of `t_target_source`.
    rmse: f64,
    /// Distance up to which a correspondence is an inlier, in cloud units.
    inlier_distance: f64,
    /// Share of the source's voxels within `inlier_distance` of the target's under `t_target_source`, in [0, 1].
    fitness: f64,
    /// Root mean square distance of these voxels to the target's, in cloud units.
    fitness_rmse: f64,
    /// Numbers of points of source and target that were skipped because they are not finite.
    num_skipped: (usize, usize),
    /// Seconds that the registration took.
    seconds: f64,
}

#[pymethods]
impl Registration {
    #[new]
    #[expect(clippy::too_many_arguments, reason = "a pickle holds them all")]
    fn new(
        t_target_source: Py<PyArray2<f64>>,
        num_inliers: usize,
        num_correspondences: usize,
        rmse: f64,
        inlier_distance: f64,
        fitness: f64,
        fitness_rmse: f64,
        num_skipped: (usize, usize),
        seconds: f64,
    ) -> Self {
        Self {
            t_target_source,
            num_inliers,
            num_correspondences,
            rmse,
            inlier_distance,
            fitness,
            fitness_rmse,
            num_skipped,
            seconds,
        }
    }

    fn __getnewargs__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        let Self { t_target_source, num_inliers, num_correspondences, rmse, num_skipped, seconds, .. } = self;
        let Self { inlier_distance, fitness, fitness_rmse, .. } = self;
        (
            t_target_source,
            num_inliers,
            num_correspondences,
            rmse,
            inlier_distance,
            fitness,
            fitness_rmse,
            *num_skipped,
            seconds,
        )
            .into_pyobject(py)
    }

    fn __repr__(&self) -> String {
        let Self { num_inliers, num_correspondences, rmse, fitness, fitness_rmse, seconds, .. } = self;
        format!(
            "Registration(RANSAC: {num_inliers} of {num_correspondences} correspondences, rmse {rmse:.5}; \
             fitness {fitness:.3}, rmse {fitness_rmse:.5}; {seconds:.3} s)"
        )
    }
}

/// Finds the rigid transform that aligns one cloud to another, without an initial pose.
///
/// `source` (N, 3) and `target` (M, 3) have the same forms as in `detect` and the same units. They may overlap only
/// partly. Points that are not finite are skipped. The keypoints of `model` (default: the built-in one) are matched by
/// their descriptors, RANSAC finds the transform with the most inliers, and point-to-plane ICP refines it.
///
/// Options: `detector` ("snake", the model's keypoints, or "iss", "harris3d", "sift3d", "fps" or "random" on the
/// downsampled clouds), `descriptor` ("fpfh", which is invariant to rotation, or "field", for clouds of about the same
/// orientation), `max_keypoints`, `voxel_size`, `normal_radius`, `feature_radius` and `inlier_distance` (lengths in
/// cloud units, or text such as "3r" in multiples of the coarser cloud's mean distance between nearest points; None:
/// derived from the clouds), `edge_length_ratio`, `max_iterations`, `confidence`, `seed`, `refine_steps` (0: no ICP).
/// Raises ValueError for invalid arrays or values and when no transform fits, TypeError for an unknown option.
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
    let matrix = PyArray1::from_vec(py, found.t_target_source.to_matrix().as_flattened().to_vec()).reshape([4, 4])?;
    let core::Registration { num_inliers, num_correspondences, rmse, num_skipped, seconds, .. } = found;
    let core::Registration { inlier_distance, fitness, fitness_rmse, .. } = found;
    Ok(Registration {
        t_target_source: matrix.unbind(),
        num_inliers,
        num_correspondences,
        rmse,
        inlier_distance,
        fitness,
        fitness_rmse,
        num_skipped: num_skipped.into(),
        seconds,
    })
}

/// Unit normals (N, 3) float32 of a cloud (N, 3). A normal is the direction of the least variance of the points nearer
/// than `radius`, oriented towards the cloud's mean. It is zero where fewer than three points are near.
#[pyfunction]
pub fn estimate_normals<'py>(points: &Bound<'py, PyAny>, radius: f64) -> PyResult<Bound<'py, PyArray2<f32>>> {
    let (py, (Cloud { points, .. }, _)) = (points.py(), arrays::cloud("points", points)?);
    let normals = threads::run(py, || core::estimate_normals(&points, radius))?;
    arrays::rows(py, normals.into_flattened(), 3)
}

/// FPFH descriptors (N, 33) float32 of a cloud (N, 3) with unit normals (N, 3), from the points nearer than `radius`,
/// as in Open3D.
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

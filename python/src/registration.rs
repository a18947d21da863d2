//! `snake_rs.register`, `estimate_normals` and `fpfh`.

use numpy::{PyArray1, PyArray2, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use snake_core::{Cloud, RigidTransform};
use snake_registration as core;

use crate::model;
use crate::{arrays, options, threads};

/// A rigid transform between two clouds, with a verdict and figures of its quality. It can be pickled.
#[pyclass(frozen, get_all, module = "snake_rs")]
pub struct Registration {
    /// Maps source points into the target's frame, (4, 4) float64: `p_target = R p_source + t`.
    t_target_source: Py<PyArray2<f64>>,
    /// How likely the transform is right, in [0, 1].
    confidence: f64,
    /// Whether the transform can be relied on: `confidence` is at least 0.5.
    is_reliable: bool,
    /// Whether the clouds leave more than one answer; `notes` say why. An ambiguous transform is not reliable.
    is_ambiguous: bool,
    /// Number of matches that the transform brings within `inlier_distance` before ICP.
    num_inliers: usize,
    /// Number of matches that agree with the refined transform.
    num_agreeing: usize,
    /// The same for the best other transform; 0 without one.
    num_rival_agreeing: usize,
    /// Number of matches of keypoints.
    num_correspondences: usize,
    /// Root mean square distance of the inliers before ICP, in cloud units.
    rmse: f64,
    /// Distance up to which a match is an inlier, in cloud units.
    inlier_distance: f64,
    /// Share of the source's voxels within `inlier_distance` of the target's under `t_target_source`, in [0, 1].
    fitness: f64,
    /// Root mean square distance of these voxels to the target's, in cloud units.
    fitness_rmse: f64,
    /// Share of the voxels of both clouds that lie where the other cloud's sensor saw through, in [0, 1].
    free_space_violation: f64,
    /// Standard deviation of the matches that agree in the direction in which they are spread least, in cloud units.
    match_spread: f64,
    /// How well the overlap fixes the direction of motion that it fixes least: 0 if the source can slide or turn.
    weakest_constraint: f64,
    /// By how much the overlap exceeds that of slides along the direction that is fixed least; below 0 if one fits better.
    slide_margin: f64,
    /// Share of the patches that agree where the target looks alike, such as a period farther along equal pillars; 0 if nowhere.
    repeat_fit: f64,
    /// Information matrix (6, 6) float64 of a small rotation (radians), then translation, in the target's frame.
    information: Py<PyArray2<f64>>,
    /// The best distinct transforms (4, 4), best first: `hypotheses` of them at most.
    hypotheses: Vec<Py<PyArray2<f64>>>,
    /// Which viewpoints were used for source and target: "given", "origin" or "none".
    viewpoints: (String, String),
    /// What may be wrong with the clouds.
    notes: Vec<String>,
    /// Numbers of points of source and target that were skipped because they are not finite or stand for missing returns.
    num_skipped: (usize, usize),
    /// Seconds that the registration took.
    seconds: f64,
}

/// Names the attributes, and reads all of them from a dict.
macro_rules! attributes {
    ($($name:ident),* $(,)?) => {
        impl Registration {
            const NAMES: &[&str] = &[$(stringify!($name)),*];

            fn of_state(state: &Bound<'_, PyDict>) -> PyResult<Self> {
                Ok(Self { $($name: state.as_any().get_item(stringify!($name))?.extract()?),* })
            }
        }
    };
}
attributes!(
    t_target_source,
    confidence,
    is_reliable,
    is_ambiguous,
    num_inliers,
    num_agreeing,
    num_rival_agreeing,
    num_correspondences,
    rmse,
    inlier_distance,
    fitness,
    fitness_rmse,
    free_space_violation,
    match_spread,
    weakest_constraint,
    slide_margin,
    repeat_fit,
    information,
    hypotheses,
    viewpoints,
    notes,
    num_skipped,
    seconds,
);

#[pymethods]
impl Registration {
    /// The registration that a pickle holds: a dict of all attributes.
    #[new]
    fn new(state: &Bound<'_, PyDict>) -> PyResult<Self> {
        Self::of_state(state)
    }

    fn __getnewargs__<'py>(this: &Bound<'py, Self>) -> PyResult<(Bound<'py, PyDict>,)> {
        let state = PyDict::new(this.py());
        for name in Self::NAMES {
            state.set_item(name, this.getattr(name)?)?;
        }
        Ok((state,))
    }

    fn __repr__(&self) -> String {
        let Self { confidence, num_inliers, num_correspondences, fitness, seconds, .. } = self;
        let verdict = match (self.is_reliable, self.is_ambiguous) {
            (true, _) => "reliable",
            (false, true) => "ambiguous",
            (false, false) => "not reliable",
        };
        format!(
            "Registration({verdict}, confidence {confidence:.2}; {num_inliers} of {num_correspondences} matches; \
             fitness {fitness:.3}; {seconds:.3} s)"
        )
    }
}

/// Finds the rigid transform that aligns one cloud to another, without an initial pose.
///
/// `source` (N, 3) and `target` (M, 3) have the same forms as in `detect` and the same units. They may overlap only
/// partly. Points that are not finite are skipped. Descriptors of the downsampled clouds are matched, transforms on
/// which many matches agree are compared on the clouds, and point-to-plane ICP refines the best. `confidence` and
/// `is_reliable` say whether to trust it. Only the detector "snake" and the descriptor "field" run a `model` (default: the
/// built-in one that suits the target, as in `detect`); no other loads one.
///
/// Raises ValueError for invalid arrays or values and when no transform fits, TypeError for an unknown option. Lengths are in
/// cloud units, or text such as "3r" in multiples of the coarser cloud's mean distance between nearest points. The options
/// are:
///
#[doc = include_str!("help/register.txt")]
#[pyfunction]
#[pyo3(signature = (source, target, model=None, **options))]
pub fn register(
    py: Python<'_>,
    source: &Bound<'_, PyAny>,
    target: &Bound<'_, PyAny>,
    model: Option<&Bound<'_, PyAny>>,
    options: Option<&Bound<'_, PyDict>>,
) -> PyResult<Registration> {
    let mut options: core::RegisterOptions = options::of("register", options)?;
    let ((source, _), (target, _)) = (arrays::cloud("source", source)?, arrays::cloud("target", target)?);
    let model = model::of_registration(py, model, &options, Some(&target))?;
    options.place(source.origin, target.origin);
    let (from, to) = (&source.points, &target.points);
    let near =
        threads::run_with_signals(py, |control| core::register_with(from, to, model.as_ref(), &options, control))?;
    let found = near.between_origins(source.origin, target.origin);
    let transform = |transform: RigidTransform| matrix(py, transform.to_matrix());
    let hypotheses = found.hypotheses.iter().map(|hypothesis| transform(hypothesis.t_target_source));
    Ok(Registration {
        t_target_source: transform(found.t_target_source)?,
        confidence: found.confidence,
        is_reliable: found.is_reliable,
        is_ambiguous: found.is_ambiguous,
        num_inliers: found.num_inliers,
        num_agreeing: found.num_agreeing,
        num_rival_agreeing: found.num_rival_agreeing,
        num_correspondences: found.num_correspondences,
        rmse: found.rmse,
        inlier_distance: found.inlier_distance,
        fitness: found.fitness,
        fitness_rmse: found.fitness_rmse,
        free_space_violation: found.free_space_violation,
        match_spread: found.match_spread,
        weakest_constraint: found.weakest_constraint,
        slide_margin: found.slide_margin,
        repeat_fit: found.repeat_fit,
        information: matrix(py, found.information)?,
        hypotheses: hypotheses.collect::<PyResult<_>>()?,
        viewpoints: found.viewpoints.map(|used| used.name().to_string()).into(),
        notes: found.notes,
        num_skipped: found.num_skipped.into(),
        seconds: found.seconds,
    })
}

pub(crate) fn matrix<const N: usize>(py: Python<'_>, rows: [[f64; N]; N]) -> PyResult<Py<PyArray2<f64>>> {
    Ok(PyArray1::from_vec(py, rows.as_flattened().to_vec()).reshape([N, N])?.unbind())
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

//! `snake_rs.baselines`.

use numpy::PyArray1;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use snake_core::{Cloud, Control, Point, Result};
use snake_detectors::{Protocol, Response};
use snake_geometry::FinitePoints;

use crate::arrays::{self, named};
use crate::error::py_error;
use crate::{options, threads, warn};

/// Indices (K,) int64 and scores (K,) float64.
type Found<'py> = (Bound<'py, PyArray1<i64>>, Bound<'py, PyArray1<f64>>);

/// Runs `detect` on the points of an array and returns its responses.
fn responses<'py>(
    points: &Bound<'py, PyAny>,
    detect: impl FnOnce(&[Point], &Control) -> Result<Vec<Response>> + Send,
) -> PyResult<Found<'py>> {
    let (py, (Cloud { points, .. }, _)) = (points.py(), arrays::cloud("points", points)?);
    let findings = FinitePoints::clean("points", &points, None).map_err(py_error)?.findings();
    warn(py, &findings)?;
    let responses: Vec<Response> = threads::run_with_signals(py, |control| detect(&points, control))?;
    let indices = responses.iter().map(|response| response.index as i64).collect();
    let scores = responses.iter().map(|response| response.score).collect();
    Ok((arrays::values(py, indices), arrays::values(py, scores)))
}

/// Defines the functions for detectors with options: documentation, name, function of the crate, struct of options, and
/// the file of their help.
macro_rules! baselines {
    ($($(#[doc = $doc:literal])+ $name:ident, $detect:ident, $options:ident, $help:literal;)+) => { $(
        $(#[doc = $doc])+
        ///
        /// `count` limits the number of keypoints. `protocol` "ranked" selects the strongest keypoints. "paper" selects a
        /// random subset and fills it up to `count` with random points, like the baselines of the paper. `seed` determines
        /// the random choices. A length is a number, in cloud units, or text such as "6r": 6 times the mean distance between
        /// nearest points, or "30%" of the largest distance from the mean. Raises ValueError for an invalid array or value,
        /// TypeError for an unknown option. The options are:
        ///
        #[doc = include_str!($help)]
        #[pyfunction]
        #[pyo3(signature = (points, *, count=None, protocol="ranked", seed=0, **options))]
        pub fn $name<'py>(
            points: &Bound<'py, PyAny>,
            count: Option<usize>,
            protocol: &str,
            seed: u64,
            options: Option<&Bound<'py, PyDict>>,
        ) -> PyResult<Found<'py>> {
            let options: snake_detectors::$options = options::of(stringify!($name), options)?;
            let protocol = named("protocol", protocol, [("ranked", Protocol::Ranked), ("paper", Protocol::Paper)])?;
            if protocol == Protocol::Paper && count.is_none() {
                return Err(PyValueError::new_err("option `count` is None: protocol paper needs a number"));
            }
            let count = count.unwrap_or(usize::MAX);
            responses(points, |points, control| {
                let detect = |points: &[Point]| snake_detectors::$detect(points, &options, control);
                snake_detectors::select_keypoints(points, detect, count, protocol, seed)
            })
        }
    )+ };
}

baselines! {
    /// Intrinsic shape signatures (ISS): indices (K,) int64 into `points` (N, 3) and scores (K,) float64, best first.
    ///
    /// The score is the smallest eigenvalue of the covariance of the points nearer than `salient_radius`, in square units.
    /// A keypoint has the largest score of all points nearer than `non_max_radius`. The defaults give the keypoints of
    /// Open3D's compute_iss_keypoints.
    iss, iss_with, IssOptions, "help/iss.txt";
    /// Harris 3D as in PCL: indices (K,) int64 into `points` (N, 3) and scores (K,) float64, best first.
    ///
    /// The score is the determinant of the mean outer product of the normals within `radius`, 0 to 1/27.
    harris3d, harris3d_with, Harris3dOptions, "help/harris3d.txt";
    /// SIFT 3D as in PCL: indices (K,) int64 into `points` (N, 3) and scores (K,) float64, best first.
    ///
    /// Keypoints are the input points nearest to the extrema of differences of Gaussians of a scalar field. The score is the
    /// absolute difference.
    sift3d, sift3d_with, Sift3dOptions, "help/sift3d.txt";
    /// Surface variation (Pauly et al. 2002): indices (K,) int64 into `points` (N, 3) and scores (K,) float64, best first.
    ///
    /// The score is the smallest eigenvalue of the covariance of the points nearer than `radius`, divided by the sum of the
    /// three, 0 to 1/3. A keypoint has the largest score of all points nearer than `non_max_radius`.
    surface_variation, surface_variation_with, SurfaceVariationOptions, "help/surface_variation.txt";
}

/// Farthest-point sampling: indices (K,) int64 into `points` (N, 3) and scores (K,) float64, best first.
///
/// The first point is the one farthest from the mean. The score of a point is its distance to the nearest point
/// selected before it; the score of the first point is its distance to the second. Raises ValueError for an invalid
/// array or count.
#[pyfunction]
pub fn farthest_points<'py>(points: &Bound<'py, PyAny>, count: usize) -> PyResult<Found<'py>> {
    responses(points, |points, _| snake_detectors::Detector::Fps.keypoints(points, count, Protocol::Ranked, 0))
}

/// Random points without replacement: indices (K,) int64 into `points` (N, 3) and scores (K,) float64, best first.
/// Raises ValueError for an invalid array or count.
#[pyfunction]
#[pyo3(signature = (points, count, seed=0))]
pub fn random_points<'py>(points: &Bound<'py, PyAny>, count: usize, seed: u64) -> PyResult<Found<'py>> {
    responses(points, |points, _| snake_detectors::Detector::Random.keypoints(points, count, Protocol::Ranked, seed))
}

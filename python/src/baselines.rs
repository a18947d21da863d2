//! `snake_rs.baselines`.

use numpy::PyArray1;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use snake_core::{Cloud, Length};
use snake_geometry::FinitePoints;
use snake_registration::detectors::{
    Covariance, Detector, Harris3dOptions, IssOptions, Protocol, Response, Sift3dOptions, SiftField,
    SurfaceVariationOptions,
};

use crate::arrays::{self, named};
use crate::error::py_error;
use crate::{threads, warn};

/// Indices (K,) int64 and scores (K,) float64.
type Found<'py> = (Bound<'py, PyArray1<i64>>, Bound<'py, PyArray1<f64>>);

/// A length in Python: a number of cloud units, or text such as "6r".
#[derive(FromPyObject)]
pub enum LengthLike {
    /// In the cloud's units.
    Units(f64),
    /// Text that the core parses.
    Text(String),
}

impl LengthLike {
    pub fn length(self) -> PyResult<Length> {
        match self {
            Self::Units(length) => Ok(Length::Units(length)),
            Self::Text(text) => text.parse().map_err(py_error),
        }
    }
}

fn keypoints<'py>(
    points: &Bound<'py, PyAny>,
    detector: Detector,
    count: Option<usize>,
    protocol: &str,
    seed: u64,
) -> PyResult<Found<'py>> {
    let protocol = named("protocol", protocol, [("ranked", Protocol::Ranked), ("paper", Protocol::Paper)])?;
    if protocol == Protocol::Paper && count.is_none() {
        return Err(PyValueError::new_err("option `count` is None: protocol paper needs a number"));
    }
    let (py, (Cloud { points, .. }, _)) = (points.py(), arrays::cloud("points", points)?);
    let outliers = FinitePoints::of("points", &points).map_err(py_error)?.outliers();
    outliers.map_or(Ok(()), |outliers| warn(py, &outliers.to_string()))?;
    let count = count.unwrap_or(usize::MAX);
    let found: Vec<Response> =
        threads::run_with_signals(py, |control| detector.keypoints_with(&points, count, protocol, seed, control))?;
    let indices = found.iter().map(|response| response.index as i64).collect();
    Ok((arrays::values(py, indices), arrays::values(py, found.iter().map(|response| response.score).collect())))
}

/// Intrinsic shape signatures (ISS): indices (K,) int64 into `points` (N, 3) and scores (K,) float64, best first.
///
/// The score is the smallest eigenvalue of the covariance of the points nearer than `salient_radius`, in square units.
/// A keypoint has the largest score of all points nearer than `non_max_radius`. `covariance` is "about-mean" (divided
/// by the number of points, as in Open3D's compute_iss_keypoints, which gives the same keypoints) or "about-point" (the
/// sum, as in PCL).
///
/// A length is a number, in cloud units, or text such as "6r": 6 times the mean distance between nearest points.
/// `count` limits the number of keypoints. `protocol` "ranked" selects the strongest keypoints. "paper" selects a
/// random subset and fills it up to `count` with random points, like the baselines of the paper. `seed` determines the
/// random choices. Raises ValueError for an invalid array or value.
#[pyfunction]
#[pyo3(signature = (
    points, *, salient_radius=LengthLike::Text("6r".into()), non_max_radius=LengthLike::Text("4r".into()),
    gamma_21=0.975, gamma_32=0.975, min_neighbors=5, covariance="about-mean", count=None, protocol="ranked", seed=0
))]
#[pyo3(text_signature = "(points, *, salient_radius='6r', non_max_radius='4r', gamma_21=0.975, gamma_32=0.975, \
    min_neighbors=5, covariance='about-mean', count=None, protocol='ranked', seed=0)")]
#[expect(clippy::too_many_arguments, reason = "keywords in Python")]
pub fn iss<'py>(
    points: &Bound<'py, PyAny>,
    salient_radius: LengthLike,
    non_max_radius: LengthLike,
    gamma_21: f64,
    gamma_32: f64,
    min_neighbors: usize,
    covariance: &str,
    count: Option<usize>,
    protocol: &str,
    seed: u64,
) -> PyResult<Found<'py>> {
    let known = [("about-mean", Covariance::AboutMean), ("about-point", Covariance::AboutPoint)];
    let options = IssOptions::default()
        .with_salient_radius(salient_radius.length()?)
        .with_non_max_radius(non_max_radius.length()?)
        .with_gamma_21(gamma_21)
        .with_gamma_32(gamma_32)
        .with_min_neighbors(min_neighbors)
        .with_covariance(named("covariance", covariance, known)?);
    keypoints(points, Detector::Iss(options), count, protocol, seed)
}

/// Harris 3D as in PCL: indices (K,) int64 into `points` (N, 3) and scores (K,) float64, best first.
///
/// The score is the determinant of the mean outer product of the normals within `radius`, 0 to 1/27. Points with a
/// score below `threshold` are dropped. Without non-maximum suppression (`non_max=False`) every point is a keypoint.
/// Lengths, `count`, `protocol`, `seed` and errors are as in `iss`.
#[pyfunction]
#[pyo3(signature = (
    points, *, radius=LengthLike::Text("6r".into()), threshold=0.0, non_max=true, count=None, protocol="ranked", seed=0
))]
#[pyo3(text_signature = "(points, *, radius='6r', threshold=0.0, non_max=True, count=None, protocol='ranked', seed=0)")]
pub fn harris3d<'py>(
    points: &Bound<'py, PyAny>,
    radius: LengthLike,
    threshold: f64,
    non_max: bool,
    count: Option<usize>,
    protocol: &str,
    seed: u64,
) -> PyResult<Found<'py>> {
    let options =
        Harris3dOptions::default().with_radius(radius.length()?).with_threshold(threshold).with_non_max(non_max);
    keypoints(points, Detector::Harris3d(options), count, protocol, seed)
}

/// SIFT 3D as in PCL: indices (K,) int64 into `points` (N, 3) and scores (K,) float64, best first.
///
/// Keypoints are the input points nearest to the extrema of differences of Gaussians of a scalar field. `field` is
/// "curvature" (surface variation within `curvature_radius`) or "y" (the coordinate, as in the paper's baseline, which
/// is not invariant to rotation). The score is the absolute difference, at least `min_contrast`. `min_scale` is the
/// scale of the first octave, and the scale doubles with each of the `octaves`. Lengths, `count`, `protocol`, `seed`
/// and errors are as in `iss`.
#[pyfunction]
#[pyo3(signature = (
    points, *, min_scale=LengthLike::Text("2r".into()), octaves=4, scales_per_octave=8, min_contrast=0.0,
    field="curvature", curvature_radius=LengthLike::Text("6r".into()), count=None, protocol="ranked", seed=0
))]
#[pyo3(text_signature = "(points, *, min_scale='2r', octaves=4, scales_per_octave=8, min_contrast=0.0, \
    field='curvature', curvature_radius='6r', count=None, protocol='ranked', seed=0)")]
#[expect(clippy::too_many_arguments, reason = "keywords in Python")]
pub fn sift3d<'py>(
    points: &Bound<'py, PyAny>,
    min_scale: LengthLike,
    octaves: usize,
    scales_per_octave: usize,
    min_contrast: f64,
    field: &str,
    curvature_radius: LengthLike,
    count: Option<usize>,
    protocol: &str,
    seed: u64,
) -> PyResult<Found<'py>> {
    let known = [("curvature", SiftField::Curvature(curvature_radius.length()?)), ("y", SiftField::Y)];
    let options = Sift3dOptions::default()
        .with_min_scale(min_scale.length()?)
        .with_octaves(octaves)
        .with_scales_per_octave(scales_per_octave)
        .with_min_contrast(min_contrast)
        .with_field(named("field", field, known)?);
    keypoints(points, Detector::Sift3d(options), count, protocol, seed)
}

/// Surface variation (Pauly et al. 2002): indices (K,) int64 into `points` (N, 3) and scores (K,) float64, best first.
///
/// The score is the smallest eigenvalue of the covariance of the points nearer than `radius`, divided by the sum of the
/// three, 0 to 1/3. A keypoint has the largest score of all points nearer than `non_max_radius`. A length may also be text
/// such as "30%", per cent of the largest distance from the mean. Other lengths, `count`, `protocol`, `seed` and errors
/// are as in `iss`.
#[pyfunction]
#[pyo3(signature = (
    points, *, radius=LengthLike::Text("30%".into()), non_max_radius=LengthLike::Text("4r".into()), count=None,
    protocol="ranked", seed=0
))]
#[pyo3(text_signature = "(points, *, radius='30%', non_max_radius='4r', count=None, protocol='ranked', seed=0)")]
pub fn surface_variation<'py>(
    points: &Bound<'py, PyAny>,
    radius: LengthLike,
    non_max_radius: LengthLike,
    count: Option<usize>,
    protocol: &str,
    seed: u64,
) -> PyResult<Found<'py>> {
    let options =
        SurfaceVariationOptions::default().with_radius(radius.length()?).with_non_max_radius(non_max_radius.length()?);
    keypoints(points, Detector::SurfaceVariation(options), count, protocol, seed)
}

/// Farthest-point sampling: indices (K,) int64 into `points` (N, 3) and scores (K,) float64, best first.
///
/// The first point is the one farthest from the mean. The score of a point is its distance to the nearest point
/// selected before it; the score of the first point is its distance to the second. Raises ValueError for an invalid
/// array or count.
#[pyfunction]
pub fn farthest_points<'py>(points: &Bound<'py, PyAny>, count: usize) -> PyResult<Found<'py>> {
    keypoints(points, Detector::FarthestPoint, Some(count), "ranked", 0)
}

/// Random points without replacement: indices (K,) int64 into `points` (N, 3) and scores (K,) float64, best first.
/// Raises ValueError for an invalid array or count.
#[pyfunction]
#[pyo3(signature = (points, count, seed=0))]
pub fn random_points<'py>(points: &Bound<'py, PyAny>, count: usize, seed: u64) -> PyResult<Found<'py>> {
    keypoints(points, Detector::Random, Some(count), "ranked", seed)
}

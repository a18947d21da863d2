//! `snake_rs.metrics`.

use numpy::{PyArray1, PyArray2, PyArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use snake_core::{self, Point, Transform};
use snake_eval::{self as core, MatchCounts, RegistrationOutcome, SmplProtocol, Unreachable};

use crate::arrays::{self, named};
use crate::error::py_error;
use crate::threads;

/// One number for each threshold.
type Numbers<'py> = Bound<'py, PyArray1<f64>>;
/// Rows of ground truth, false positives and false negatives.
type Counts<'py> = Bound<'py, PyArray2<i64>>;

/// Keypoints of two views, the transform between them and thresholds to shares.
type Repeatability = fn(&[Point], &[Point], &Transform, &[f64]) -> snake_core::Result<Vec<f64>>;

/// An array-like of numbers as Rust has it.
fn numbers<T>(what: &str, expected: &str, value: &Bound<PyAny>) -> PyResult<T>
where
    T: for<'a, 'py> FromPyObject<'a, 'py>,
{
    let list = value.py().import("numpy")?.call_method1("asarray", (value,))?.call_method0("tolist")?;
    list.extract().map_err(|_| PyValueError::new_err(format!("{what}: expected {expected}, found {value}")))
}

fn transform(what: &str, value: &Bound<PyAny>) -> PyResult<Transform> {
    numbers(what, "a transform of shape (4, 4)", value)
}

fn thresholds(what: &str, value: &Bound<PyAny>) -> PyResult<Vec<f64>> {
    numbers(what, "numbers of shape (T,)", value)
}

fn indices(what: &str, value: &Bound<PyAny>) -> PyResult<Vec<usize>> {
    numbers(what, "indices of shape (K,)", value)
}

fn counts_array(py: Python<'_>, counts: Vec<MatchCounts>) -> PyResult<Counts<'_>> {
    let row = |c: &MatchCounts| [c.ground_truth as i64, c.false_positives as i64, c.false_negatives as i64];
    let flat: Vec<i64> = counts.iter().flat_map(row).collect();
    PyArray1::from_vec(py, flat).reshape([counts.len(), 3])
}

fn counts_from(rows: Vec<[usize; 3]>) -> Vec<MatchCounts> {
    let counts = |[ground_truth, false_positives, false_negatives]: [usize; 3]| MatchCounts {
        ground_truth,
        false_positives,
        false_negatives,
    };
    rows.into_iter().map(counts).collect()
}

/// What the two variants of repeatability share.
fn repeatability<'py>(
    keypoints: [&Bound<'py, PyAny>; 2],
    t_1_2: &Bound<'py, PyAny>,
    epsilon: &Bound<'py, PyAny>,
    of: Repeatability,
) -> PyResult<Numbers<'py>> {
    let py = t_1_2.py();
    let (first, second) = (arrays::points("keypoints_1", keypoints[0])?, arrays::points("keypoints_2", keypoints[1])?);
    let (t_1_2, epsilon) = (transform("t_1_2", t_1_2)?, thresholds("epsilon", epsilon)?);
    let shares = threads::run(py, || of(&first, &second, &t_1_2, &epsilon))?;
    Ok(arrays::values(py, shares))
}

/// Relative repeatability (SNAKE section 4.2, USIP): of each `epsilon` (T,), the share of view 1's keypoints (K, 3)
/// nearer than it to one of view 2's (L, 3), brought to view 1 by `t_1_2` (4, 4). Returns (T,) float64.
///
/// One-directional, not one-to-one, without a test of overlap; a view without keypoints gives 0. Raises ValueError for
/// arrays that cannot be used.
#[pyfunction]
pub fn relative_repeatability<'py>(
    keypoints_1: &Bound<'py, PyAny>,
    keypoints_2: &Bound<'py, PyAny>,
    t_1_2: &Bound<'py, PyAny>,
    epsilon: &Bound<'py, PyAny>,
) -> PyResult<Numbers<'py>> {
    repeatability([keypoints_1, keypoints_2], t_1_2, epsilon, core::relative_repeatability)
}

/// The mean of `relative_repeatability` from view 1 to view 2 and from view 2 to view 1: (T,) float64.
#[pyfunction]
pub fn symmetric_repeatability<'py>(
    keypoints_1: &Bound<'py, PyAny>,
    keypoints_2: &Bound<'py, PyAny>,
    t_1_2: &Bound<'py, PyAny>,
    epsilon: &Bound<'py, PyAny>,
) -> PyResult<Numbers<'py>> {
    repeatability([keypoints_1, keypoints_2], t_1_2, epsilon, core::symmetric_repeatability)
}

/// Mean distance from each point (N, 3) to its nearest keypoint (K, 3), in cloud units: how well keypoints cover a
/// cloud. Raises ValueError for arrays that cannot be used.
#[pyfunction]
pub fn mean_distance_to_keypoints(points: &Bound<PyAny>, keypoints: &Bound<PyAny>) -> PyResult<f64> {
    let py = points.py();
    let (points, keypoints) = (arrays::points("points", points)?, arrays::points("keypoints", keypoints)?);
    threads::run(py, || core::mean_distance_to_keypoints(&points, &keypoints))
}

/// Geodesic distances (S, N) float64 from the points at the indices `sources` (S,) to all `points` (N, 3), in cloud
/// units: shortest paths over the undirected graph of each point's `neighbors` nearest; inf where there is no path.
/// Raises ValueError for arrays that cannot be used.
#[pyfunction]
#[pyo3(signature = (points, sources, neighbors=20))]
pub fn geodesic_distances<'py>(
    points: &Bound<'py, PyAny>,
    sources: &Bound<'py, PyAny>,
    neighbors: usize,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let (py, points, sources) = (points.py(), arrays::points("points", points)?, indices("sources", sources)?);
    let rows = threads::run(py, || core::geodesic_distances(&points, &sources, neighbors))?;
    PyArray1::from_vec(py, rows.concat()).reshape([sources.len(), points.len()])
}

/// KeypointNet's counts for one shape (SNAKE section 4.1): (T, 3) int64, for each of `thresholds` (T,) the number of
/// ground-truth keypoints, of false positives and of false negatives. Add the counts of a class's shapes for `iou`.
///
/// `ground_truth` are indices (G,) into `points` (N, 3); `found` (K, 3) are brought to their nearest points. They match
/// at a geodesic distance of at most the threshold. `unreachable` is "strict" (points without a path never match) or
/// "paper" (they always match, as in the released code). Raises ValueError for arrays that cannot be used.
#[pyfunction]
#[pyo3(signature = (points, ground_truth, found, thresholds, unreachable="strict"))]
pub fn semantic_counts<'py>(
    points: &Bound<'py, PyAny>,
    ground_truth: &Bound<'py, PyAny>,
    found: &Bound<'py, PyAny>,
    thresholds: &Bound<'py, PyAny>,
    unreachable: &str,
) -> PyResult<Counts<'py>> {
    let known = [("strict", Unreachable::Strict), ("paper", Unreachable::PaperCompatible)];
    let unreachable = named("unreachable", unreachable, known)?;
    let (py, points, found) = (points.py(), arrays::points("points", points)?, arrays::points("found", found)?);
    let (truth, limits) = (indices("ground_truth", ground_truth)?, self::thresholds("thresholds", thresholds)?);
    let counts = threads::run(py, || core::semantic_counts(&points, &truth, &found, &limits, unreachable))?;
    counts_array(py, counts)
}

/// Intersection over union (T,) float64 of counts (T, 3) as `semantic_counts` gives them: (NP - FN) / (NP + FP).
/// Raises ValueError for an array that cannot be used.
#[pyfunction]
pub fn iou<'py>(counts: &Bound<'py, PyAny>) -> PyResult<Numbers<'py>> {
    let rows = counts_from(numbers("counts", "whole numbers, 0 or more, of shape (T, 3)", counts)?);
    Ok(arrays::values(counts.py(), rows.iter().map(MatchCounts::iou).collect()))
}

fn smpl_protocol(protocol: &str, seed: u64) -> PyResult<SmplProtocol> {
    named("protocol", protocol, [("strict", SmplProtocol::Strict), ("paper", SmplProtocol::PaperCompatible { seed })])
}

/// The SMPL counts of one pair of bodies: (T, 3) int64 as `semantic_counts` gives them.
///
/// `body_1` and `body_2` (N, 3) are the same samples of a surface in two poses, `keypoints_1` and `keypoints_2` (K, 3)
/// come best first; the best 20 are brought to their nearest samples. A keypoint carried to the other body matches one
/// of its keypoints at most the threshold away. `protocol` "paper" fills up to 20 with random samples, by `seed`;
/// "strict" does not. Raises ValueError for arrays that cannot be used.
#[pyfunction]
#[pyo3(signature = (body_1, body_2, keypoints_1, keypoints_2, thresholds, protocol="strict", seed=0))]
pub fn smpl_pair_counts<'py>(
    body_1: &Bound<'py, PyAny>,
    body_2: &Bound<'py, PyAny>,
    keypoints_1: &Bound<'py, PyAny>,
    keypoints_2: &Bound<'py, PyAny>,
    thresholds: &Bound<'py, PyAny>,
    protocol: &str,
    seed: u64,
) -> PyResult<Counts<'py>> {
    let py = body_1.py();
    let protocol = smpl_protocol(protocol, seed)?;
    let bodies = (arrays::points("body_1", body_1)?, arrays::points("body_2", body_2)?);
    let found = (arrays::points("keypoints_1", keypoints_1)?, arrays::points("keypoints_2", keypoints_2)?);
    let limits = self::thresholds("thresholds", thresholds)?;
    let work = || core::smpl_pair_counts(&bodies.0, &bodies.1, &found.0, &found.1, &limits, protocol);
    counts_array(py, threads::run(py, work)?)
}

/// The SMPL figure at one threshold from the pairs' counts (P, 3), in order: the mean IoU of the pairs ("strict"), or
/// the mean of the running IoU after each pair ("paper", as in the released code). Raises ValueError for an array that
/// cannot be used.
#[pyfunction]
#[pyo3(signature = (counts, protocol="strict"))]
pub fn smpl_iou(counts: &Bound<PyAny>, protocol: &str) -> PyResult<f64> {
    let pairs = counts_from(numbers("counts", "whole numbers, 0 or more, of shape (P, 3)", counts)?);
    core::smpl_iou(&pairs, smpl_protocol(protocol, 0)?).map_err(py_error)
}

/// The share of correspondences, row i of `source` (N, 3) and of `target` (N, 3), that `t_target_source` (4, 4) brings
/// nearer than `threshold`, in cloud units; 0 without any. Raises ValueError for arrays that cannot be used.
#[pyfunction]
#[pyo3(signature = (source, target, t_target_source, threshold=0.1))]
pub fn inlier_ratio(
    source: &Bound<PyAny>,
    target: &Bound<PyAny>,
    t_target_source: &Bound<PyAny>,
    threshold: f64,
) -> PyResult<f64> {
    let (source, target) = (arrays::points("source", source)?, arrays::points("target", target)?);
    core::inlier_ratio(&source, &target, &transform("t_target_source", t_target_source)?, threshold).map_err(py_error)
}

/// The share of pairs whose inlier ratio (P,) is above `threshold`; 3DMatch averages it over scenes. Raises ValueError
/// without pairs.
#[pyfunction]
#[pyo3(signature = (inlier_ratios, threshold=0.05))]
pub fn feature_matching_recall(inlier_ratios: &Bound<PyAny>, threshold: f64) -> PyResult<f64> {
    core::feature_matching_recall(&thresholds("inlier_ratios", inlier_ratios)?, threshold).map_err(py_error)
}

/// Mean squared distance, in square units, by which `t_estimate` (4, 4) misplaces the overlap of a pair, to first order,
/// from the information matrix (6, 6) of 3DMatch's `gt.info`. Raises ValueError for arrays that cannot be used.
#[pyfunction]
pub fn squared_registration_error(
    t_gt: &Bound<PyAny>,
    t_estimate: &Bound<PyAny>,
    information: &Bound<PyAny>,
) -> PyResult<f64> {
    let (t_gt, t_estimate) = (transform("t_gt", t_gt)?, transform("t_estimate", t_estimate)?);
    let information = numbers("information", "numbers of shape (6, 6)", information)?;
    core::squared_registration_error(&t_gt, &t_estimate, &information).map_err(py_error)
}

/// The information matrix (6, 6) float64 of a pair, as `gt.info` has it, from the source's points (N, 3) that have a
/// partner in the target. Raises ValueError for an array that cannot be used.
#[pyfunction]
pub fn information_matrix<'py>(points: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let information = core::information_matrix(&arrays::points("points", points)?).map_err(py_error)?;
    PyArray1::from_vec(points.py(), information.concat()).reshape([6, 6])
}

/// Registration recall of one scene by 3DMatch's rules: the share of pairs, consecutive fragments left out, whose
/// squared error is at most `threshold` squared. `fragments` (P, 2) are the pairs' numbers within the scene;
/// `squared_errors` (P,) are inf where no transform was found. Raises ValueError for arrays that cannot be used.
#[pyfunction]
#[pyo3(signature = (fragments, squared_errors, threshold=0.2))]
pub fn registration_recall(fragments: &Bound<PyAny>, squared_errors: &Bound<PyAny>, threshold: f64) -> PyResult<f64> {
    let fragments: Vec<[usize; 2]> = numbers("fragments", "whole numbers, 0 or more, of shape (P, 2)", fragments)?;
    let errors = thresholds("squared_errors", squared_errors)?;
    if errors.len() != fragments.len() {
        let message =
            format!("squared_errors: expected one for each of {} pairs, found {}", fragments.len(), errors.len());
        return Err(PyValueError::new_err(message));
    }
    let outcome =
        |([first, second], error): ([usize; 2], f64)| RegistrationOutcome { first, second, squared_error: Some(error) };
    let outcomes: Vec<_> = fragments.into_iter().zip(errors).map(outcome).collect();
    core::registration_recall(&outcomes, threshold).map_err(py_error)
}

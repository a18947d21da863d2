//! `snake_rs.metrics`.

use numpy::{PyArray1, PyArray2, PyArrayDyn, PyArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use snake_core::RigidTransform;
use snake_eval::{self as core, MatchCounts, RegistrationOutcome, SmplProtocol, Unreachable};

use crate::arrays::{self, named};
use crate::error::{py_error, value_error};
use crate::threads;

/// One number for each threshold, in the shape of the thresholds.
type Numbers<'py> = Bound<'py, PyArrayDyn<f64>>;
/// Rows of ground truth, false positives and false negatives.
type Counts<'py> = Bound<'py, PyArray2<i64>>;

/// Computes repeatability from the keypoints of two views, the transform between them, and thresholds.
type Repeatability = fn(&[[f64; 3]], &[[f64; 3]], &RigidTransform, &[f64]) -> snake_core::Result<Vec<f64>>;

/// Converts an array-like of numbers to a Rust type.
fn numbers<T>(what: &str, expected: &str, value: &Bound<PyAny>) -> PyResult<T>
where
    T: for<'a, 'py> FromPyObject<'a, 'py>,
{
    let list = value.py().import("numpy")?.call_method1("asarray", (value,))?.call_method0("tolist")?;
    list.extract().map_err(|_| value_error(&format!("{what}: expected {expected}, found {value}")))
}

pub fn transform(what: &str, value: &Bound<PyAny>) -> PyResult<RigidTransform> {
    let rows = numbers(what, "a transform of shape (4, 4)", value)?;
    RigidTransform::from_matrix(rows).map_err(|error| match error {
        snake_geometry::Error::Input { reason, .. } => PyValueError::new_err(format!("{what}: {reason}")),
        other => py_error(other),
    })
}

/// Thresholds: numbers of shape (T,), or one number.
fn thresholds(what: &str, value: &Bound<PyAny>) -> PyResult<Vec<f64>> {
    match value.extract() {
        Ok(one) => Ok(vec![one]),
        Err(_) => numbers(what, "numbers of shape (T,), or one number", value),
    }
}

fn indices(what: &str, value: &Bound<PyAny>) -> PyResult<Vec<usize>> {
    numbers(what, "indices of shape (K,)", value)
}

fn counts_array(py: Python<'_>, counts: Vec<MatchCounts>) -> PyResult<Counts<'_>> {
    let row = |c: &MatchCounts| [c.ground_truth as i64, c.false_positives as i64, c.false_negatives as i64];
    let flat: Vec<i64> = counts.iter().flat_map(row).collect();
    PyArray1::from_vec(py, flat).reshape([counts.len(), 3])
}

fn counts_from(counts: &Bound<PyAny>) -> PyResult<Vec<MatchCounts>> {
    let rows: Vec<[u32; 3]> = numbers("counts", "whole numbers, 0 or more, of shape (T, 3) and below 2^32", counts)?;
    if let Some([truth, _, missed]) = rows.iter().find(|[truth, _, missed]| missed > truth) {
        let reason = format!("counts: {missed} false negatives of {truth} keypoints of the ground truth");
        return Err(PyValueError::new_err(reason));
    }
    let counts = |row: [u32; 3]| {
        let [ground_truth, false_positives, false_negatives] = row.map(|count| count as usize);
        MatchCounts { ground_truth, false_positives, false_negatives }
    };
    Ok(rows.into_iter().map(counts).collect())
}

/// Converts the arguments of a variant of repeatability and calls it.
fn repeatability<'py>(
    keypoints: [&Bound<'py, PyAny>; 2],
    t_1_2: &Bound<'py, PyAny>,
    epsilon: &Bound<'py, PyAny>,
    of: Repeatability,
) -> PyResult<Numbers<'py>> {
    let py = t_1_2.py();
    let [first, second] = [("keypoints_1", keypoints[0]), ("keypoints_2", keypoints[1])];
    let (first, second) = (arrays::positions(first.0, first.1)?, arrays::positions(second.0, second.1)?);
    let (t_1_2, limits) = (transform("t_1_2", t_1_2)?, thresholds("epsilon", epsilon)?);
    let shares = threads::run(py, || of(&first, &second, &t_1_2, &limits))?;
    let is_one = epsilon.extract::<f64>().is_ok();
    let shape = if is_one { vec![] } else { vec![shares.len()] };
    PyArray1::from_vec(py, shares).reshape(shape)
}

/// Relative repeatability (SNAKE section 4.2, USIP): (T,) float64, the share of repeated keypoints for each `epsilon`
/// (T,); for one number it is an array without dimensions, which is a number.
///
/// A keypoint of view 1 (K, 3) is repeated if it is nearer than `epsilon` to a keypoint of view 2 (L, 3) that `t_1_2`
/// (4, 4) maps to view 1. The measure has one direction, is not one-to-one and does not test for overlap. A view
/// without keypoints gives 0. Raises ValueError for invalid arrays.
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

/// Mean distance from each point (N, 3) to its nearest keypoint (K, 3), in cloud units. It measures how well the
/// keypoints cover the cloud. Raises ValueError for invalid arrays.
#[pyfunction]
pub fn mean_distance_to_keypoints(points: &Bound<PyAny>, keypoints: &Bound<PyAny>) -> PyResult<f64> {
    let py = points.py();
    let (points, keypoints) = (arrays::positions("points", points)?, arrays::positions("keypoints", keypoints)?);
    threads::run(py, || core::mean_distance_to_keypoints(&points, &keypoints))
}

/// Geodesic distances (S, N) float64 from the points with the indices `sources` (S,) to all `points` (N, 3), in cloud
/// units. They are shortest paths in the undirected graph of each point's `neighbors` nearest points, and inf where
/// there is no path. Raises ValueError for invalid arrays.
#[pyfunction]
#[pyo3(signature = (points, sources, neighbors=20))]
pub fn geodesic_distances<'py>(
    points: &Bound<'py, PyAny>,
    sources: &Bound<'py, PyAny>,
    neighbors: usize,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let (py, points, sources) = (points.py(), arrays::positions("points", points)?, indices("sources", sources)?);
    let rows =
        threads::run_with_signals(py, |control| core::geodesic_distances_with(&points, &sources, neighbors, control))?;
    PyArray1::from_vec(py, rows.concat()).reshape([sources.len(), points.len()])
}

/// KeypointNet's match counts for one shape (SNAKE section 4.1): (T, 3) int64. Each row has the numbers of ground-truth
/// keypoints, false positives and false negatives at one of the `thresholds` (T,). Add the counts of all shapes of a
/// class before `iou`.
///
/// `ground_truth` are indices (G,) into `points` (N, 3). `found` (K, 3) are keypoints, which are snapped to their
/// nearest points. Two keypoints match if their geodesic distance is at most the threshold. `unreachable` is "strict"
/// (points without a path never match) or "paper" (they always match, as in the released code). Raises ValueError for
/// invalid arrays.
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
    let (py, [points, found]) = (points.py(), arrays::in_one_frame([("points", points), ("found", found)])?);
    let (truth, limits) = (indices("ground_truth", ground_truth)?, self::thresholds("thresholds", thresholds)?);
    let counts = threads::run(py, || core::semantic_counts(&points, &truth, &found, &limits, unreachable))?;
    counts_array(py, counts)
}

/// Intersection over union (T,) float64 from the counts (T, 3) of `semantic_counts`: (NP - FN) / (NP + FP).
/// Raises ValueError for an invalid array.
#[pyfunction]
pub fn iou<'py>(counts: &Bound<'py, PyAny>) -> PyResult<Numbers<'py>> {
    let rows = counts_from(counts)?;
    PyArray1::from_vec(counts.py(), rows.iter().map(MatchCounts::iou).collect()).reshape(vec![rows.len()])
}

fn smpl_protocol(protocol: &str, seed: u64) -> PyResult<SmplProtocol> {
    named("protocol", protocol, [("strict", SmplProtocol::Strict), ("paper", SmplProtocol::PaperCompatible { seed })])
}

/// The match counts of one pair of SMPL bodies: (T, 3) int64, as in `semantic_counts`.
///
/// `body_1` and `body_2` (N, 3) are the same samples of a surface in two poses. `keypoints_1` and `keypoints_2` (K, 3)
/// come best first, and the best 20 are snapped to their nearest samples. A keypoint is transferred to the other body
/// and matches a keypoint there at a distance of at most the threshold. `protocol` "paper" adds random samples up to 20
/// keypoints, determined by `seed`; "strict" does not. Raises ValueError for invalid arrays.
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
    let [body_1, found_1] = arrays::in_one_frame([("body_1", body_1), ("keypoints_1", keypoints_1)])?;
    let [body_2, found_2] = arrays::in_one_frame([("body_2", body_2), ("keypoints_2", keypoints_2)])?;
    let limits = self::thresholds("thresholds", thresholds)?;
    let work = || core::smpl_pair_counts(&body_1, &body_2, &found_1, &found_2, &limits, protocol);
    counts_array(py, threads::run(py, work)?)
}

/// The mIoU on SMPL at one threshold, from the counts (P, 3) of the pairs in order. `protocol` "strict" is the mean IoU
/// of the pairs. "paper" is the mean of the running IoU after each pair, as in the released code. Raises ValueError for
/// an invalid array.
#[pyfunction]
#[pyo3(signature = (counts, protocol="strict"))]
pub fn smpl_iou(counts: &Bound<PyAny>, protocol: &str) -> PyResult<f64> {
    let pairs = counts_from(counts)?;
    core::smpl_iou(&pairs, smpl_protocol(protocol, 0)?).map_err(py_error)
}

/// The share of correspondences that are inliers of `t_target_source` (4, 4); 0 without correspondences. Row i of
/// `source` (N, 3) and row i of `target` (N, 3) correspond. They are an inlier if the transformed source point is
/// nearer than `threshold`, in cloud units, to the target point. Raises ValueError for invalid arrays.
#[pyfunction]
#[pyo3(signature = (source, target, t_target_source, threshold=0.1))]
pub fn inlier_ratio(
    source: &Bound<PyAny>,
    target: &Bound<PyAny>,
    t_target_source: &Bound<PyAny>,
    threshold: f64,
) -> PyResult<f64> {
    let (source, target) = (arrays::positions("source", source)?, arrays::positions("target", target)?);
    core::inlier_ratio(&source, &target, &transform("t_target_source", t_target_source)?, threshold).map_err(py_error)
}

/// The share of pairs with an inlier ratio (P,) above `threshold`. 3DMatch averages it over scenes. Raises ValueError
/// if there are no pairs.
#[pyfunction]
#[pyo3(signature = (inlier_ratios, threshold=0.05))]
pub fn feature_matching_recall(inlier_ratios: &Bound<PyAny>, threshold: f64) -> PyResult<f64> {
    core::feature_matching_recall(&thresholds("inlier_ratios", inlier_ratios)?, threshold).map_err(py_error)
}

/// Mean squared error of the overlapping points of a pair under `t_estimate` (4, 4), in square units, relative to
/// `t_gt` (4, 4). It is a first-order approximation from the information matrix (6, 6) of 3DMatch's `gt.info`. Raises
/// ValueError for invalid arrays.
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

/// The information matrix (6, 6) float64 of a pair, as in `gt.info`. `points` (N, 3) are the source points that have a
/// partner in the target. Raises ValueError for an invalid array.
#[pyfunction]
pub fn information_matrix<'py>(points: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let information = core::information_matrix(&arrays::positions("points", points)?).map_err(py_error)?;
    PyArray1::from_vec(points.py(), information.concat()).reshape([6, 6])
}

/// Registration recall of one scene by the rules of 3DMatch: the share of pairs with a squared error of at most
/// `threshold` squared. Pairs of consecutive fragments are left out. `fragments` (P, 2) are the numbers of the
/// fragments within the scene. `squared_errors` (P,) are inf where no transform was found. Raises ValueError for
/// invalid arrays.
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

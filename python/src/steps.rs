//! `snake_rs.steps`.

use numpy::ndarray::ArrayView4;
use numpy::{
    PyArray, PyArray1, PyArray2, PyArray4, PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn, PyUntypedArrayMethods,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use snake_core::steps::{self, Quantity};
use snake_core::{DetectOptions, Point, RefineMethod};
use snake_geometry::{check_points, suppress as suppress_scored};

use crate::arrays;
use crate::error::py_error;
use crate::model::Model;
use crate::threads;

/// Values (Q,), derivatives (Q, 3) and derivatives (Q, c_dim).
type Decoded<'py> = (Bound<'py, PyArray1<f32>>, Bound<'py, PyArray2<f32>>, Bound<'py, PyArray2<f32>>);

/// The values of an array of real numbers with the given shape, in C order, and its shape. A length of -1 fits any length.
fn values(what: &str, value: &Bound<PyAny>, shape: &[isize]) -> PyResult<(Vec<f32>, Vec<usize>)> {
    let numpy = value.py().import("numpy")?;
    let converted = || -> PyResult<PyReadonlyArrayDyn<f32>> {
        Ok(numpy.call_method1("require", (value, "float32", "CA"))?.cast_into::<PyArrayDyn<f32>>()?.try_readonly()?)
    };
    let array = converted().map_err(|_| PyValueError::new_err(format!("{what}: expected real numbers")))?;
    let fits = array.ndim() == shape.len()
        && array.shape().iter().zip(shape).all(|(&length, &wanted)| wanted < 0 || length as isize == wanted);
    if !fits {
        let wanted: Vec<String> =
            shape.iter().map(|&length| if length < 0 { "any".into() } else { length.to_string() }).collect();
        let reason = format!("{what}: expected the shape ({}), found {:?}", wanted.join(", "), array.shape());
        return Err(PyValueError::new_err(reason));
    }
    Ok((array.as_slice()?.to_vec(), array.shape().to_vec()))
}

/// Converts a volume (C, D, H, W) to channels last.
fn volume(value: &Bound<PyAny>) -> PyResult<Vec<f32>> {
    let numpy = value.py().import("numpy")?;
    let array = numpy.call_method1("asarray", (value,))?;
    if array.getattr("ndim")?.extract::<usize>()? != 4 {
        let reason = format!("volume: expected the shape (C, D, H, W), found {}", array.getattr("shape")?);
        return Err(PyValueError::new_err(reason));
    }
    Ok(values("volume", &numpy.call_method1("moveaxis", (array, 0, -1))?, &[-1; 4])?.0)
}

/// Voxel aggregation of a model: the volume (C, D, H, W) float32 of `features` (N, C) of `points` (N, 3), with D, H and W along
/// z, y and x. A voxel holds the mean of the features of its own points, or of those around it with their trilinear weights
/// (`model.config["scatter"]` "hard" and "soft"); 0 without points.
///
/// Points are in the network's frame, the cube ±0.5. Raises ValueError for a model of scenes, for points that are not finite,
/// and for arrays that do not fit.
#[pyfunction]
pub fn aggregate<'py>(
    model: &Bound<'py, Model>,
    points: &Bound<'py, PyAny>,
    features: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyArray4<f32>>> {
    let (py, core) = (points.py(), model.get().core());
    let points = arrays::points("points", points)?;
    let (features, shape) = values("features", features, &[points.len() as isize, -1])?;
    let flat = threads::run(py, || steps::aggregate(core, &points, &features))?;
    let [x, y, z] = core.config().frame().map_or([0; 3], |frame| frame.resolution);
    let view = ArrayView4::from_shape([z, y, x, shape[1]], &flat).map_err(|e| PyValueError::new_err(e.to_string()))?;
    Ok(PyArray::from_array(py, &view.permuted_axes([3, 0, 1, 2])))
}

/// Trilinear sampling: the features (Q, C) float32 of a `volume` (C, D, H, W) in the model's frame at `queries` (Q, 3).
///
/// Queries are in the network's frame. The centres of the outer voxels lie on the faces of the volume, and queries beyond them
/// are clamped. Raises ValueError for a model of scenes, for queries that are not finite, and for a volume of another size.
#[pyfunction]
pub fn interpolate<'py>(
    model: &Bound<'py, Model>,
    volume: &Bound<'py, PyAny>,
    queries: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyArray2<f32>>> {
    let (py, core) = (queries.py(), model.get().core());
    let (volume, queries) = (self::volume(volume)?, arrays::points("queries", queries)?);
    let flat = threads::run(py, || steps::interpolate(core, &volume, &queries))?;
    let channels = flat.len() / queries.len();
    arrays::rows(py, flat, channels)
}

/// The gradient of `interpolate`: derivatives (Q, 3) float32, per network unit, of the sum over the channels of `in_features`
/// (Q, C) times the interpolated features. It is 0 along axes where a query is clamped. Raises ValueError as `interpolate` does.
#[pyfunction]
pub fn interpolate_gradient<'py>(
    model: &Bound<'py, Model>,
    volume: &Bound<'py, PyAny>,
    queries: &Bound<'py, PyAny>,
    in_features: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyArray2<f32>>> {
    let (py, core) = (queries.py(), model.get().core());
    let (volume, queries) = (self::volume(volume)?, arrays::points("queries", queries)?);
    let (in_features, _) = values("in_features", in_features, &[queries.len() as isize, -1])?;
    let gradients = threads::run(py, || steps::interpolate_gradient(core, &volume, &queries, &in_features))?;
    arrays::rows(py, gradients.into_flattened(), 3)
}

/// Decodes `features` (Q, c_dim) at `queries` (Q, 3) to the `quantity`, "occupancy" or "saliency": the probabilities (Q,), their
/// derivatives (Q, 3) with respect to the query at a constant feature, per network unit, and their derivatives (Q, c_dim) with
/// respect to the feature, all float32.
///
/// Queries are in the network's frame. Raises ValueError for another quantity, for queries that are not finite, and for arrays
/// that do not fit.
#[pyfunction]
pub fn decode<'py>(
    model: &Bound<'py, Model>,
    quantity: &str,
    queries: &Bound<'py, PyAny>,
    features: &Bound<'py, PyAny>,
) -> PyResult<Decoded<'py>> {
    let known = [("occupancy", Quantity::Occupancy), ("saliency", Quantity::Saliency)];
    let quantity = arrays::named("quantity", quantity, known)?;
    let (py, core) = (queries.py(), model.get().core());
    let queries = arrays::points("queries", queries)?;
    let (features, _) = values("features", features, &[queries.len() as isize, core.config().c_dim as isize])?;
    let decoded = threads::run(py, || steps::decode(core, quantity, &queries, &features))?;
    let in_queries = arrays::rows(py, decoded.in_queries.into_flattened(), 3)?;
    let in_features = arrays::rows(py, decoded.in_features, core.config().c_dim)?;
    Ok((arrays::values(py, decoded.values), in_queries, in_features))
}

/// Refinement: the positions (Q, 3) float32 of `queries` (Q, 3) after a step up each of the `gradients` (S, Q, 3) of their
/// saliency. With S = 1 it is a single step.
///
/// `method` is "adam", which climbs the mean saliency of the queries, or "gradient-descent", by which each query climbs its own.
/// Queries, gradients and `step_size` are in units of the network. Raises ValueError for another method, for queries that are
/// not finite, and for arrays that do not fit.
#[pyfunction]
#[pyo3(signature = (queries, gradients, method="adam", step_size=0.001))]
pub fn refine<'py>(
    queries: &Bound<'py, PyAny>,
    gradients: &Bound<'py, PyAny>,
    method: &str,
    step_size: f32,
) -> PyResult<Bound<'py, PyArray2<f32>>> {
    let known = [("adam", RefineMethod::Adam), ("gradient-descent", RefineMethod::GradientDescent)];
    let options = DetectOptions::default()
        .with_refine_method(arrays::named("method", method, known)?)
        .with_refine_step_size(step_size);
    let (py, queries) = (queries.py(), arrays::points("queries", queries)?);
    let (gradients, _) = values("gradients", gradients, &[-1, queries.len() as isize, 3])?;
    let rows: &[Point] = gradients.as_chunks().0;
    let by_step: Vec<Vec<Point>> = rows.chunks(queries.len().max(1)).map(<[Point]>::to_vec).collect();
    let positions = threads::run(py, || steps::refine(&queries, &by_step, &options))?;
    arrays::rows(py, positions.into_flattened(), 3)
}

/// Greedy non-maximum suppression: indices (K,) int64 of the kept `points` (N, 3), by falling `scores` (N,) and, for equal
/// scores, by rising index. Each is farther than `radius`, in units of the points, from all kept before it; 0 suppresses none. At
/// most `max_keypoints` are kept; None is no limit.
///
/// Raises ValueError for points or scores that are not finite, for another number of scores, and for a negative radius.
#[pyfunction]
#[pyo3(signature = (points, scores, radius, max_keypoints=None))]
pub fn suppress<'py>(
    points: &Bound<'py, PyAny>,
    scores: &Bound<'py, PyAny>,
    radius: f32,
    max_keypoints: Option<usize>,
) -> PyResult<Bound<'py, PyArray1<i64>>> {
    let (py, points) = (points.py(), arrays::points("points", points)?);
    let (scores, _) = values("scores", scores, &[points.len() as isize])?;
    if !points.is_empty() {
        check_points("points", &points).map_err(py_error)?;
    }
    if scores.iter().any(|score| !score.is_finite()) {
        return Err(PyValueError::new_err("scores: a score is not finite"));
    }
    if !(0.0..=f32::MAX).contains(&radius) {
        return Err(PyValueError::new_err(format!("option `radius` is {radius}: allowed is 0 or more")));
    }
    let most = max_keypoints.unwrap_or(usize::MAX);
    let kept = threads::run(py, || Ok(suppress_scored(&points, &scores, radius, most)?.to_vec()))?;
    Ok(arrays::values(py, kept.into_iter().map(|index| index as i64).collect()))
}

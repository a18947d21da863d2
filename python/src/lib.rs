//! The private module `snake_rs._core`: snake-core for Python. A thin shell that checks and copies arrays, releases the
//! GIL and calls the core; it computes nothing.

mod arrays;
mod baselines;
mod error;
mod field;
mod io;
mod keypoints;
mod mesh;
mod metrics;
mod model;
mod options;
mod registration;
mod threads;

use pyo3::prelude::*;
use pyo3::types::PyDict;
use snake_core::Cloud;

use field::Field;
use io::read_points;
use keypoints::Keypoints;
use mesh::Mesh;
use model::Model;
use registration::{Registration, estimate_normals, fpfh, register};
use threads::{get_num_threads, set_num_threads};

/// Keypoints of a cloud in one call: `model.encode(points).detect()`, with the built-in model if none is given.
///
/// `points` is (N, 3) real numbers, or more columns of which the first three count: a numpy array, a torch tensor on the
/// CPU, an Open3D or trimesh point cloud, or anything else that numpy takes for such an array. It is copied as float32,
/// relative to an origin where it is far from zero, so that float64 coordinates of georeferenced scans keep their digits;
/// positions come back as float32 if the points are float32 or float16, else as float64. Points that are not finite or
/// are masked are skipped (`Keypoints.num_skipped`), but `nearest_index` counts them. `options` are those of `Model.encode` and `Field.detect`,
/// and `window_radius` (look through balls of this radius that cover the cloud, each encoded by itself, in cloud units or
/// as in "40r" in multiples of its resolution; None: the whole cloud at once, in which details of a room are lost); what is not given comes from `preset`, or else from `model.recommended`. Raises ValueError for an array or a value
/// that cannot be used, and TypeError for an unknown option.
#[pyfunction]
#[pyo3(signature = (points, model=None, **options))]
fn detect(
    py: Python<'_>,
    points: &Bound<'_, PyAny>,
    model: Option<&Bound<'_, Model>>,
    options: Option<&Bound<'_, PyDict>>,
) -> PyResult<Keypoints> {
    let model = model::given_or_builtin(py, model)?;
    let preset = options::resolve("detect", &options::ALL, model.recommended(), options)?;
    let (cloud, precision) = arrays::cloud("points", points)?;
    let Cloud { points, origin } = cloud.for_normalization(preset.encode.normalization);
    let detection = threads::run_with_signals(py, |control| model.detect_with(&points, &preset, control))?;
    Keypoints::from_detection(py, detection, origin, precision)
}

#[pymodule]
mod _core {
    #[pymodule_export]
    use super::baselines::{farthest_points, harris3d, iss, random_points, sift3d};
    #[pymodule_export]
    use super::metrics::{
        feature_matching_recall, geodesic_distances, information_matrix, inlier_ratio, iou, mean_distance_to_keypoints,
        registration_recall, relative_repeatability, semantic_counts, smpl_iou, smpl_pair_counts,
        squared_registration_error, symmetric_repeatability,
    };
    #[pymodule_export]
    use super::{
        Field, Keypoints, Mesh, Model, Registration, detect, estimate_normals, fpfh, get_num_threads, read_points,
        register, set_num_threads,
    };

    #[pymodule_export]
    #[expect(non_upper_case_globals, reason = "Python's name for it")]
    const __version__: &str = env!("CARGO_PKG_VERSION");
}

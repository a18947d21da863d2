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

/// Detects the keypoints of a cloud in one call: `model.encode(points).detect()`. `model` defaults to the built-in
/// model.
///
/// `points` (N, 3) are real numbers; additional columns are ignored. They can be a numpy array, a torch tensor on the
/// CPU, an Open3D or trimesh point cloud, or any other value that numpy converts to such an array. They are copied as
/// float32. Coordinates far from zero are copied relative to an origin, so that georeferenced scans in float64 keep
/// their digits. Positions are returned as float32 if the points are float32 or float16, else as float64. Masked points
/// and points that are not finite are skipped (`Keypoints.num_skipped`), but `nearest_index` counts them.
///
/// `options` are the options of `Model.encode` and `Field.detect`, and `window_radius`. With `window_radius` the cloud
/// is split into overlapping balls of that radius, and each ball is encoded separately. It is in cloud units, or text
/// such as "40r" in multiples of the cloud's resolution. None encodes the whole cloud at once, which loses the details
/// of a room. Options default to the values of `preset`, or else of `model.recommended`. Raises ValueError for an
/// invalid array or value, and TypeError for an unknown option.
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
    use super::baselines::{farthest_points, harris3d, iss, random_points, sift3d, surface_variation};
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

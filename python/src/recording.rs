//! `snake_rs.read_recording`.

use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

use pyo3::prelude::*;

use crate::arrays::{Positions, Precision};
use crate::error::py_error;

/// Reads the point clouds of a recording, one after another: an iterator of `RecordedCloud`.
///
/// `path` is an MCAP file. The clouds are messages `PointCloud2` of ROS 2 or ROS 1. `topic` is their topic, such as "/points";
/// None takes the only topic with point clouds. Only one cloud is in memory at a time:
///
///     for cloud in snake_rs.read_recording("drive.mcap", topic="/points"):
///         keypoints = snake_rs.detect(cloud)
///
/// Raises OSError when the file cannot be read. Raises ValueError when it is no recording, when the topic has no point clouds,
/// or when no topic is given and several have some; the iterator raises ValueError for a message that is damaged or compressed.
#[pyfunction]
#[pyo3(signature = (path, topic=None))]
pub fn read_recording(py: Python<'_>, path: PathBuf, topic: Option<String>) -> PyResult<Recording> {
    let clouds = py.detach(|| snake_io::read_recording(&path, topic.as_deref())).map_err(py_error)?;
    Ok(Recording { topic: clouds.topic().to_owned(), clouds: Mutex::new(clouds) })
}

/// The point clouds of a recording, an iterator; made by `read_recording`.
#[pyclass(frozen, module = "snake_rs")]
pub struct Recording {
    /// The topic of the clouds.
    #[pyo3(get)]
    topic: String,
    clouds: Mutex<snake_io::Recording>,
}

#[pymethods]
impl Recording {
    fn __iter__(slf: PyRef<'_, Self>) -> PyRef<'_, Self> {
        slf
    }

    fn __next__(&self, py: Python<'_>) -> PyResult<Option<RecordedCloud>> {
        let next = py.detach(|| self.clouds.lock().unwrap_or_else(PoisonError::into_inner).next());
        next.map(|cloud| RecordedCloud::new(py, cloud.map_err(py_error)?)).transpose()
    }

    fn __repr__(&self) -> String {
        format!("Recording(topic {})", self.topic)
    }
}

/// A point cloud of a recording. Functions that take points also take it.
#[pyclass(frozen, get_all, module = "snake_rs")]
pub struct RecordedCloud {
    /// The time at which it was recorded, in nanoseconds since 1970.
    log_time: u64,
    /// The frame that the message names.
    frame_id: String,
    /// Points (N, 3), in the order of the message, with those that are not finite: float32, or float64 if they are so far from
    /// zero that float32 would lose digits.
    points: Positions,
}

impl RecordedCloud {
    fn new(py: Python<'_>, recorded: snake_io::RecordedCloud) -> PyResult<Self> {
        let snake_io::RecordedCloud { log_time, frame_id, cloud } = recorded;
        let precision = if cloud.origin == [0.0; 3] { Precision::Single } else { Precision::Double };
        Ok(Self { log_time, frame_id, points: Positions::new(py, &cloud.points, cloud.origin, precision)? })
    }
}

#[pymethods]
impl RecordedCloud {
    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        let num_points = self.points.bind(py).len()?;
        Ok(format!("RecordedCloud({num_points} points, log_time {}, frame_id {})", self.log_time, self.frame_id))
    }
}

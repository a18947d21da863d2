//! The cloud to which keypoints belong.

use std::path::Path;

use crate::crs::Crs;

/// The description of a keypoint file's cloud.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct KeypointSource {
    /// Added to the positions, see [`Cloud::origin`](snake_geometry::Cloud::origin).
    pub origin: [f64; 3],
    /// Class of the shape, for KeypointNet annotations.
    pub class_id: String,
    /// Name of the shape, for KeypointNet annotations.
    pub model_id: String,
    /// The coordinate reference system, which is written to LAZ files.
    pub crs: Option<Crs>,
}

impl KeypointSource {
    /// Takes class and name from the path of the cloud's file, which is `CLASS_ID/MODEL_ID.pcd` in KeypointNet.
    pub fn new(path: &Path, origin: [f64; 3]) -> Self {
        let text = |part: Option<&std::ffi::OsStr>| part.unwrap_or_default().to_string_lossy().into_owned();
        Self {
            origin,
            class_id: text(path.parent().and_then(Path::file_name)),
            model_id: text(path.file_stem()),
            ..Self::default()
        }
    }
}

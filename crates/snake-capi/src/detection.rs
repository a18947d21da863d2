//! Detection of keypoints.

use std::ffi::c_char;

use snake_core::Keypoint;

use crate::arguments::{SnakeCloud, check_output, input, options as parse_options};
use crate::model::{SnakeModel, free};
use crate::status::{SnakeStatus, guarded};
use crate::threads::run;

/// A keypoint, in the frame and units of the cloud.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SnakeKeypoint {
    /// x, y and z.
    pub position: [f32; 3],
    /// Saliency, 0 to 1; the score that keypoints are ranked by.
    pub saliency: f32,
    /// Occupancy at the position, 0 to 1.
    pub occupancy: f32,
    /// Index of the nearest point of the cloud, of all its points.
    pub nearest_index: usize,
    /// Probability that another view finds it again, 0 to 1; NaN if the model has no map of confidences.
    pub confidence: f32,
}

impl From<&Keypoint> for SnakeKeypoint {
    fn from(keypoint: &Keypoint) -> Self {
        let Keypoint { position, saliency, occupancy, nearest_index, confidence } = *keypoint;
        Self { position, saliency, occupancy, nearest_index, confidence: confidence.unwrap_or(f32::NAN) }
    }
}

/// The keypoints of a cloud.
pub struct SnakeDetection {
    keypoints: Vec<SnakeKeypoint>,
}

/// Detects the keypoints of a cloud. Points that are not finite, and a few that are much farther than all others, are left out.
/// A cloud without finite points is an error.
///
/// `options` is null for what the model recommends, or a JSON object of values that replace those, such as
/// `{"max_keypoints": 20, "nms_radius": "3r"}`. `*detection` is null after an error.
///
/// # Safety
/// `model` is null or a model that is not freed yet; `cloud` has as many points as it says; `options` is null or a text
/// that ends with a zero; `detection` is null or valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn snake_detect(
    model: *const SnakeModel,
    cloud: SnakeCloud,
    options: *const c_char,
    detection: *mut *mut SnakeDetection,
) -> SnakeStatus {
    guarded(|| {
        check_output("detection", detection)?;
        // SAFETY: the place is neither null nor misaligned; the caller vouches for the rest.
        unsafe { detection.write(std::ptr::null_mut()) };
        // SAFETY: the caller vouches for the model, the cloud and the text.
        let (model, points, values) =
            unsafe { (input("model", model)?, cloud.read("cloud")?, parse_options(options)?) };
        let options = model.model.recommended().with_values(&values)?;
        let found = run(|| Ok(model.model.detect(&points, &options)?))?;
        let keypoints = found.keypoints.iter().map(SnakeKeypoint::from).collect();
        // SAFETY: as above.
        unsafe { detection.write(Box::into_raw(Box::new(SnakeDetection { keypoints }))) };
        Ok(())
    })
}

/// The number of keypoints; 0 for null.
///
/// # Safety
/// `detection` is null or a detection that is not freed yet.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn snake_detection_num_keypoints(detection: *const SnakeDetection) -> usize {
    // SAFETY: the caller vouches for the detection.
    unsafe { detection.as_ref() }.map_or(0, |detection| detection.keypoints.len())
}

/// The keypoints, best first, valid until the detection is freed; null for null.
///
/// # Safety
/// `detection` is null or a detection that is not freed yet.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn snake_detection_keypoints(detection: *const SnakeDetection) -> *const SnakeKeypoint {
    // SAFETY: the caller vouches for the detection.
    unsafe { detection.as_ref() }.map_or(std::ptr::null(), |detection| detection.keypoints.as_ptr())
}

/// Frees a detection; null is allowed.
///
/// # Safety
/// `detection` is null or a detection of this library that is not freed yet.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn snake_detection_free(detection: *mut SnakeDetection) {
    // SAFETY: the caller vouches for the detection.
    unsafe { free(detection) }
}

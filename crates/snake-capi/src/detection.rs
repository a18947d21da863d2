//! Detection of keypoints.

use std::ffi::{CString, c_char};

use snake_core::{Control, Keypoint, printable};

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
    /// Saliency, 0 to 1. Keypoints are ranked by it, in scenes also by how well the points determine their place.
    pub saliency: f32,
    /// Occupancy at the position, 0 to 1.
    pub occupancy: f32,
    /// Index of the nearest point of the cloud, of all its points.
    pub nearest_index: usize,
    /// Probability that another view finds it again, 0 to 1; NaN if the model has no map of confidences.
    pub confidence: f32,
    /// Covariance of the position by the points around it, row by row, in squared cloud units; infinite along directions that
    /// they leave open.
    pub covariance: [f32; 9],
}

impl From<&Keypoint> for SnakeKeypoint {
    fn from(keypoint: &Keypoint) -> Self {
        let Keypoint { position, saliency, occupancy, nearest_index, confidence, covariance } = *keypoint;
        let [a, b, c] = covariance.rows();
        let covariance = [a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2]];
        let confidence = confidence.unwrap_or(f32::NAN);
        Self { position, saliency, occupancy, nearest_index, confidence, covariance }
    }
}

/// The keypoints of a cloud.
pub struct SnakeDetection {
    keypoints: Vec<SnakeKeypoint>,
    voxel_size: f32,
    model: CString,
    notes: Vec<CString>,
}

/// A text for C, without zeros, which would end it, and without characters that control a terminal.
fn c_text(text: &str) -> CString {
    CString::new(printable(text).as_bytes()).unwrap_or_default()
}

/// Detects the keypoints of a cloud. Points that are not finite, and a few that are much farther than all others, are left out.
/// A cloud without finite points is an error.
///
/// `options` is null for what the model recommends, or a JSON object of values that replace those, such as
/// `{"max_keypoints": 20, "nms_radius": "3r"}`; `"preset"` names a set of options to begin with. `*detection` is null after an
/// error.
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
        let (found, chosen) = run(|| {
            let chosen = model.chooser.with_values(&values)?.for_points(&points)?;
            Ok((chosen.detect(&Control::default())?, chosen))
        })?;
        let notes = chosen.notes().into_iter().chain(found.note(&chosen.options.detect));
        let result = SnakeDetection {
            keypoints: found.keypoints.iter().map(SnakeKeypoint::from).collect(),
            voxel_size: found.voxel_size.unwrap_or(f32::NAN),
            model: c_text(&chosen.name),
            notes: notes.map(|note| c_text(&note)).collect(),
        };
        // SAFETY: as above.
        unsafe { detection.write(Box::into_raw(Box::new(result))) };
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

/// The name of the model that found the keypoints, such as "scenes, built-in", valid until the detection is freed; null for null.
///
/// # Safety
/// `detection` is null or a detection that is not freed yet.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn snake_detection_model(detection: *const SnakeDetection) -> *const c_char {
    // SAFETY: the caller vouches for the detection.
    unsafe { detection.as_ref() }.map_or(std::ptr::null(), |detection| detection.model.as_ptr())
}

/// The size of a voxel of the model's volume, in cloud units; NaN for null.
///
/// # Safety
/// `detection` is null or a detection that is not freed yet.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn snake_detection_voxel_size(detection: *const SnakeDetection) -> f32 {
    // SAFETY: the caller vouches for the detection.
    unsafe { detection.as_ref() }.map_or(f32::NAN, |detection| detection.voxel_size)
}

/// A sentence that a user should know: of the choice of the model, the cloud's scale, outliers, or keypoints that cluster. `index`
/// counts from 0; null after the last one. It is UTF-8 and valid until the detection is freed.
///
/// # Safety
/// `detection` is null or a detection that is not freed yet.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn snake_detection_note(detection: *const SnakeDetection, index: usize) -> *const c_char {
    // SAFETY: the caller vouches for the detection.
    let note = unsafe { detection.as_ref() }.and_then(|detection| detection.notes.get(index));
    note.map_or(std::ptr::null(), |note| note.as_ptr())
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

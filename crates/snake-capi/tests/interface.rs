//! The C interface from Rust: what it takes, and which arguments are errors. `tests/test_choice.py` compares its results.

#![allow(unsafe_code)]

use std::ffi::{CStr, CString};
use std::ptr::{null, null_mut};

use snake_rs::*;

fn torus() -> Vec<[f32; 3]> {
    let point = |i: u16| {
        // Two irrational steps spread the points evenly.
        let [u, v] = [0.754_877_7, 0.569_840_3].map(|step: f32| (f32::from(i) * step).fract() * std::f32::consts::TAU);
        [(1.0 + 0.3 * v.cos()) * u.cos(), (1.0 + 0.3 * v.cos()) * u.sin(), 0.3 * v.sin()]
    };
    (0..2000).map(point).collect()
}

fn packed(points: &[[f32; 3]]) -> SnakeCloud {
    SnakeCloud { points: points.as_ptr().cast(), num_points: points.len(), stride: 3 }
}

fn last_error() -> String {
    unsafe { CStr::from_ptr(snake_last_error()) }.to_str().unwrap().to_owned()
}

fn compact() -> *mut SnakeModel {
    let mut model = null_mut();
    assert_eq!(unsafe { snake_model_named(c"compact".as_ptr(), &mut model) }, SnakeStatus::Ok);
    model
}

/// The keypoints of a cloud, or the status and the text of the error.
fn detect(
    model: *const SnakeModel,
    cloud: SnakeCloud,
    options: Option<&str>,
) -> Result<Vec<SnakeKeypoint>, (SnakeStatus, String)> {
    let options = options.map(|text| CString::new(text).unwrap());
    let mut detection = std::ptr::dangling_mut();
    unsafe {
        match snake_detect(model, cloud, options.as_ref().map_or(null(), |text| text.as_ptr()), &mut detection) {
            SnakeStatus::Ok => {
                let number = snake_detection_num_keypoints(detection);
                let keypoints = std::slice::from_raw_parts(snake_detection_keypoints(detection), number).to_vec();
                snake_detection_free(detection);
                Ok(keypoints)
            }
            status => {
                assert!(detection.is_null());
                Err((status, last_error()))
            }
        }
    }
}

#[test]
fn keypoints_of_packed_and_of_padded_points_are_the_same() {
    let (points, model) = (torus(), compact());
    let keypoints = detect(model, packed(&points), None).unwrap();
    assert!(keypoints.len() > 3);
    let wide: Vec<[f32; 4]> = points.iter().map(|[x, y, z]| [*x, *y, *z, f32::NAN]).collect();
    let padded = SnakeCloud { points: wide.as_ptr().cast(), num_points: wide.len(), stride: 4 };
    assert_eq!(detect(model, padded, None).unwrap(), keypoints);
    assert_eq!(detect(model, padded, Some("{\"max_keypoints\": 2}")).unwrap(), keypoints[..2]);
    unsafe { snake_model_free(model) };
}

#[test]
fn bad_clouds_and_options_are_errors() {
    let (points, model) = (torus(), compact());
    let good = packed(&points);
    let misaligned = good.points.cast::<u8>().wrapping_add(1).cast();
    let nan = [[f32::NAN, 0.0, 0.0]; 5];
    use SnakeStatus::{Argument, Input, Option};
    for (cloud, options, status, text) in [
        (SnakeCloud { points: null(), ..good }, None, Argument, "cloud: null"),
        (SnakeCloud { points: misaligned, ..good }, None, Argument, "cloud: misaligned"),
        (SnakeCloud { stride: 2, ..good }, None, Argument, "stride"),
        (SnakeCloud { num_points: usize::MAX, ..good }, None, Argument, "longer than the address space"),
        (SnakeCloud { num_points: usize::MAX / 8, ..good }, None, Argument, "longer than the address space"),
        (SnakeCloud { num_points: 0, ..good }, None, Input, "no points"),
        (SnakeCloud { points: null(), num_points: 0, stride: 3 }, None, Input, "no points"),
        (packed(&nan), None, Input, "none of the 5 points is finite"),
        (packed(&[[1.0; 3]; 9]), None, Input, "two different"),
        (good, Some("{"), Option, "not a JSON object"),
        (good, Some("[1]"), Option, "not a JSON object"),
        (good, Some("{\"radius\": 1}"), Option, "unknown option `radius`"),
        (good, Some("{\"max_keypoints\": -1}"), Option, "`max_keypoints` is -1"),
        (good, Some("{\"min_confidence\": 2}"), Option, "`min_confidence` is 2"),
        (good, Some("{\"query_resolution\": 0}"), Option, "1 to 256"),
    ] {
        let (found, reason) = detect(model, cloud, options).unwrap_err();
        assert_eq!((found, reason.contains(text)), (status, true), "{reason}");
    }
    assert_eq!(detect(null(), good, None).unwrap_err(), (Argument, "model: null".into()));
    assert_eq!(unsafe { snake_detect(model, good, null(), null_mut()) }, Argument);
    let not_utf8 = c"\xff";
    let mut detection = null_mut();
    assert_eq!(unsafe { snake_detect(model, good, not_utf8.as_ptr(), &mut detection) }, Argument);
    assert_eq!(last_error(), "options: not UTF-8");
    unsafe {
        snake_detection_free(null_mut());
        snake_model_free(model);
        snake_model_free(null_mut());
        assert_eq!(snake_detection_num_keypoints(null()), 0);
        assert!(snake_detection_keypoints(null()).is_null());
    }
}

#[test]
fn models_that_cannot_be_loaded_are_errors() {
    let mut model = std::ptr::dangling_mut();
    let check = |status: SnakeStatus, expected, text: &str, model: &mut *mut SnakeModel| {
        assert_eq!((status, model.is_null()), (expected, true), "{}", last_error());
        assert!(last_error().contains(text), "{}", last_error());
        *model = std::ptr::dangling_mut();
    };
    unsafe {
        check(snake_model_named(null(), &mut model), SnakeStatus::Argument, "name: null", &mut model);
        check(snake_model_named(c"large".as_ptr(), &mut model), SnakeStatus::Option, "compact", &mut model);
        check(snake_model_load(c"/no/such".as_ptr(), &mut model), SnakeStatus::Io, "/no/such", &mut model);
        check(snake_model_from_bytes(null(), 9, &mut model), SnakeStatus::Argument, "bytes: null", &mut model);
        check(snake_model_from_bytes(null(), 0, &mut model), SnakeStatus::Weights, "weights", &mut model);
        check(snake_model_from_bytes([1; 9].as_ptr(), 9, &mut model), SnakeStatus::Weights, "weights", &mut model);
        assert_eq!(snake_model_named(c"compact".as_ptr(), null_mut()), SnakeStatus::Argument);
        assert_eq!(CStr::from_ptr(snake_version()).to_str(), Ok(env!("CARGO_PKG_VERSION")));
    }
}

#[test]
fn each_thread_has_its_own_last_error() {
    let mut model = null_mut();
    assert_eq!(unsafe { snake_model_named(c"large".as_ptr(), &mut model) }, SnakeStatus::Option);
    assert_eq!(std::thread::spawn(last_error).join().unwrap(), "");
    assert!(last_error().contains("large"));
}

#[test]
fn clouds_are_registered() {
    let (points, model) = (torus(), compact());
    // A quarter turn about z, and a shift. The dent tells the directions apart.
    let dented: Vec<[f32; 3]> = points.iter().map(|&[x, y, z]| [x, y, z + (x - 0.4 * y).max(0.5)]).collect();
    let target: Vec<[f32; 3]> = dented.iter().map(|&[x, y, z]| [3.0 - y, x, z]).collect();
    let mut registration: SnakeRegistration = unsafe { std::mem::zeroed() };
    let before = registration;
    let register = |source, target, options: *const _, registration: &mut _| unsafe {
        snake_register(null(), source, target, options, registration)
    };
    let (source, target) = (packed(&dented), packed(&target));
    let empty = SnakeCloud { num_points: 0, ..source };
    assert_eq!(register(empty, target, null(), &mut registration), SnakeStatus::Input);
    assert_eq!(last_error(), "source: no points");
    assert_eq!(register(source, target, c"{\"gravity\": 3}".as_ptr(), &mut registration), SnakeStatus::Option);
    assert_eq!(registration, before);
    assert_eq!(unsafe { snake_register(model, source, target, null(), null_mut()) }, SnakeStatus::Argument);
    assert_eq!(register(source, target, null(), &mut registration), SnakeStatus::Ok, "{}", last_error());
    let expected = [0.0, -1.0, 0.0, 3.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0];
    assert!(registration.t_target_source.iter().zip(expected).all(|(a, b)| (a - b).abs() < 0.02), "{registration:?}");
    assert!(
        registration.is_reliable && registration.num_matches >= registration.num_inliers && registration.fitness > 0.9,
        "{registration:?}"
    );
    let options = c"{\"detector\": \"snake\"}".as_ptr();
    let before = registration;
    assert_eq!(register(source, target, options, &mut registration), SnakeStatus::Option);
    assert!(last_error().contains("`model` is none"), "{}", last_error());
    assert_eq!(registration, before);
    assert_eq!(unsafe { snake_register(model, source, target, options, &mut registration) }, SnakeStatus::Ok);
    unsafe { snake_model_free(model) };
}

#[test]
fn the_number_of_threads_is_set_once() {
    for impossible in [3_000_000, usize::MAX] {
        assert_eq!(snake_set_num_threads(impossible), SnakeStatus::Argument);
        assert!(last_error().contains("allowed is 1 to "), "{}", last_error());
        // Later calls still compute.
        assert!(!detect(compact(), packed(&torus()), None).unwrap().is_empty());
    }
    assert_eq!([2, 1, 0].map(|number| snake_set_num_threads(number)), [SnakeStatus::Ok; 3]);
    assert!(last_error().starts_with("num_threads: "), "{}", last_error());
}

//! A child after a fork has no threads of its parent. One test alone, because a fork copies one thread.
#![cfg(unix)]
#![allow(unsafe_code)]

use std::ptr::{null, null_mut};
use std::time::{Duration, Instant};

use snake_rs::*;

fn num_keypoints(model: *const SnakeModel, cloud: SnakeCloud) -> usize {
    let mut detection = null_mut();
    unsafe {
        assert_eq!(snake_detect(model, cloud, null(), &mut detection), SnakeStatus::Ok);
        let number = snake_detection_num_keypoints(detection);
        snake_detection_free(detection);
        number
    }
}

#[test]
fn a_child_computes_after_its_parent_has() {
    let point = |i: u16| {
        let [u, v] = [0.754_877_7, 0.569_840_3].map(|step: f32| (f32::from(i) * step).fract() * std::f32::consts::TAU);
        [(1.0 + 0.3 * v.cos()) * u.cos(), (1.0 + 0.3 * v.cos()) * u.sin(), 0.3 * v.sin()]
    };
    let points: Vec<[f32; 3]> = (0..2000).map(point).collect();
    let cloud = SnakeCloud { points: points.as_ptr().cast(), num_points: points.len(), stride: 3 };
    let mut model = null_mut();
    assert_eq!(unsafe { snake_model_named(c"compact".as_ptr(), &mut model) }, SnakeStatus::Ok);
    let expected = num_keypoints(model, cloud);
    // SAFETY: the child computes and ends, without anything of the test's other threads.
    let child = unsafe { libc::fork() };
    if child == 0 {
        let is_same = num_keypoints(model, cloud) == expected;
        unsafe { libc::_exit(if is_same { 0 } else { 1 }) };
    }
    let (began, mut status) = (Instant::now(), -1);
    while unsafe { libc::waitpid(child, &mut status, libc::WNOHANG) } == 0 {
        if began.elapsed() > Duration::from_secs(60) {
            unsafe { libc::kill(child, libc::SIGKILL) };
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    assert_eq!(status, 0, "the child ended otherwise, or did not end");
    unsafe { snake_model_free(model) };
}

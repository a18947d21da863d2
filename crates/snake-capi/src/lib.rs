//! C interface of snake-rs: models, keypoints and registration for C and C++. `include/snake_rs.h` declares it.
//!
//! Every function returns a [`SnakeStatus`], except functions that free or query something. After a status other than
//! [`SnakeStatus::Ok`], [`snake_last_error`] gives the reason as text, separately for each thread, and the result is null
//! or unchanged. No argument makes a function crash, as long as pointers are null or valid. Null, wrong lengths and
//! clouds without finite points are errors, and so is a panic within the library.
//!
//! A [`SnakeCloud`] is read without a copy where possible and may have padding. Results belong to the caller, who frees them with the
//! function of their type. Several threads can use a model at the same time.
//!
//! This crate has `unsafe` code, like `snake-kernels`, because it reads the pointers that C passes. Each function documents what
//! must hold for them.
#![allow(unsafe_code)]

mod arguments;
mod detection;
mod model;
mod registration;
mod status;
mod threads;

pub use arguments::SnakeCloud;
pub use detection::{
    SnakeDetection, SnakeKeypoint, snake_detect, snake_detection_free, snake_detection_keypoints,
    snake_detection_model, snake_detection_note, snake_detection_num_keypoints, snake_detection_voxel_size,
};
pub use model::{
    SnakeModel, snake_model_auto, snake_model_free, snake_model_from_bytes, snake_model_load, snake_model_named,
    snake_version,
};
pub use registration::{SnakeRegistration, snake_register};
pub use status::{SnakeStatus, snake_last_error};
pub use threads::snake_set_num_threads;

//! C interface of snake-rs: models, keypoints and registration for C and C++. `include/snake_rs.h` declares it.
//!
//! Every function but those that free and ask returns a [`SnakeStatus`]. After a status other than
//! [`SnakeStatus::Ok`], [`snake_last_error`] gives the reason as text, for each thread by itself, and the result is null
//! or unchanged. No argument makes a function crash, as long as pointers are null or valid: null, wrong lengths and
//! clouds without finite points are errors, and so is a panic within the library.
//!
//! A [`SnakeCloud`] is read where it is and may have padding. Results belong to the caller, who frees them with the function of their
//! type. Models can be used by several threads at the same time.
//!
//! This crate has `unsafe` code, as `snake-kernels` has: it reads the pointers that C gives it. Each function says what
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

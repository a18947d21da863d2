//! Rotations and rigid transforms.

mod rigid_transform;

pub mod rotations;

pub use rigid_transform::RigidTransform;

//! The examples of this package run.

#[path = "../examples/arrow_cloud.rs"]
mod arrow_cloud;
#[path = "../examples/geometry.rs"]
mod geometry;

#[test]
fn examples_run() {
    arrow_cloud::main().unwrap();
    geometry::main().unwrap();
}

//! The examples of this package run.

#[path = "../examples/geometry.rs"]
mod geometry;

#[test]
fn examples_run() {
    geometry::main().unwrap();
}

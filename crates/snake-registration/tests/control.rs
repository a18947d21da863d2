//! Progress of registration.

use snake_core::{Control, Point, Progress};
use snake_registration::steps::{Lengths, VoxelCloud};
use snake_registration::{Descriptor, PairOptions, RegisterOptions, Registration, register, register_with};

fn plane() -> Vec<Point> {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../samples/plane.ply");
    snake_io::read_points(path.as_ref()).unwrap()
}

/// Asserts that the stage of this name began last, and is complete.
fn assert_complete(progress: &Progress, name: &str) {
    let stage = progress.stage().unwrap();
    assert!(stage.name == name && stage.done == stage.total && stage.total > 0, "{name}: {stage:?}");
}

#[test]
fn stages_are_counted_to_their_ends_and_change_no_result() {
    let points = plane();
    let progress = Progress::default();
    let control = Control::new().progress(&progress);
    let voxels = VoxelCloud::new(&points, &Lengths::from_spacing(0.05, 0.05), &control).unwrap();
    assert_complete(&progress, "normals");
    voxels.descriptors(&points[..3], Descriptor::Fpfh, &control).unwrap();
    assert_complete(&progress, "FPFH");
    let options = RegisterOptions::default().with_max_keypoints(200);
    let quiet = register(&points[..2048], &points[2048..], &options).unwrap();
    let watched =
        register_with(&points[..2048], &points[2048..], None, &options, &PairOptions::default(), &control).unwrap();
    let text = serde_json::to_string(&quiet).unwrap();
    let mut written = quiet.clone();
    written.matches.pairs.clear(); // they are not in files
    assert_eq!(serde_json::from_str::<Registration>(&text).unwrap(), written);
    let same_seconds = |mut registration: Registration| {
        registration.seconds = 0.0;
        registration
    };
    assert_eq!(same_seconds(watched), same_seconds(quiet));
    assert_complete(&progress, "ICP");
}

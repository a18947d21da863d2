//! Progress and cancellation of registration.

use std::time::{Duration, Instant};

use snake_core::{CancelFlag, Control, Error, Point, Progress};
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

#[test]
fn a_cancelled_registration_ends_soon() {
    const MOMENTS: u32 = 10;
    let points = plane();
    let options = RegisterOptions::default().with_max_keypoints(500);
    let call = |control: &Control| {
        let registration =
            register_with(&points[..2048], &points[2048..], None, &options, &PairOptions::default(), control);
        registration.map(|registration| registration.t_target_source)
    };
    let start = Instant::now();
    let expected = call(&Control::default()).unwrap();
    let whole = start.elapsed();
    let mut delays = Vec::new();
    for moment in 0..MOMENTS {
        let flag = CancelFlag::default();
        std::thread::scope(|scope| {
            let running = scope.spawn(|| (call(&Control::new().cancel(&flag)), Instant::now()));
            std::thread::sleep(whole * moment / MOMENTS);
            let cancelled = Instant::now();
            flag.cancel();
            match running.join().unwrap() {
                (Ok(registration), _) => assert!(registration == expected),
                (Err(Error::Cancelled), end) => delays.push(end.saturating_duration_since(cancelled)),
                (Err(error), _) => panic!("{error}"),
            }
        });
    }
    assert!(call(&Control::default()).unwrap() == expected);
    delays.sort();
    let median = delays[delays.len() / 2];
    // On a busy machine everything takes longer.
    assert!(median < Duration::from_millis(50).max(whole / 4), "{median:?} of {whole:?}");
}

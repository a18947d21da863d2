//! Progress and cancellation of registration.

use std::time::{Duration, Instant};

use snake_core::{CancelFlag, Control, Error, Point, Progress};
use snake_registration::{Descriptor, RegisterOptions, Registration, Scan, register, register_with};

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
    let scan = Scan::new_with(&points, 0.05, &control).unwrap();
    assert_complete(&progress, "normals");
    scan.descriptors_with(&points[..3], Descriptor::Fpfh, &control).unwrap();
    assert_complete(&progress, "FPFH");
    let options = RegisterOptions::default().with_max_keypoints(200);
    let found = register(&points[..2048], &points[2048..], &options).unwrap();
    let watched = register_with(&points[..2048], &points[2048..], None, &options, &control).unwrap();
    let text = serde_json::to_string(&found).unwrap();
    let mut written = found.clone();
    written.matches.clear(); // they are not in files
    assert_eq!(serde_json::from_str::<Registration>(&text).unwrap(), written);
    let same_seconds = |mut found: Registration| {
        found.seconds = 0.0;
        found
    };
    assert_eq!(same_seconds(watched), same_seconds(found));
    assert_complete(&progress, "ICP");
}

#[test]
fn a_cancelled_registration_ends_soon() {
    const MOMENTS: u32 = 10;
    let points = plane();
    let options = RegisterOptions::default().with_max_keypoints(500);
    let call = |control: &Control| {
        let found = register_with(&points[..2048], &points[2048..], None, &options, control);
        found.map(|found| found.t_target_source)
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
                (Ok(found), _) => assert!(found == expected),
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

//! Keypoints of a cloud in one call, and with a deadline, cancellation and progress: `cargo run --release --example detect`.

use std::thread;
use std::time::{Duration, Instant};

use snake_core::{Builtin, CancelFlag, Control, Error, Model, Point, Progress, Result};

/// A torus of 4000 points, with a radius of 1 and a tube of 0.3.
fn torus() -> Vec<Point> {
    let point = |i: u16| {
        let (u, v) = (f32::from(i) * 0.1, f32::from(i) * 0.7);
        let ring = 1.0 + 0.3 * v.cos();
        [ring * u.cos(), ring * u.sin(), 0.3 * v.sin()]
    };
    (0..4000).map(point).collect()
}

fn main() -> Result<()> {
    let model = Model::builtin(Builtin::Compact);
    let points = torus();
    let detection = model.detect(&points, model.recommended())?;
    for keypoint in &detection.keypoints {
        println!("{:?} saliency {:.3}", keypoint.position, keypoint.saliency);
    }

    // A call that is not done at its deadline returns an error.
    let control = Control::new().deadline(Instant::now() + Duration::from_secs(5));
    match model.detect_with(&points, model.recommended(), &control) {
        Ok(detection) => println!("{} keypoints", detection.keypoints.len()),
        Err(Error::DeadlineExceeded) => println!("the deadline passed"),
        Err(error) => return Err(error),
    }

    // Another thread cancels the call. A cancelled call leaves nothing behind: the model can be used again at once.
    let cancel = CancelFlag::default();
    let control = Control::new().cancel(&cancel);
    let cancelled = thread::scope(|scope| {
        scope.spawn(|| {
            thread::sleep(Duration::from_millis(2));
            cancel.cancel();
        });
        model.detect_with(&points, model.recommended(), &control)
    });
    println!("cancelled: {}", matches!(cancelled, Err(Error::Cancelled)));

    // This thread shows the progress of a call in another thread.
    let progress = Progress::default();
    let control = Control::new().progress(&progress);
    thread::scope(|scope| {
        let call = scope.spawn(|| model.detect_with(&points, model.recommended(), &control));
        while !call.is_finished() {
            if let Some(stage) = progress.stage() {
                println!("{}: {} of {}", stage.name, stage.done, stage.total);
            }
            thread::sleep(Duration::from_millis(5));
        }
    });
    Ok(())
}

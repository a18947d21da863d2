//! One model in several threads, and a pool of threads for its calls: `cargo run --release -p snake-core --example threads`.

use std::error::Error;
use std::thread;

use snake_core::{Builtin, Control, Detection, Field, Mesh, Model, Options, Point};

/// A spiral of 2000 points with this radius.
fn spiral(radius: f32) -> Vec<Point> {
    let point = |i: u16| {
        let angle = f32::from(i) * 0.05;
        [radius * angle.cos(), radius * angle.sin(), f32::from(i) * 0.001]
    };
    (0..2000).map(point).collect()
}

/// Compiles only for types that threads can share and send to each other.
fn assert_shareable<T: Send + Sync>() {}

fn main() -> Result<(), Box<dyn Error>> {
    assert_shareable::<(Model, Field, Detection, Mesh, Options, Control, snake_core::Error)>();
    let model = Model::builtin(Builtin::Compact);
    let clouds = [spiral(1.0), spiral(2.0), spiral(3.0)];

    // Threads share one model; a clone of it shares the weights.
    let counts = thread::scope(|scope| {
        let calls = clouds.each_ref().map(|points| scope.spawn(|| model.detect(points, model.recommended())));
        calls.map(|call| call.join().map(|found| found.map(|detection| detection.keypoints.len())))
    });
    println!("{counts:?}");

    // A call runs on Rayon's current pool. The number of threads does not change a bit of the result.
    let pool = rayon::ThreadPoolBuilder::new().num_threads(2).build()?;
    let detection = pool.install(|| model.detect(&clouds[0], model.recommended()))?;
    println!("{} keypoints with two threads", detection.keypoints.len());
    Ok(())
}

//! Threads that the library starts. A test binary of its own, because Rayon's global pool belongs to the process.

use snake_core::{Builtin, Model, Point, SimdLevel};

#[test]
fn loading_and_one_thread_start_no_pool() {
    // One thread without a pool: the calling thread does all work.
    let own = std::thread::current().id();
    let model = Model::builtin(Builtin::Compact);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).use_current_thread().build().unwrap();
    let points: Vec<Point> = (0..500).map(|i| [(i % 20) as f32, (i / 20) as f32, ((i * i) % 17) as f32]).collect();
    let detection = model.detect(&points, model.recommended()).unwrap();
    assert!(!detection.keypoints.is_empty());
    assert_eq!(pool.install(|| std::thread::current().id()), own);
    // Nothing has started the global pool: it can still be configured.

    rayon::ThreadPoolBuilder::new().num_threads(2).build_global().unwrap();

    // The level of instructions is in use, so another one is refused.
    let level = SimdLevel::current();
    assert_eq!(level.make_current(), Ok(()));
    for other in SimdLevel::available().into_iter().filter(|other| *other != level) {
        assert_eq!(other.make_current(), Err(level));
    }
}

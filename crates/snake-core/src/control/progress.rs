//! Progress of long calls.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use super::clock::Instant;

/// Progress of a long call, which another thread can read while the call runs.
///
/// A call reports its stages to it ([`Control::progress`](crate::Control::progress)). Results do not depend on it. If
/// several calls share one, it shows the stage that began last.
///
/// ```
/// use snake_core::{Builtin, Control, Model, Progress};
/// # let points: Vec<[f32; 3]> = (0..500).map(|i| { let a = i as f32 * 0.1; [a.cos(), a.sin(), (a * 0.3).sin()] }).collect();
/// let progress = Progress::default();
/// let model = Model::builtin(Builtin::Compact);
/// let control = Control::new().progress(&progress);
/// std::thread::scope(|scope| {
///     let detection = scope.spawn(|| model.detect_with(&points, model.recommended(), &control));
///     while !detection.is_finished() {
///         if let Some(stage) = progress.stage() {
///             println!("{}: {} of {}, {:?} left", stage.name, stage.done, stage.total, stage.remaining());
///         }
///         std::thread::sleep(std::time::Duration::from_millis(20));
///     }
/// });
/// # Ok::<(), snake_core::Error>(())
/// ```
#[derive(Debug, Clone, Default)]
pub struct Progress(Arc<Mutex<Option<Arc<Count>>>>);

/// One stage of a long call.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stage {
    /// The name of the stage, in one to three words.
    pub name: &'static str,
    /// Completed units of work: points, queries or others of similar duration.
    pub done: u64,
    /// Maximum number of units of work; 0 if unknown.
    pub total: u64,
    /// Time since the stage began.
    pub elapsed: Duration,
}

impl Progress {
    /// The stage that began last; `None` before the first.
    pub fn stage(&self) -> Option<Stage> {
        let count = self.0.lock().unwrap_or_else(PoisonError::into_inner).clone()?;
        let (done, total) = (count.done.load(Ordering::Relaxed), count.total.load(Ordering::Relaxed));
        Some(Stage { name: count.name, done: done.min(total), total, elapsed: count.start.elapsed() })
    }

    pub(crate) fn begin(&self, name: &'static str, total: usize) -> Arc<Count> {
        let [done, total] = [0, total as u64].map(AtomicU64::new);
        let count = Arc::new(Count { name, done, total, start: Instant::now() });
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Some(count.clone());
        count
    }
}

impl Stage {
    /// The estimated time to the end of this stage; `None` before the first completed unit of work.
    pub fn remaining(&self) -> Option<Duration> {
        (self.done > 0).then(|| self.elapsed.mul_f64((self.total - self.done) as f64 / self.done as f64))
    }
}

/// The counters of one stage.
#[derive(Debug)]
pub(crate) struct Count {
    name: &'static str,
    done: AtomicU64,
    total: AtomicU64,
    start: Instant,
}

impl Count {
    pub(crate) fn add(&self, number: usize) {
        self.done.fetch_add(number as u64, Ordering::Relaxed);
    }

    pub(crate) fn set_total(&self, total: usize) {
        self.total.store(total as u64, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detect::occupied::above_occupancy;
    use crate::detect::refine::refine;
    use crate::detect::tests::cylinder;
    use crate::{Builtin, Control, DetectOptions, EncodeOptions, MeshOptions, Model, Selection};

    /// Asserts that the stage that began last has this name and is complete.
    fn assert_complete(progress: &Progress, name: &str) {
        let stage = progress.stage().unwrap();
        assert!(stage.name == name && stage.done == stage.total && stage.total > 0, "{name}: {stage:?}");
        assert_eq!(stage.remaining(), Some(Duration::ZERO));
    }

    #[test]
    fn stages_are_counted_to_their_ends_and_change_no_result() {
        let (points, field) = cylinder();
        let progress = Progress::default();
        assert_eq!(progress.stage(), None);
        let control = Control::new().progress(&progress);
        let model = Model::builtin(Builtin::Compact);
        for rotations in [3, 1] {
            let options = EncodeOptions { rotations, ..Default::default() };
            model.encode_with(&points, &options, &control).unwrap();
            assert_complete(&progress, "encoding");
        }
        let watched = model.encode_with(&points, &EncodeOptions::default(), &control).unwrap();
        assert_eq!(*watched.volume().values, *field.volume().values);
        let default = DetectOptions { query_resolution: 24, ..Default::default() };
        let occupied = |options: &DetectOptions, control: &Control| {
            above_occupancy(&field, &field.queries(options), options.occupancy_threshold, control).unwrap()
        };
        for query_band in [1, 0] {
            let options = DetectOptions { query_band, ..default };
            assert_eq!(occupied(&options, &control), occupied(&options, &Control::default()));
            assert_complete(&progress, "occupancy");
        }
        let queries = occupied(&default, &Control::default());
        for (refine_steps, selection) in [(0, Selection::BestPosition), (3, Selection::ReferenceFinalPosition)] {
            let options = DetectOptions { refine_steps, selection, ..default };
            let refined = |control| refine(&field, &queries, &options, control).unwrap();
            assert_eq!(refined(&control), refined(&Control::default()));
            assert_complete(&progress, "refinement");
        }
        let options = MeshOptions { resolution: 40, ..Default::default() };
        assert_eq!(field.mesh_with(&options, &control).unwrap(), field.mesh(&options).unwrap());
        assert_complete(&progress, "middle of the shell");
    }

    #[test]
    fn the_remaining_time_is_extrapolated() {
        let stage = |done, total| Stage { name: "", done, total, elapsed: Duration::from_secs(10) };
        assert_eq!(stage(25, 100).remaining(), Some(Duration::from_secs(30)));
        assert_eq!(stage(100, 100).remaining(), Some(Duration::ZERO));
        assert_eq!([stage(0, 100), stage(0, 0)].map(|stage| stage.remaining()), [None; 2]);
    }
}

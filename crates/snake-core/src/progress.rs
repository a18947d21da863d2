//! How far a long call is.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// How far a long call is, for another thread to read while it runs.
///
/// A model that has one ([`Model::with_progress`](crate::Model::with_progress)) counts there what is done with it and with
/// its fields: encoding, queries, [`detect`](crate::detect()), [`Field::mesh`](crate::Field::mesh),
/// [`register`](crate::registration::register). Results do not depend on it. Of calls at the same time, it shows what
/// began last.
///
/// ```
/// use snake_core::{Model, Progress};
/// # let points: Vec<[f32; 3]> = (0..500).map(|i| { let a = i as f32 * 0.1; [a.cos(), a.sin(), (a * 0.3).sin()] }).collect();
/// let progress = Progress::default();
/// let model = Model::builtin()?.with_progress(&progress);
/// std::thread::scope(|scope| {
///     let detection = scope.spawn(|| model.detect(&points, model.recommended()));
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
    /// What is being done, in a word or two.
    pub name: &'static str,
    /// How much of it is done: points, queries or other pieces that take about equally long.
    pub done: u64,
    /// Of how much, at most; 0 if that is not known.
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
}

impl Stage {
    /// The time that the rest of this stage takes if it goes on as it did; `None` as long as nothing says so.
    pub fn remaining(&self) -> Option<Duration> {
        (self.done > 0).then(|| self.elapsed.mul_f64((self.total - self.done) as f64 / self.done as f64))
    }
}

#[derive(Debug)]
struct Count {
    name: &'static str,
    done: AtomicU64,
    total: AtomicU64,
    start: Instant,
}

/// What counts a stage; without a [`Progress`] it does nothing.
#[derive(Debug, Clone, Default)]
pub(crate) struct Counter(Option<Arc<Count>>);

impl Counter {
    /// Begins a stage of so many pieces, 0 if their number is not known.
    pub(crate) fn begin(progress: Option<&Progress>, name: &'static str, total: usize) -> Self {
        Self(progress.map(|Progress(current)| {
            let [done, total] = [0, total as u64].map(AtomicU64::new);
            let count = Arc::new(Count { name, done, total, start: Instant::now() });
            *current.lock().unwrap_or_else(PoisonError::into_inner) = Some(count.clone());
            count
        }))
    }

    /// So many more pieces are done.
    pub(crate) fn add(&self, number: usize) {
        if let Some(count) = &self.0 {
            count.done.fetch_add(number as u64, Ordering::Relaxed);
        }
    }

    /// It turns out that there are so many pieces.
    pub(crate) fn set_total(&self, total: usize) {
        if let Some(count) = &self.0 {
            count.total.store(total as u64, Ordering::Relaxed);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detect::tests::cylinder;
    use crate::query_grid::tests::occupied_queries;
    use crate::refine::refine;
    use crate::registration::{Descriptor, RegisterOptions, Registration, Scan, register};
    use crate::{DetectOptions, EncodeOptions, MeshOptions, Model, Selection};

    /// Asserts that a stage of this name began last and is complete.
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
        let model = Model::builtin().unwrap().with_progress(&progress);
        for rotations in [3, 1] {
            model.encode(&points, &EncodeOptions { rotations, ..Default::default() }).unwrap();
            assert_complete(&progress, "encoding");
        }
        let watched = model.encode(&points, &EncodeOptions::default()).unwrap();
        assert_eq!(*watched.volume().values, *field.volume().values);
        let default = DetectOptions { query_resolution: 24, ..Default::default() };
        for query_band in [1, 0] {
            let options = DetectOptions { query_band, ..default };
            assert_eq!(occupied_queries(&watched, &options), occupied_queries(&field, &options));
            assert_complete(&progress, "occupancy");
        }
        let queries = occupied_queries(&field, &default);
        for (refine_steps, selection) in [(0, Selection::BestPosition), (3, Selection::ReferenceFinalPosition)] {
            let options = DetectOptions { refine_steps, selection, ..default };
            assert_eq!(refine(&watched, &queries, &options), refine(&field, &queries, &options));
            assert_complete(&progress, "refinement");
        }
        assert_eq!(watched.saliency_and_gradient(&points).unwrap(), field.saliency_and_gradient(&points).unwrap());
        assert_complete(&progress, "saliency");
        assert_eq!(watched.occupancy(&points).unwrap(), field.occupancy(&points).unwrap());
        assert_complete(&progress, "occupancy");
        let options = MeshOptions { resolution: 40, ..Default::default() };
        assert_eq!(watched.mesh(&options).unwrap(), field.mesh(&options).unwrap());
        assert_complete(&progress, "normals");
    }

    #[test]
    fn registration_is_counted_and_stays_the_same() {
        let points = crate::io::read_points(concat!(env!("CARGO_MANIFEST_DIR"), "/../../samples/plane.ply").as_ref());
        let points = points.unwrap();
        let progress = Progress::default();
        let model = Model::builtin().unwrap();
        let watched = model.clone().with_progress(&progress);
        let scan = Scan::new(&points, &watched, 0.05).unwrap();
        assert_complete(&progress, "normals");
        scan.descriptors(&points[..3], Descriptor::Fpfh).unwrap();
        assert_complete(&progress, "FPFH");
        let options = RegisterOptions { max_keypoints: 200, ..Default::default() };
        let found = |model| {
            let found = register(&points[..2048], &points[2048..], model, &options).unwrap();
            Registration { seconds: 0.0, ..found }
        };
        assert_eq!(found(&watched), found(&model));
        let Stage { name, done, total, .. } = progress.stage().unwrap();
        assert!(name == "ICP" && (1..=30).contains(&done) && total == 30, "{done} of {total}");
    }

    #[test]
    fn another_thread_sees_it_grow() {
        let (points, _) = cylinder();
        let progress = Progress::default();
        let model = Model::builtin().unwrap().with_progress(&progress);
        let options = EncodeOptions { rotations: 16, ..Default::default() };
        std::thread::scope(|scope| {
            let encoding = scope.spawn(|| model.encode(&points, &options).unwrap());
            let mut seen = 0;
            while !encoding.is_finished() {
                if let Some(stage) = progress.stage() {
                    assert!(
                        stage.name == "encoding" && (seen..=stage.total).contains(&stage.done),
                        "{seen}, {stage:?}"
                    );
                    seen = stage.done;
                }
            }
        });
        assert_complete(&progress, "encoding");
    }

    #[test]
    fn the_rest_takes_as_long_as_what_is_done() {
        let stage = |done, total| Stage { name: "", done, total, elapsed: Duration::from_secs(10) };
        assert_eq!(stage(25, 100).remaining(), Some(Duration::from_secs(30)));
        assert_eq!(stage(100, 100).remaining(), Some(Duration::ZERO));
        assert_eq!([stage(0, 100), stage(0, 0)].map(|stage| stage.remaining()), [None; 2]);
    }
}

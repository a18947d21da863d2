//! Control of a call: progress, cancellation, deadline, threads.

pub(crate) mod clock;
mod parallel_map;
mod progress;
mod threads;

pub use self::parallel_map::parallel_map;
pub use self::progress::{Progress, Stage};
pub use self::threads::{ProcessPool, max_num_threads, run_watched};

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use self::progress::Count;
use crate::{Error, Result};

/// Progress, cancellation and a deadline for a long call, an argument of
/// [`Model::encode_with`](crate::Model::encode_with), [`Model::detect_with`](crate::Model::detect_with),
/// [`Field::detect_with`](crate::Field::detect_with), [`Field::mesh_with`](crate::Field::mesh_with) and
/// `snake_registration::register_with`. Results do not depend on it. The default does nothing.
///
/// A call checks it between the layers of the network and the parts of a layer, between tiles of queries, refinement
/// steps and the steps of a registration. A stopped call returns an error. Model and field stay as they were.
///
/// ```
/// use snake_core::{Builtin, CancelFlag, Control, Error, Model};
/// # let points: Vec<[f32; 3]> = (0..500).map(|i| { let a = i as f32 * 0.1; [a.cos(), a.sin(), (a * 0.3).sin()] }).collect();
/// let model = Model::builtin(Builtin::Compact);
/// let cancel = CancelFlag::default();
/// cancel.cancel(); // from any thread, at any time
/// let stopped = model.detect_with(&points, model.recommended(), &Control::new().cancel(&cancel));
/// assert!(matches!(stopped, Err(Error::Cancelled)));
/// # Ok::<(), snake_core::Error>(())
/// ```
#[derive(Debug, Clone, Default)]
pub struct Control {
    progress: Option<Progress>,
    stop: Stop,
}

impl Control {
    /// A control that neither reports progress nor stops a call.
    pub fn new() -> Self {
        Self::default()
    }

    /// Reports the stages of the call to `progress`.
    pub fn progress(mut self, progress: &Progress) -> Self {
        self.progress = Some(progress.clone());
        self
    }

    /// Stops the call with [`Error::Cancelled`] when the flag is set.
    pub fn cancel(mut self, flag: &CancelFlag) -> Self {
        self.stop.cancel = Some(flag.clone());
        self
    }

    /// Stops the call with [`Error::DeadlineExceeded`] at this time.
    pub fn deadline(mut self, deadline: Instant) -> Self {
        self.stop.deadline = Some(deadline);
        self
    }

    /// Returns an error if the call must stop.
    ///
    /// # Errors
    /// [`Error::Cancelled`] and [`Error::DeadlineExceeded`].
    pub fn check(&self) -> Result<()> {
        self.stop.check()
    }

    /// Begins a stage of `total` units of work of similar duration; 0 if their number is unknown.
    pub fn begin(&self, name: &'static str, total: usize) -> Counter {
        let count = self.progress.as_ref().map(|progress| progress.begin(name, total));
        Counter { count, stop: self.stop.clone() }
    }

    /// The same control for inner calls, whose progress the outer call reports.
    pub fn without_progress(&self) -> Self {
        Self { progress: None, stop: self.stop.clone() }
    }
}

/// A flag that cancels calls. Clones share it. It cannot be reset: a later call needs a new flag.
#[derive(Debug, Clone, Default)]
pub struct CancelFlag(Arc<AtomicBool>);

impl CancelFlag {
    /// Cancels all calls with this flag.
    pub fn cancel(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    /// Whether it is set.
    pub fn is_cancelled(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}

/// The conditions under which a call must stop.
#[derive(Debug, Clone, Default)]
struct Stop {
    cancel: Option<CancelFlag>,
    deadline: Option<Instant>,
    #[cfg(test)]
    checks: Option<tests::Checks>,
}

impl Stop {
    fn check(&self) -> Result<()> {
        #[cfg(test)]
        self.checks.iter().for_each(tests::Checks::add);
        if self.cancel.as_ref().is_some_and(CancelFlag::is_cancelled) {
            return Err(Error::Cancelled);
        }
        match self.deadline {
            Some(deadline) if Instant::now() >= deadline => Err(Error::DeadlineExceeded),
            _ => Ok(()),
        }
    }
}

/// The progress of one stage of a call. It also tells when the call must stop.
#[derive(Debug, Clone, Default)]
pub struct Counter {
    count: Option<Arc<Count>>,
    stop: Stop,
}

impl Counter {
    /// Adds completed units of work.
    pub fn add(&self, number: usize) {
        if let Some(count) = &self.count {
            count.add(number);
        }
    }

    /// Corrects the number of units of work.
    pub fn set_total(&self, total: usize) {
        if let Some(count) = &self.count {
            count.set_total(total);
        }
    }

    /// Returns an error if the call must stop.
    ///
    /// # Errors
    /// [`Error::Cancelled`] and [`Error::DeadlineExceeded`].
    pub fn check(&self) -> Result<()> {
        self.stop.check()
    }

    /// Whether the call must stop. From then on [`Counter::check`] is an error.
    pub fn is_stopped(&self) -> bool {
        self.check().is_err()
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use cpu_time::ThreadTime;

    use super::*;
    use crate::detect::tests::cylinder;
    use crate::{Builtin, EncodeOptions, MeshOptions, Model, Options};

    /// The moments at which a call checked its control, in processor time: other programs do not count.
    #[derive(Debug, Clone, Default)]
    pub(super) struct Checks(Arc<std::sync::Mutex<Vec<Duration>>>);

    impl Checks {
        pub(super) fn add(&self) {
            self.0.lock().unwrap().push(ThreadTime::now().as_duration());
        }
    }

    /// Asserts that a call on one thread checks its control at least every 50 ms. A call makes the same checks each time.
    /// Other programs fill the caches, so each gap between two checks is the shortest of up to 20 runs.
    fn assert_checked_often(call: impl Fn(&Control) + Sync) {
        const LIMIT: Duration = Duration::from_millis(50);
        let one_thread = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        let gaps_of_run = || {
            let checks = Checks::default();
            let mut control = Control::new();
            control.stop.checks = Some(checks.clone());
            one_thread.install(|| {
                checks.add();
                call(&control);
                checks.add();
            });
            let moments = checks.0.lock().unwrap();
            moments.windows(2).map(|pair| pair[1] - pair[0]).collect::<Vec<Duration>>()
        };
        let mut gaps = gaps_of_run();
        for _ in 1..20 {
            if gaps.iter().all(|gap| *gap < LIMIT) {
                break;
            }
            let again = gaps_of_run();
            assert_eq!(again.len(), gaps.len(), "runs differ");
            gaps.iter_mut().zip(again).for_each(|(gap, again)| *gap = again.min(*gap));
        }
        let longest = gaps.iter().max().unwrap();
        assert!(*longest < LIMIT, "{longest:?} of {:?}", gaps.iter().sum::<Duration>());
    }

    /// A cancelled call returns within 50 ms: no step between two checks takes longer, even on a single thread.
    #[test]
    fn a_network_of_64_is_checked_at_least_every_50_ms() {
        let (points, _) = cylinder();
        let model = model_of_64();
        let mut options = Options::default();
        options.encode.rotations = 2;
        let encode = |control: &Control| drop(model.encode_with(&points, &options.encode, control).unwrap());
        assert_checked_often(encode);
        let field = model.encode(&points, &EncodeOptions::default()).unwrap();
        assert_checked_often(|control| drop(field.detect_with(&options.detect, control).unwrap()));
        assert_checked_often(|control| drop(field.mesh_with(&MeshOptions::default(), control).unwrap()));
    }

    /// The same for a scene, including the choice of the voxel size and the construction of the blocks.
    #[test]
    fn a_scene_is_checked_at_least_every_50_ms() {
        let at = |i: usize, step: f32| (i as f32 * step).fract();
        let floor = |i: usize| [4.0 * at(i, 0.618_034), 4.0 * at(i, 0.754_878), 0.0];
        let wall = |i: usize| [4.0 * at(i, 0.618_034), 0.0, 2.0 * at(i, 0.754_878)];
        let points: Vec<_> = (0..20_000).map(|i| if i % 3 == 0 { wall(i) } else { floor(i) }).collect();
        let model = Model::builtin(Builtin::Scenes);
        assert_checked_often(|control| drop(model.detect_with(&points, model.recommended(), control).unwrap()));
    }

    /// The built-in weights in a volume of 64³ voxels.
    fn model_of_64() -> Model {
        let file = safetensors::SafeTensors::deserialize(include_bytes!("../../models/compact.safetensors")).unwrap();
        let mut metadata = Model::builtin(Builtin::Compact).metadata().clone();
        metadata.insert("resolution".into(), "[64, 64, 64]".into());
        let bytes = safetensors::serialize(file.tensors(), Some(metadata.into_iter().collect())).unwrap();
        Model::from_bytes(&bytes).unwrap()
    }
}

//! What a caller can do about a long call while it runs: see how far it is, cancel it, limit its time.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use crate::progress::{Count, Progress};
use crate::{Error, Result};

/// Progress, cancellation and a deadline of a long call, an argument of
/// [`Model::encode_with`](crate::Model::encode_with), [`Model::detect_with`](crate::Model::detect_with),
/// [`Field::detect_with`](crate::Field::detect_with), [`Field::mesh_with`](crate::Field::mesh_with) and
/// `snake_registration::register_with`. Results do not depend on it. The default does nothing.
///
/// A call looks at it between the layers of the network and the parts of a layer, between tiles of queries, refinement
/// steps, windows, RANSAC rounds and ICP steps. A call that was stopped returns an error and leaves nothing behind: the
/// same model and field can be used again at once.
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
    limits: Limits,
}

impl Control {
    /// A control that does nothing yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// Counts the stages of the call in `progress`.
    pub fn progress(mut self, progress: &Progress) -> Self {
        self.progress = Some(progress.clone());
        self
    }

    /// Stops the call with [`Error::Cancelled`] once the flag is set.
    pub fn cancel(mut self, flag: &CancelFlag) -> Self {
        self.limits.cancel = Some(flag.clone());
        self
    }

    /// Stops the call with [`Error::DeadlineExceeded`] at that time.
    pub fn deadline(mut self, deadline: Instant) -> Self {
        self.limits.deadline = Some(deadline);
        self
    }

    /// Whether the call may go on.
    ///
    /// # Errors
    /// [`Error::Cancelled`] and [`Error::DeadlineExceeded`].
    pub fn check(&self) -> Result<()> {
        self.limits.check()
    }

    /// Begins a stage of so many pieces that take about equally long; 0 if their number is not known.
    pub fn begin(&self, name: &'static str, total: usize) -> Counter {
        let count = self.progress.as_ref().map(|progress| progress.begin(name, total));
        Counter { count, limits: self.limits.clone() }
    }

    /// The same for calls within a call that counts them.
    pub fn without_progress(&self) -> Self {
        Self { progress: None, limits: self.limits.clone() }
    }
}

/// A flag that cancels calls, shared by its clones. Once set it stays set: a later call takes a new flag.
#[derive(Debug, Clone, Default)]
pub struct CancelFlag(Arc<AtomicBool>);

impl CancelFlag {
    /// Cancels the calls that were given this flag.
    pub fn cancel(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    /// Whether it is set.
    pub fn is_cancelled(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}

/// When a call must stop.
#[derive(Debug, Clone, Default)]
struct Limits {
    cancel: Option<CancelFlag>,
    deadline: Option<Instant>,
}

impl Limits {
    fn check(&self) -> Result<()> {
        if self.cancel.as_ref().is_some_and(CancelFlag::is_cancelled) {
            return Err(Error::Cancelled);
        }
        match self.deadline {
            Some(deadline) if Instant::now() >= deadline => Err(Error::DeadlineExceeded),
            _ => Ok(()),
        }
    }
}

/// Counts the pieces of one stage of a call, and says when to stop.
#[derive(Debug, Clone, Default)]
pub struct Counter {
    count: Option<Arc<Count>>,
    limits: Limits,
}

impl Counter {
    /// So many more pieces are done.
    pub fn add(&self, number: usize) {
        if let Some(count) = &self.count {
            count.add(number);
        }
    }

    /// It turns out that there are so many pieces.
    pub fn set_total(&self, total: usize) {
        if let Some(count) = &self.count {
            count.set_total(total);
        }
    }

    /// Whether the call may go on.
    ///
    /// # Errors
    /// [`Error::Cancelled`] and [`Error::DeadlineExceeded`].
    pub fn check(&self) -> Result<()> {
        self.limits.check()
    }

    /// Whether the call must stop: [`Counter::check`] is and stays an error.
    pub fn is_stopped(&self) -> bool {
        self.check().is_err()
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;
    use crate::detect::tests::cylinder;
    use crate::{Builtin, EncodeOptions, MeshOptions, Model, Options};

    /// The built-in weights in a volume of 64³ voxels.
    fn model_of_64() -> Model {
        let file = safetensors::SafeTensors::deserialize(include_bytes!("../models/compact.safetensors")).unwrap();
        let mut metadata = Model::builtin(Builtin::Compact).metadata().clone();
        metadata.insert("resolution".into(), "[64, 64, 64]".into());
        let bytes = safetensors::serialize(file.tensors(), Some(metadata.into_iter().collect())).unwrap();
        Model::from_bytes(&bytes).unwrap()
    }

    /// Calls `call` once to its end, then cancelled and with a deadline at moments all over the time that it took, and
    /// asserts that half of the calls return soon after such a moment. A call that was stopped must not change what later
    /// calls return.
    fn assert_stops_soon<T: PartialEq + Send>(call: impl Fn(&Control) -> Result<T> + Sync) {
        const MOMENTS: u32 = 10;
        let expected = call(&Control::default()).unwrap();
        let start = Instant::now();
        assert!(call(&Control::default()).unwrap() == expected);
        let whole = start.elapsed();
        let mut delays = Vec::new();
        for moment in 0..MOMENTS {
            let pause = whole * moment / MOMENTS;
            let flag = CancelFlag::default();
            std::thread::scope(|scope| {
                let running = scope.spawn(|| (call(&Control::new().cancel(&flag)), Instant::now()));
                std::thread::sleep(pause);
                let cancelled = Instant::now();
                flag.cancel();
                match running.join().unwrap() {
                    (Ok(found), _) => assert!(found == expected, "cancelled after {pause:?}"),
                    (Err(error), end) => {
                        assert!(matches!(error, Error::Cancelled), "{error}");
                        delays.push(end.saturating_duration_since(cancelled));
                    }
                }
            });
            let deadline = Instant::now() + pause;
            match call(&Control::new().deadline(deadline)) {
                Ok(found) => assert!(found == expected, "deadline after {pause:?}"),
                Err(error) => {
                    assert!(matches!(error, Error::DeadlineExceeded), "{error}");
                    delays.push(deadline.elapsed());
                }
            }
        }
        assert!(call(&Control::default()).unwrap() == expected);
        // Later calls may be faster than the one that was timed.
        assert!(delays.len() > 4, "{} of the calls were stopped", delays.len());
        delays.sort();
        let median = delays[delays.len() / 2];
        // On a machine that is busy with other things everything takes longer.
        assert!(median < Duration::from_millis(50).max(whole / 4), "{median:?} of {whole:?}");
    }

    #[test]
    fn detection_stops_soon_and_leaves_nothing_behind() {
        let (points, _) = cylinder();
        let model = model_of_64();
        let mut whole = Options::default();
        whole.encode.rotations = 2;
        let mut windows = *Model::builtin(Builtin::Compact).recommended();
        windows.window_radius = Some(0.5.into());
        for (model, options) in [(&model, whole), (&Model::builtin(Builtin::Compact), windows)] {
            assert_stops_soon(|control| {
                model.detect_with(&points, &options, control).map(|detection| detection.keypoints)
            });
        }
    }

    #[test]
    fn encoding_and_meshes_stop_soon() {
        let (points, field) = cylinder();
        let model = model_of_64();
        assert_stops_soon(|control| {
            let field = model.encode_with(&points, &EncodeOptions::default(), control)?;
            Ok(field.volume().values.to_vec())
        });
        let options = MeshOptions::default();
        assert_stops_soon(|control| field.mesh_with(&options, control));
    }

    #[test]
    fn a_call_that_is_stopped_before_it_begins_does_nothing() {
        let (points, _) = cylinder();
        let model = Model::builtin(Builtin::Compact);
        let flag = CancelFlag::default();
        let late = Control::new().deadline(Instant::now());
        assert!(matches!(model.detect_with(&points, model.recommended(), &late), Err(Error::DeadlineExceeded)));
        flag.clone().cancel();
        let both = late.cancel(&flag);
        assert!(flag.is_cancelled());
        assert!(matches!(model.detect_with(&points, model.recommended(), &both), Err(Error::Cancelled)));
    }
}

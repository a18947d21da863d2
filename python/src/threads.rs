//! Threads and signals. Each process has its own thread pool, so that calls also work after a fork. Long calls handle
//! signals such as Ctrl-C while they run.

use std::time::{Duration, Instant};

use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use snake_core::{CancelFlag, Control, ProcessPool, Progress, Result, max_num_threads};

use crate::error::{py_error, value_error};

/// Python forks with the GIL held, and this pool is only used with the GIL held, so a child never inherits its lock.
static POOL: ProcessPool = ProcessPool::new();

/// Runs work of the core on this process's threads, with the GIL released. Every call of the core that may compute in
/// parallel must use it: on Rayon's global pool, the call would wait forever in a forked child.
pub fn run<T: Send>(py: Python<'_>, work: impl FnOnce() -> Result<T> + Send) -> PyResult<T> {
    let pool = POOL.get().map_err(py_error)?;
    py.detach(|| pool.install(work)).map_err(py_error)
}

/// Interval at which a call checks for signals: Ctrl-C must end the call within 0.2 s.
const SIGNAL_INTERVAL: Duration = Duration::from_millis(20);

/// The deadline of a call, and the function that is told of its progress.
#[derive(Default)]
pub struct Watch {
    deadline: Option<Instant>,
    /// Called with the name of the stage, the completed and all units of its work.
    progress: Option<Py<PyAny>>,
}

impl Watch {
    /// `deadline` is in seconds from now.
    pub fn new(deadline: Option<f64>, progress: Option<Py<PyAny>>) -> PyResult<Self> {
        let after =
            |seconds| Duration::try_from_secs_f64(seconds).ok().and_then(|time| Instant::now().checked_add(time));
        let refused = || PyValueError::new_err("deadline: expected a number of seconds, 0 or more");
        let deadline = deadline.map(|seconds| after(seconds).ok_or_else(refused)).transpose()?;
        Ok(Self { deadline, progress })
    }
}

/// [`run`] for long work that can be cancelled, see [`run_watched`].
pub fn run_with_signals<T: Send>(py: Python<'_>, work: impl FnOnce(&Control) -> Result<T> + Send) -> PyResult<T> {
    run_watched(py, Watch::default(), work)
}

/// [`run`] for long work that can be cancelled and watched. Python runs signal handlers only in its main thread and only
/// between its own instructions, so the calling thread takes the GIL every `SIGNAL_INTERVAL` to let them run. An
/// exception from a handler, such as KeyboardInterrupt, cancels the work and is raised when the work has stopped. Progress
/// is reported at the same times, and at the end.
pub fn run_watched<T: Send>(
    py: Python<'_>,
    watch: Watch,
    work: impl FnOnce(&Control) -> Result<T> + Send,
) -> PyResult<T> {
    let (pool, flag, stages) = (POOL.get().map_err(py_error)?, CancelFlag::default(), Progress::default());
    let control = Control::new().cancel(&flag).progress(&stages);
    let control = match watch.deadline {
        Some(deadline) => control.deadline(deadline),
        None => control,
    };
    let mut told = None;
    let mut tell = |py: Python<'_>| -> PyResult<()> {
        let stage = stages.stage().map(|stage| (stage.name, stage.done, stage.total));
        if let (Some(progress), Some(stage)) = (&watch.progress, stage)
            && told.replace(stage) != Some(stage)
        {
            progress.call1(py, stage)?;
        }
        Ok(())
    };
    py.detach(|| {
        let mut raised = None;
        let tick = || {
            if raised.is_none() {
                raised = Python::attach(|py| py.check_signals().and_then(|()| tell(py))).err();
                if raised.is_some() {
                    flag.cancel();
                }
            }
        };
        let result = snake_core::run_watched(&pool, SIGNAL_INTERVAL, tick, || work(&control));
        if result.is_ok() && raised.is_none() {
            raised = Python::attach(&mut tell).err();
        }
        raised.map_or_else(|| result.map_err(py_error), Err)
    })
}

/// Sets the number of threads that all calls of this process share, from the next call on. The default is
/// `RAYON_NUM_THREADS`, or else the number of processors that the process may use. A forked child keeps the number and
/// has its own threads. Results have the same bits for any number of threads. Raises ValueError if `num_threads` is 0,
/// or greater than both 256 and the number of processors.
#[pyfunction]
pub fn set_num_threads(num_threads: i64) -> PyResult<()> {
    match usize::try_from(num_threads) {
        Err(_) | Ok(0) => {
            Err(value_error(&format!("num_threads: {num_threads}: allowed is 1 to {}", max_num_threads())))
        }
        Ok(number) => POOL.set_num_threads(number).map_err(py_error),
    }
}

/// The number of threads that all calls of this process share. Raises ValueError when the threads cannot be started.
#[pyfunction]
pub fn get_num_threads() -> PyResult<usize> {
    Ok(POOL.get().map_err(py_error)?.current_num_threads())
}

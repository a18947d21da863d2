//! The threads of a process, and the largest number that a caller may request.

use std::mem::forget;
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::available_parallelism;
use std::time::Duration;

use rayon::{ThreadPool, ThreadPoolBuilder};

use crate::{Error, Result, SimdLevel};

/// Maximum number of threads on a machine with fewer processors: more threads would only wait for each other.
const MAX_THREADS: usize = 256;

/// The largest number of threads that a caller may request: 256, or the number of processors if that is larger.
pub fn max_num_threads() -> usize {
    available_parallelism().map_or(1, usize::from).max(MAX_THREADS)
}

/// The threads of all calls of a process. On Rayon's global pool, a call in a forked child would wait forever, because the
/// child has the memory of its parent but not its threads.
pub struct ProcessPool(Mutex<State>);

/// The number of threads that was set (0: the default), and the pool with the id of its process.
struct State {
    num_threads: usize,
    pool: Option<(u32, Arc<ThreadPool>)>,
}

impl ProcessPool {
    /// A pool that starts its threads at the first use.
    #[allow(clippy::new_without_default, reason = "it is made for a static")]
    pub const fn new() -> Self {
        Self(Mutex::new(State { num_threads: 0, pool: None }))
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The threads of this process. A forked child starts its own.
    ///
    /// # Errors
    /// [`Error::Input`] if the threads cannot be started, or if the environment names an unknown SIMD level.
    pub fn get(&self) -> Result<Arc<ThreadPool>> {
        let (mut state, process) = (self.state(), std::process::id());
        if let Some((owner, pool)) = &state.pool
            && *owner == process
        {
            return Ok(pool.clone());
        }
        SimdLevel::check_environment().map_err(|reason| Error::Input { what: "environment", reason })?;
        let pool = ThreadPoolBuilder::new().num_threads(state.num_threads).build();
        let pool = Arc::new(pool.map_err(|error| Error::Input { what: "num_threads", reason: error.to_string() })?);
        // At its first job, each thread initialises data that it shares with others; no child must be forked meanwhile.
        pool.broadcast(|_| ());
        // Dropping the parent's pool would signal threads that do not exist here.
        forget(state.pool.replace((process, pool.clone())));
        Ok(pool)
    }

    /// Sets the number of threads from the next call on; 0: `RAYON_NUM_THREADS`, or one per processor. A forked child keeps
    /// the number.
    ///
    /// # Errors
    /// [`Error::Input`] for a number above [`max_num_threads`].
    pub fn set_num_threads(&self, num_threads: usize) -> Result<()> {
        let most = max_num_threads();
        if num_threads > most {
            return Err(Error::Input { what: "num_threads", reason: format!("{num_threads}: allowed is 1 to {most}") });
        }
        let mut state = self.state();
        state.num_threads = num_threads;
        if let Some((process, pool)) = state.pool.take()
            && process != std::process::id()
        {
            forget(pool);
        }
        Ok(())
    }
}

/// Runs work on the threads of a pool. Until the work has ended, the calling thread calls `tick` every `interval`. A panic
/// in the work is passed on to the caller.
pub fn run_watched<T: Send>(
    pool: &ThreadPool,
    interval: Duration,
    mut tick: impl FnMut(),
    work: impl FnOnce() -> T + Send,
) -> T {
    let (done, ended) = channel();
    let result = pool.in_place_scope(|scope| {
        // The sender moves into the job: a panic drops it, which disconnects the receiver.
        scope.spawn(move |_| drop(done.send(work())));
        loop {
            match ended.recv_timeout(interval) {
                Ok(result) => return Some(result),
                Err(RecvTimeoutError::Timeout) => tick(),
                Err(RecvTimeoutError::Disconnected) => return None,
            }
        }
    });
    result.unwrap_or_else(|| unreachable!("the scope passes on the panic of its job"))
}

#[cfg(test)]
mod tests {
    use std::panic::{AssertUnwindSafe, catch_unwind};
    use std::time::Instant;

    use rayon::prelude::*;

    use super::*;

    #[test]
    fn a_panic_of_watched_work_goes_on_in_the_caller() {
        let pool = ThreadPoolBuilder::new().num_threads(2).build().unwrap();
        let start = Instant::now();
        let tick = || assert!(start.elapsed() < Duration::from_secs(60), "the work ended long ago");
        let work = || (0..9).into_par_iter().for_each(|index| assert_ne!(index, 7, "seven"));
        let watched = AssertUnwindSafe(|| run_watched(&pool, Duration::from_millis(1), tick, work));
        let panic = catch_unwind(watched).unwrap_err();
        assert!(panic.downcast_ref::<String>().is_some_and(|text| text.contains("seven")));
    }
}

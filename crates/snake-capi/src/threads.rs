//! The threads of all calls. Each process has its own, so that calls also work in a child after a fork.

use std::mem::forget;
use std::sync::{Arc, Mutex, PoisonError};

use rayon::{ThreadPool, ThreadPoolBuilder};
use snake_core::SimdLevel;

use crate::status::{Failure, Result, SnakeStatus, guarded};

/// The number of threads that was set (0: the default), and the pool with the id of its process.
struct State {
    num_threads: usize,
    pool: Option<(u32, Arc<ThreadPool>)>,
}

static STATE: Mutex<State> = Mutex::new(State { num_threads: 0, pool: None });

fn started(num_threads: usize) -> Result<Arc<ThreadPool>> {
    let pool = ThreadPoolBuilder::new().num_threads(num_threads).build();
    pool.map(Arc::new).map_err(|error| Failure::new(SnakeStatus::Argument, format!("num_threads: {error}")))
}

/// The pool of this process. A child after a fork has the memory of its parent but not its threads, so it starts its own.
fn pool() -> Result<Arc<ThreadPool>> {
    let mut state = STATE.lock().unwrap_or_else(PoisonError::into_inner);
    let process = std::process::id();
    if let Some((owner, pool)) = &state.pool
        && *owner == process
    {
        return Ok(pool.clone());
    }
    SimdLevel::check_environment().map_err(|reason| Failure::new(SnakeStatus::Argument, reason))?;
    let pool = started(state.num_threads)?;
    // Dropping the parent's pool would signal threads that do not exist here.
    forget(state.pool.replace((process, pool.clone())));
    Ok(pool)
}

/// Runs work on the threads of this process. On Rayon's global pool it would wait forever in a child after a fork.
pub(crate) fn run<T: Send>(work: impl FnOnce() -> Result<T> + Send) -> Result<T> {
    pool()?.install(work)
}

/// Sets the number of threads of all calls, from the next one on; 0: one for each core. At most 256, or the number of cores.
/// The environment variable `RAYON_NUM_THREADS` does the same. A child after a fork keeps the number and has threads of its own.
#[unsafe(no_mangle)]
pub extern "C" fn snake_set_num_threads(num_threads: usize) -> SnakeStatus {
    guarded(|| {
        if num_threads > 0 {
            let refused = |error: snake_core::Error| Failure::new(SnakeStatus::Argument, error.to_string());
            snake_core::check_num_threads(num_threads).map_err(refused)?;
        }
        let pool = started(num_threads)?;
        let mut state = STATE.lock().unwrap_or_else(PoisonError::into_inner);
        let process = std::process::id();
        state.num_threads = num_threads;
        match state.pool.replace((process, pool)) {
            // The threads of a parent do not exist here.
            Some((owner, pool)) if owner != process => forget(pool),
            _ => {}
        }
        Ok(())
    })
}

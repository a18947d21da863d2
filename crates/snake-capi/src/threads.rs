//! The threads of all calls. Each process has its own threads, so calls also work in a forked child.

use snake_core::{Error, ProcessPool};

use crate::status::{Failure, Result, SnakeStatus, guarded};

static POOL: ProcessPool = ProcessPool::new();

fn refused(error: Error) -> Failure {
    Failure::new(SnakeStatus::Argument, error.to_string())
}

/// Runs work on the threads of this process. On Rayon's global pool, it would wait forever in a forked child.
pub(crate) fn run<T: Send>(work: impl FnOnce() -> Result<T> + Send) -> Result<T> {
    POOL.get().map_err(refused)?.install(work)
}

/// Sets the number of threads of all calls, from the next one on; 0: one for each core. At most 256, or the number of cores.
/// The environment variable `RAYON_NUM_THREADS` does the same. A child after a fork keeps the number and has threads of its own.
#[unsafe(no_mangle)]
pub extern "C" fn snake_set_num_threads(num_threads: usize) -> SnakeStatus {
    guarded(|| POOL.set_num_threads(num_threads).map_err(refused))
}

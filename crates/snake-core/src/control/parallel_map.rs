//! Independent tasks in parallel, each on one thread.

use std::panic::resume_unwind;
use std::sync::atomic::{AtomicUsize, Ordering};

use rayon::{ThreadPool, ThreadPoolBuilder};

use crate::Result;

/// The results of `task(0)` to `task(number - 1)`, in order.
///
/// ```
/// let squares = snake_core::parallel_map(100, |index| Ok(index * index))?;
/// assert_eq!(squares[99], 9801);
/// # Ok::<(), snake_core::Error>(())
/// ```
///
/// Each task runs on one thread, and as many tasks run at a time as there are threads. This is faster than parallel steps
/// within each task, some of which are serial. With too few tasks for all threads, the tasks run one after the other,
/// each on all threads.
///
/// # Errors
/// The error of the first task that fails; later tasks may then not run.
pub fn parallel_map<T: Send>(number: usize, task: impl Fn(usize) -> Result<T> + Sync) -> Result<Vec<T>> {
    let threads = rayon::current_num_threads();
    let alone = || ThreadPoolBuilder::new().num_threads(1).build();
    let is_worth_it = threads > 1 && number >= 2 * threads;
    let pools: Option<Vec<ThreadPool>> = is_worth_it.then(|| (0..threads).map(|_| alone().ok()).collect()).flatten();
    let Some(pools) = pools else { return (0..number).map(task).collect() };
    let next = AtomicUsize::new(0);
    let take_tasks = || {
        let mut results = Vec::new();
        loop {
            let index = next.fetch_add(1, Ordering::Relaxed);
            if index >= number {
                return results;
            }
            let result = task(index);
            if result.is_err() {
                // Tasks begin in order, so all earlier tasks are done or running.
                next.store(number, Ordering::Relaxed);
            }
            results.push((index, result));
        }
    };
    let mut results = std::thread::scope(|scope| {
        let running: Vec<_> = pools.iter().map(|pool| scope.spawn(|| pool.install(take_tasks))).collect();
        let results = running.into_iter().flat_map(|thread| thread.join().unwrap_or_else(|panic| resume_unwind(panic)));
        results.collect::<Vec<_>>()
    });
    results.sort_unstable_by_key(|(index, _)| *index);
    results.into_iter().map(|(_, result)| result).collect()
}

#[cfg(test)]
mod tests {
    use std::time::{Duration, Instant};

    use super::*;
    use crate::Error;

    fn on_threads<T: Send>(threads: usize, work: impl FnOnce() -> T + Send) -> T {
        ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(work)
    }

    #[test]
    fn results_are_in_order_and_the_first_error_counts() {
        for threads in [1, 2, 3, 8] {
            for number in [0, 1, 5, 16, 100] {
                let squares = on_threads(threads, || parallel_map(number, |index| Ok(index * index)));
                assert_eq!(squares.unwrap(), (0..number).map(|index| index * index).collect::<Vec<_>>());
                let odd = |index: usize| match index {
                    7.. if index % 2 == 1 => Err(Error::Input { what: "task", reason: index.to_string() }),
                    _ => Ok(index),
                };
                let error = on_threads(threads, || parallel_map(number, odd)).err().map(|error| error.to_string());
                assert_eq!(error, (number > 7).then(|| "task: 7".into()), "{threads} {number}");
            }
        }
    }

    #[test]
    fn many_tasks_have_one_thread_each_and_few_have_all() {
        let threads = |number| on_threads(4, || parallel_map(number, |_| Ok(rayon::current_num_threads())).unwrap());
        assert_eq!((threads(8), threads(7)), (vec![1; 8], vec![4; 7]));
    }

    #[test]
    fn at_most_as_many_tasks_run_as_threads() {
        let (running, most) = (AtomicUsize::new(0), AtomicUsize::new(0));
        let start = Instant::now();
        let task = |_| {
            most.fetch_max(running.fetch_add(1, Ordering::SeqCst) + 1, Ordering::SeqCst);
            // On a busy machine a thread may begin late; the others wait for it.
            while most.load(Ordering::SeqCst) < 3 && start.elapsed() < Duration::from_secs(60) {
                std::thread::sleep(Duration::from_millis(1));
            }
            std::thread::sleep(Duration::from_millis(1));
            running.fetch_sub(1, Ordering::SeqCst);
            Ok(())
        };
        on_threads(3, || parallel_map(60, task)).unwrap();
        assert_eq!(most.into_inner(), 3);
    }
}

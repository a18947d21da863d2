//! The number of threads that a caller may ask for.

use std::thread::available_parallelism;

use crate::{Error, Result};

/// Maximum number of threads on a machine with fewer processors: more threads would only wait for each other.
const MAX_THREADS: usize = 256;

/// Refuses a number of threads that is 0, or greater than both 256 and the number of processors.
///
/// # Errors
/// [`Error::Input`], with the allowed numbers.
pub fn check_num_threads(num_threads: usize) -> Result<()> {
    let most = available_parallelism().map_or(1, usize::from).max(MAX_THREADS);
    if (1..=most).contains(&num_threads) {
        return Ok(());
    }
    Err(Error::Input { what: "num_threads", reason: format!("{num_threads}: allowed is 1 to {most}") })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn impossible_numbers_of_threads_are_refused_with_the_range() {
        assert!(check_num_threads(1).is_ok() && check_num_threads(MAX_THREADS).is_ok());
        for number in [0, 3_000_000, usize::MAX] {
            let error = check_num_threads(number).unwrap_err().to_string();
            assert!(error.starts_with(&format!("num_threads: {number}: allowed is 1 to ")), "{error}");
        }
    }
}

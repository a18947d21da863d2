//! Reuse of the memory of volumes: the operating system zeroes new memory page by page, which takes time.

use std::mem::take;
use std::ops::{Deref, DerefMut};
use std::sync::{Arc, Mutex, MutexGuard, TryLockError};

/// Unused buffers; clones share them.
#[derive(Debug, Clone, Default)]
pub struct BufferPool(Arc<Mutex<Vec<Vec<f32>>>>);

/// Values of a volume. Dropping them returns their memory to the pool.
#[derive(Debug)]
pub struct Buffer {
    values: Vec<f32>,
    pool: BufferPool,
}

impl BufferPool {
    /// Maximum number of unused buffers of one length in the pool: one cloud uses no more at a time.
    const KEPT: usize = 4;

    /// Maximum number of values in all unused buffers of the pool: 512 MiB. The oldest buffers are freed first.
    const LONGEST: usize = 1 << 27;

    /// A buffer of `length` values, whose contents are arbitrary.
    pub fn take(&self, length: usize) -> Buffer {
        let values = self.unused().and_then(|mut unused| {
            // The volumes of scenes differ in length: a buffer up to twice as long is also used.
            let same = unused.iter().position(|values| values.len() == length);
            let place =
                same.or_else(|| unused.iter().position(|values| (length..=2 * length).contains(&values.capacity())));
            if place.is_none() {
                // A new, longer buffer replaces the unused ones that are at least half as long.
                unused.retain(|values| !(length.div_ceil(2)..length).contains(&values.capacity()));
            }
            Some(unused.remove(place?))
        });
        let mut values = values.unwrap_or_else(|| fresh(length));
        values.resize(length, 0.0);
        Buffer { values, pool: self.clone() }
    }

    /// The unused buffers, or `None` while another thread holds the lock. It never waits: in a forked child that thread
    /// does not exist and would never release the lock.
    fn unused(&self) -> Option<MutexGuard<'_, Vec<Vec<f32>>>> {
        match self.0.try_lock() {
            Ok(unused) => Some(unused),
            Err(TryLockError::Poisoned(unused)) => Some(unused.into_inner()),
            Err(TryLockError::WouldBlock) => None,
        }
    }
}

/// Zeros in memory for which the operating system is advised to use huge pages, if it can. A page is zeroed when it is first
/// written, and 512 small pages take several times as long as one of 2 MiB.
fn fresh(length: usize) -> Vec<f32> {
    let values = vec![0.0; length];
    #[cfg(all(target_os = "linux", not(miri)))]
    {
        let size = std::mem::size_of_val(&values[..]);
        let start = values.as_ptr().addr().next_multiple_of(HUGE_PAGE);
        let end = (values.as_ptr().addr() + size) / HUGE_PAGE * HUGE_PAGE;
        if start < end {
            // SAFETY: the pages lie within the vector, and the advice changes no values.
            unsafe { libc::madvise(start as *mut libc::c_void, end - start, libc::MADV_HUGEPAGE) };
        }
    }
    values
}

/// Zeros, and the index of the first value at the start of a huge page, if the operating system provides these. At least `length`
/// values follow it. A processor caches the addresses of fewer than a hundred small pages.
pub(crate) fn in_huge_page(length: usize) -> (Vec<f32>, usize) {
    let page = HUGE_PAGE / size_of::<f32>();
    let values = fresh(length.next_multiple_of(page) + page);
    let address = values.as_ptr().addr();
    let first = (address.next_multiple_of(HUGE_PAGE) - address) / size_of::<f32>();
    (values, first)
}

/// The size of a huge page on most processors, in bytes.
const HUGE_PAGE: usize = 2 << 20;

impl Buffer {
    /// Keeps only the first `length` values.
    pub fn truncate(&mut self, length: usize) {
        self.values.truncate(length);
    }
}

impl Drop for Buffer {
    fn drop(&mut self) {
        if let Some(mut unused) = self.pool.unused()
            && unused.iter().filter(|values| values.len() == self.values.len()).count() < BufferPool::KEPT
        {
            unused.push(take(&mut self.values));
            while unused.iter().map(Vec::capacity).sum::<usize>() > BufferPool::LONGEST {
                unused.remove(0);
            }
        }
    }
}

impl Clone for Buffer {
    fn clone(&self) -> Self {
        let mut copy = self.pool.take(self.len());
        copy.copy_from_slice(self);
        copy
    }
}

impl Deref for Buffer {
    type Target = [f32];

    fn deref(&self) -> &[f32] {
        &self.values
    }
}

impl DerefMut for Buffer {
    fn deref_mut(&mut self) -> &mut [f32] {
        &mut self.values
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_waits_for_a_pool_that_is_locked_for_good() {
        let pool = BufferPool::default();
        let _another_thread = pool.0.lock().unwrap();
        drop(pool.take(3).clone());
    }

    #[test]
    fn a_huge_page_begins_at_the_first_value_and_all_values_fit() {
        for length in [1, 1000, HUGE_PAGE / 4, HUGE_PAGE / 4 + 1] {
            let (values, first) = in_huge_page(length);
            assert!(values[first..].as_ptr().addr().is_multiple_of(HUGE_PAGE) && values.len() >= first + length);
        }
    }

    #[test]
    fn a_dropped_buffer_is_used_again_for_the_same_length() {
        let pool = BufferPool::default();
        let mut first = pool.take(3);
        first.copy_from_slice(&[1.0, 2.0, 3.0]);
        let copy = first.clone();
        drop(first);
        assert_eq!(*copy, [1.0, 2.0, 3.0]);
        assert_eq!(*pool.take(1), [0.0]);
        assert_eq!(*pool.take(3), [1.0, 2.0, 3.0]);
        assert_eq!(*pool.take(2), [1.0, 2.0]);
        // A longer buffer replaces one that is nearly as long.
        let count = || pool.0.lock().unwrap().len();
        assert_eq!(count(), 2);
        drop(pool.take(4));
        assert_eq!(count(), 2);
        drop((0..10).map(|_| pool.take(5)).collect::<Vec<_>>());
        assert_eq!(pool.0.lock().unwrap().iter().filter(|values| values.len() == 5).count(), BufferPool::KEPT);
    }
}

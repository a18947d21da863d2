//! Short-lived buffers, whose memory each thread keeps for the next ones.

use std::cell::RefCell;
use std::mem::take;
use std::ops::{Deref, DerefMut};

use crate::trilinear::Corners;

/// A type of which each thread keeps unused buffers.
pub trait Element: Copy + Default + Sized + 'static {
    /// Calls a function with the unused buffers of this thread, unless the thread is ending.
    #[doc(hidden)]
    fn with_unused<R>(function: impl FnOnce(&RefCell<Vec<Vec<Self>>>) -> R) -> Option<R>;
}

/// Implements [`Element`] for each type.
#[macro_export]
macro_rules! scratch_elements {
    ($($element:ty),*) => {
        $(impl $crate::Element for $element {
            fn with_unused<R>(function: impl FnOnce(&::std::cell::RefCell<Vec<Vec<Self>>>) -> R) -> Option<R> {
                thread_local! {
                    static UNUSED: ::std::cell::RefCell<Vec<Vec<$element>>> = const { ::std::cell::RefCell::new(Vec::new()) };
                }
                UNUSED.try_with(function).ok()
            }
        })*
    };
}
scratch_elements!(bool, f32, f64, u32, usize, Option<u32>, (f32, usize), (u64, u32), [f32; 3], [f64; 2], Corners);

/// Values of a few tiles of queries or points, or of a small volume. Dropping them leaves their memory to the thread.
#[derive(Debug, Default, PartialEq)]
pub struct Scratch<T: Element>(Vec<T>);

impl<T: Element> Scratch<T> {
    /// A thread keeps at most this many unused buffers of a type.
    const KEPT: usize = 32;
    /// New buffers have space for this many values at least, and shorter ones are not kept: 64 KiB of `f32`.
    const SHORTEST: usize = 1 << 14;
    /// Longer buffers are not kept: 4 MiB of `f32`.
    const LONGEST: usize = 1 << 20;

    /// A buffer of `length` default values, which are zeros for numbers.
    pub fn zeros(length: usize) -> Self {
        let mut scratch = Self::empty(length);
        scratch.0.resize(length, T::default());
        scratch
    }

    /// A buffer of `length` arbitrary values, for a function that writes all of them.
    pub fn arbitrary(length: usize) -> Self {
        let mut scratch = Self::unused(length);
        scratch.0.resize(length, T::default());
        scratch
    }

    /// A copy of values.
    pub fn copy_of(values: &[T]) -> Self {
        Self::collect(values.len(), values.iter().copied())
    }

    /// The same values in no more memory than they need, for values that are kept for long.
    pub fn compact(&self) -> Self {
        Self(self.0.clone())
    }

    /// The values of an iterator, about `length` of them.
    pub fn collect(length: usize, values: impl Iterator<Item = T>) -> Self {
        let mut scratch = Self::empty(length);
        scratch.0.extend(values);
        scratch
    }

    /// Keeps the values that fulfil a condition.
    pub fn retain(&mut self, is_kept: impl FnMut(&T) -> bool) {
        self.0.retain(is_kept);
    }

    /// Removes all values.
    pub fn clear(&mut self) {
        self.0.clear();
    }

    /// Appends the values of an iterator.
    pub fn extend(&mut self, values: impl Iterator<Item = T>) {
        self.0.extend(values);
    }

    /// Appends values.
    pub fn extend_from_slice(&mut self, values: &[T]) {
        self.0.extend_from_slice(values);
    }

    /// A buffer without values that has space for `length` of them.
    pub fn empty(length: usize) -> Self {
        let mut scratch = Self::unused(length);
        scratch.0.clear();
        scratch
    }

    /// A buffer with its old values that has space for `length`: the smallest unused one that is large enough, or else the
    /// largest, which grows. A thread so has no more buffers than it uses at a time.
    fn unused(length: usize) -> Self {
        let best = |unused: &RefCell<Vec<Vec<T>>>| {
            let mut unused = unused.borrow_mut();
            let rank = |values: &Vec<T>| match values.capacity() {
                capacity if capacity >= length => (0, capacity),
                capacity => (1, usize::MAX - capacity),
            };
            let place = (0..unused.len()).min_by_key(|&place| rank(&unused[place]))?;
            Some(unused.swap_remove(place))
        };
        let mut values = T::with_unused(best).flatten().unwrap_or_default();
        if values.capacity() < length {
            values.clear();
            values.reserve_exact(Self::capacity_for(length));
        }
        Self(values)
    }

    /// The capacity of a buffer for `length` values. Lengths differ from cloud to cloud: with few capacities, few clouds need
    /// more memory than those before.
    fn capacity_for(length: usize) -> usize {
        let mut capacities = (Self::SHORTEST.ilog2()..=Self::LONGEST.ilog2()).step_by(2).map(|bits| 1 << bits);
        capacities.find(|capacity| *capacity >= length).unwrap_or(length)
    }
}

impl<T: Element> Drop for Scratch<T> {
    fn drop(&mut self) {
        T::with_unused(|unused| {
            let mut unused = unused.borrow_mut();
            if unused.len() < Self::KEPT && (Self::SHORTEST..=Self::LONGEST).contains(&self.0.capacity()) {
                unused.push(take(&mut self.0));
            }
        });
    }
}

impl<T: Element> Clone for Scratch<T> {
    fn clone(&self) -> Self {
        Self::copy_of(self)
    }
}

impl<T: Element> Deref for Scratch<T> {
    type Target = [T];

    fn deref(&self) -> &[T] {
        &self.0
    }
}

impl<T: Element> DerefMut for Scratch<T> {
    fn deref_mut(&mut self) -> &mut [T] {
        &mut self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_is_used_again_and_zeros_are_zeros() {
        std::thread::spawn(|| {
            let mut first = Scratch::zeros(100);
            first.fill(7.0);
            let address = first.as_ptr();
            drop((first, Scratch::<f32>::zeros(1 << 15)));
            let second = Scratch::zeros(90);
            assert_eq!((second.as_ptr(), &second[..]), (address, &[0.0; 90][..]));
            assert!(second.compact().0.capacity() == 90 && second.compact() == second);
            assert_eq!(Scratch::copy_of(&[1.0, 2.0])[..], [1.0, 2.0]);
        })
        .join()
        .unwrap();
    }

    #[test]
    fn a_thread_keeps_few_buffers_and_no_long_ones() {
        std::thread::spawn(|| {
            drop(Scratch::<usize>::zeros(Scratch::<usize>::LONGEST + 1));
            drop(Scratch::<usize>::zeros(5).compact());
            usize::with_unused(|unused| assert_eq!(unused.borrow().len(), 1));
            drop((0..100).map(|_| Scratch::<usize>::zeros(5)).collect::<Vec<_>>());
            usize::with_unused(|unused| assert_eq!(unused.borrow().len(), Scratch::<usize>::KEPT));
        })
        .join()
        .unwrap();
    }

    #[test]
    fn buffers_that_are_too_short_grow() {
        std::thread::spawn(|| {
            for length in [1, 1 << 14, (1 << 14) + 1, 70_000, 1 << 20] {
                drop((Scratch::<u32>::zeros(length), Scratch::<u32>::zeros(3)));
                u32::with_unused(|unused| assert_eq!(unused.borrow().len(), 2));
            }
        })
        .join()
        .unwrap();
    }
}

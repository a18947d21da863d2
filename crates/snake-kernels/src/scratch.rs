//! Short-lived buffers, whose memory each thread keeps for the next ones.

use std::cell::RefCell;
use std::mem::take;
use std::ops::{Deref, DerefMut};

use crate::trilinear::Corners;

/// The unused buffers of a thread.
type Unused<T> = RefCell<Vec<Vec<T>>>;

/// A type of which each thread keeps unused buffers.
pub trait Element: Copy + Default + Sized + 'static {
    /// Calls a function with the unused buffers of this thread, unless the thread is ending.
    #[doc(hidden)]
    fn with_unused<R>(function: impl FnOnce(&Unused<Self>) -> R) -> Option<R>;
}

/// Implements [`Element`] for each type.
macro_rules! elements {
    ($($element:ty),*) => {
        $(impl Element for $element {
            fn with_unused<R>(function: impl FnOnce(&Unused<Self>) -> R) -> Option<R> {
                thread_local! {
                    static UNUSED: Unused<$element> = const { RefCell::new(Vec::new()) };
                }
                UNUSED.try_with(function).ok()
            }
        })*
    };
}
elements!(f32, u32, usize, [f32; 3], [f64; 2], Corners);

/// Values of a few tiles of queries or points. Dropping them leaves their memory to the thread.
#[derive(Debug, Default)]
pub struct Scratch<T: Element>(Vec<T>);

impl<T: Element> Scratch<T> {
    /// A thread keeps at most this many unused buffers of a type.
    const KEPT: usize = 32;
    /// Longer buffers are not kept: 4 MiB of `f32`.
    const LONGEST: usize = 1 << 20;

    /// A buffer of `length` default values, which are zeros for numbers.
    pub fn zeros(length: usize) -> Self {
        let mut scratch = Self::empty(length);
        scratch.0.resize(length, T::default());
        scratch
    }

    /// A copy of values.
    pub fn copy_of(values: &[T]) -> Self {
        Self::collect(values.len(), values.iter().copied())
    }

    /// The values of an iterator, about `length` of them.
    pub fn collect(length: usize, values: impl Iterator<Item = T>) -> Self {
        let mut scratch = Self::empty(length);
        scratch.0.extend(values);
        scratch
    }

    /// Appends values.
    pub fn extend_from_slice(&mut self, values: &[T]) {
        self.0.extend_from_slice(values);
    }

    /// A buffer without values that has space for `length` of them: the smallest unused buffer that is large enough.
    pub fn empty(length: usize) -> Self {
        let fitting = |unused: &Unused<T>| {
            let mut unused = unused.borrow_mut();
            let fits = unused.iter().enumerate().filter(|(_, values)| values.capacity() >= length);
            let place = fits.min_by_key(|(_, values)| values.capacity()).map(|(place, _)| place)?;
            Some(unused.swap_remove(place))
        };
        let mut values = T::with_unused(fitting).flatten().unwrap_or_else(|| Vec::with_capacity(length));
        values.clear();
        Self(values)
    }
}

impl<T: Element> Drop for Scratch<T> {
    fn drop(&mut self) {
        T::with_unused(|unused| {
            let mut unused = unused.borrow_mut();
            if unused.len() < Self::KEPT && self.0.capacity() <= Self::LONGEST {
                unused.push(take(&mut self.0));
            }
        });
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
            drop((first, Scratch::<f32>::zeros(1000)));
            let second = Scratch::zeros(90);
            assert_eq!((second.as_ptr(), &second[..]), (address, &[0.0; 90][..]));
            assert_eq!(Scratch::copy_of(&[1.0, 2.0])[..], [1.0, 2.0]);
        })
        .join()
        .unwrap();
    }

    #[test]
    fn a_thread_keeps_few_buffers_and_no_long_ones() {
        std::thread::spawn(|| {
            drop((0..100).map(|_| Scratch::<usize>::zeros(5)).collect::<Vec<_>>());
            drop(Scratch::<usize>::zeros(Scratch::<usize>::LONGEST + 1));
            usize::with_unused(|unused| {
                assert_eq!(unused.borrow().len(), Scratch::<usize>::KEPT);
                assert!(unused.borrow().iter().all(|values| values.capacity() <= Scratch::<usize>::LONGEST));
            });
        })
        .join()
        .unwrap();
    }
}

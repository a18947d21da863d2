//! Loops in parallel. rayon's loop is compiled once, for parts of any loop: its iterators, compiled anew at every place, took a
//! fourth of the time to compile.

use std::convert::Infallible;
use std::ops::Range;
use std::sync::{Mutex, PoisonError};

use rayon::prelude::*;

/// Number of parts of a loop for each thread.
const PARTS: usize = 16;

/// A range, a slice's iterator, or some of them zipped. It is cloned for each part, which begins at its first item.
pub trait Items: ExactSizeIterator + Clone + Sync {}

impl<I: ExactSizeIterator + Clone + Sync> Items for I {}

/// `of` each item, in parallel, in the order of the items.
pub fn in_parallel<I: Items, R: Send>(items: I, of: impl Fn(I::Item) -> R + Sync) -> Vec<R> {
    some_in_parallel(items, |item| Some(of(item)))
}

/// [`in_parallel`], without the items that have no result.
pub fn some_in_parallel<I: Items, R: Send>(items: I, of: impl Fn(I::Item) -> Option<R> + Sync) -> Vec<R> {
    let all = of_parts::<R, Infallible>(items.len(), &|part, results| {
        for item in items.clone().skip(part.start).take(part.len()) {
            results.extend(of(item));
        }
        Ok(())
    });
    all.unwrap_or_else(|never| match never {})
}

/// [`in_parallel`] of what may fail. A part ends at its first error.
///
/// # Errors
/// The first error in the order of the items.
pub fn try_in_parallel<I: Items, R: Send, E: Send>(
    items: I,
    of: impl Fn(I::Item) -> Result<R, E> + Sync,
) -> Result<Vec<R>, E> {
    of_parts(items.len(), &|part, results| {
        for item in items.clone().skip(part.start).take(part.len()) {
            results.push(of(item)?);
        }
        Ok(())
    })
}

/// Writes the results of a part of the items.
type OfPart<'a, R, E> = &'a (dyn Fn(Range<usize>, &mut Vec<R>) -> Result<(), E> + Sync);

fn of_parts<R: Send, E: Send>(number: usize, of_part: OfPart<R, E>) -> Result<Vec<R>, E> {
    let size = number.div_ceil(PARTS * rayon::current_num_threads()).max(1);
    let parts: Vec<Mutex<Result<Vec<R>, E>>> = (0..number.div_ceil(size)).map(|_| Mutex::new(Ok(Vec::new()))).collect();
    for_each(parts.len(), &|part| {
        let items = part * size..number.min((part + 1) * size);
        let mut results = Vec::with_capacity(items.len());
        let done = of_part(items, &mut results);
        *parts[part].lock().unwrap_or_else(PoisonError::into_inner) = done.map(|()| results);
    });
    let mut all = Vec::with_capacity(number);
    for part in parts {
        all.append(&mut part.into_inner().unwrap_or_else(PoisonError::into_inner)?);
    }
    Ok(all)
}

/// What is done with the number of a chunk and the chunk.
type OfChunk<'a, T, R> = &'a (dyn Fn(usize, &mut [T]) -> R + Sync);

/// `of` the number of each chunk of `size` values and the chunk, in parallel. The last one may be shorter.
pub fn chunks_in_parallel<T: Send>(values: &mut [T], size: usize, of: OfChunk<T, ()>) {
    values.par_chunks_mut(size).enumerate().for_each(|(number, chunk)| of(number, chunk));
}

/// [`chunks_in_parallel`] of what may fail.
///
/// # Errors
/// One of the errors.
pub fn try_chunks_in_parallel<T: Send, E: Send>(
    values: &mut [T],
    size: usize,
    of: OfChunk<T, Result<(), E>>,
) -> Result<(), E> {
    values.par_chunks_mut(size).enumerate().try_for_each(|(number, chunk)| of(number, chunk))
}

fn for_each(number: usize, task: &(dyn Fn(usize) + Sync)) {
    (0..number).into_par_iter().for_each(task);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_are_in_order_and_the_first_error_is_told() {
        for number in [0, 1, 255, 256, 257, 3000] {
            let expected: Vec<usize> = (0..number).map(|i| i * i).collect();
            assert_eq!(in_parallel(0..number, |i| i * i), expected);
            assert_eq!(in_parallel(expected.iter().zip(0..number), |(square, i)| square - i * i), vec![0; number]);
            let even = |i: usize| i.is_multiple_of(2).then_some(i);
            assert_eq!(some_in_parallel((0..number).step_by(3), even), (0..number).step_by(6).collect::<Vec<_>>());
            let below = |most: usize| move |i| if i < most { Ok(i) } else { Err(i) };
            assert_eq!(try_in_parallel(0..number, below(number)), Ok((0..number).collect()));
            assert_eq!(
                try_in_parallel(0..number, below(number / 2)),
                if number > 0 { Err(number / 2) } else { Ok(vec![]) }
            );
        }
    }
}

//! Farthest-point sampling.

use rayon::prelude::*;

use crate::Point;

/// Number of points that one thread compares with the last choice.
const SHARE: usize = 1 << 13;

/// At most `number` distinct finite points, each the farthest from all earlier ones. Returns their indices and their squared
/// distances from the earlier ones; that of the first is infinite.
///
/// The first point is the farthest from the mean, so the choice rotates with the cloud. Among equally far points the
/// lowest index is taken. `check` is called before each choice.
///
/// # Errors
/// The errors of `check`.
pub fn farthest_points<E>(
    points: &[Point],
    number: usize,
    check: impl Fn() -> Result<(), E>,
) -> Result<Vec<(usize, f64)>, E> {
    let mut mean = [0.0; 3];
    points.iter().for_each(|point| (0..3).for_each(|axis| mean[axis] += f64::from(point[axis])));
    mean = mean.map(|sum| sum / points.len() as f64);
    let squared =
        |point: &Point, from: [f64; 3]| (0..3).map(|axis| (f64::from(point[axis]) - from[axis]).powi(2)).sum::<f64>();
    let farther = |a: (usize, f64), b: (usize, f64)| if b.1 > a.1 || b.1 == a.1 && b.0 < a.0 { b } else { a };
    let mut nearest = vec![f64::INFINITY; points.len()];
    let mut next = points.iter().map(|point| squared(point, mean)).enumerate().reduce(farther).map(|(index, _)| index);
    let mut chosen = Vec::new();
    while let Some(index) = next
        && chosen.len() < number
    {
        check()?;
        chosen.push((index, nearest[index]));
        let last = points[index].map(f64::from);
        let shares = nearest.par_chunks_mut(SHARE).zip(points.par_chunks(SHARE)).enumerate();
        let farthest = shares.filter_map(|(share, (nearest, points))| {
            nearest.iter_mut().zip(points).for_each(|(nearest, point)| *nearest = nearest.min(squared(point, last)));
            nearest.iter().enumerate().map(|(i, &gap)| (share * SHARE + i, gap)).reduce(farther)
        });
        next = farthest.reduce_with(farther).filter(|(_, gap)| *gap > 0.0).map(|(index, _)| index);
    }
    Ok(chosen)
}

//! Random samples of clouds.

use rand::seq::index;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use snake_kernels::Scratch;

use crate::Point;

/// `number` of the points, drawn at random without replacement, in their order. `number` is less than that of the points.
pub fn sample(points: &[Point], number: usize, seed: u64) -> Scratch<Point> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    if let Some(length) = u32::try_from(points.len()).ok().filter(|&length| is_swapped(length, number)) {
        let mut indices = Scratch::collect(points.len(), 0..length);
        for (place, first) in (0..length).take(number).enumerate() {
            let drawn = rng.random_range(first..length);
            indices.swap(place, drawn as usize);
        }
        let drawn = &mut indices[..number];
        drawn.sort_unstable();
        return Scratch::collect(number, drawn.iter().map(|&index| points[index as usize]));
    }
    let mut drawn = index::sample(&mut rng, points.len(), number).into_vec();
    drawn.sort_unstable();
    Scratch::collect(number, drawn.into_iter().map(|index| points[index]))
}

/// Whether `rand` draws by swapping indices, as for a share of a sweep. It allocates for it, which [`sample`] does not; the
/// points are the same.
fn is_swapped(length: u32, number: usize) -> bool {
    let most = if length < 500_000 { 270.0 } else { 330.0 / 9.0 };
    number >= 163 && (length as f32) < most * number as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_are_those_of_rand() {
        let points: Vec<Point> = (0..600_000).map(|i| [i as f32, 0.0, 0.0]).collect();
        for (length, number) in [
            (2, 1),
            (300, 162),
            (300, 163),
            (300, 299),
            (50_000, 185),
            (50_000, 186),
            (120_000, 16_384),
            (499_999, 1851),
            (499_999, 1852),
            (600_000, 16_000),
            (600_000, 17_000),
        ] {
            for seed in [0, 7] {
                let rng = &mut ChaCha8Rng::seed_from_u64(seed);
                let mut expected = index::sample(rng, length, number).into_vec();
                expected.sort_unstable();
                let found = sample(&points[..length], number, seed);
                let indices: Vec<usize> = found.iter().map(|point| point[0] as usize).collect();
                assert_eq!(indices, expected, "{number} of {length}");
            }
        }
    }
}

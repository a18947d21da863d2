//! Random samples of clouds.

use chacha20::ChaCha8Rng;
use rand::SeedableRng;
use rand::seq::index;

use crate::Point;

/// `number` points, drawn at random without replacement, in the order of the cloud. `number` is at most their count.
pub fn sample(points: &[Point], number: usize, seed: u64) -> Vec<Point> {
    let mut drawn = index::sample(&mut ChaCha8Rng::seed_from_u64(seed), points.len(), number).into_vec();
    drawn.sort_unstable();
    drawn.into_iter().map(|index| points[index]).collect()
}

/// At most `most` of the finite points, none of them twice, in an order that looks random. They depend only on coordinates: neither the
/// order of the cloud nor copies of its points matter.
pub fn drawn(points: &[Point], most: usize) -> Vec<Point> {
    let mut share = 2.0 * most as f64 / points.len() as f64;
    loop {
        let limit = (share * u64::MAX as f64) as u64;
        let finite = points.iter().filter(|point| point.iter().all(|v| v.is_finite()));
        let mut drawn: Vec<(u64, [u32; 3])> =
            finite.map(|point| (lot(point), point.map(f32::to_bits))).filter(|(lot, _)| *lot <= limit).collect();
        drawn.sort_unstable();
        drawn.dedup();
        if drawn.len() >= most || share >= 1.0 || points.is_empty() {
            return drawn.into_iter().take(most).map(|(_, bits)| bits.map(f32::from_bits)).collect();
        }
        share *= 4.0;
    }
}

/// A number that looks random and depends only on a point's coordinates.
pub fn lot(point: &Point) -> u64 {
    point.iter().fold(0, |lot, v| mixed(lot ^ u64::from(v.to_bits())))
}

/// A random number for a number: SplitMix64 by Steele, Lea and Flood.
pub(crate) fn mixed(number: u64) -> u64 {
    let mixed = number.wrapping_mul(0x9E37_79B9_7F4A_7C15);
    let mixed = (mixed ^ mixed >> 30).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    let mixed = (mixed ^ mixed >> 27).wrapping_mul(0x94D0_49BB_1331_11EB);
    mixed ^ mixed >> 31
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neither_order_nor_copies_change_what_is_drawn() {
        let points: Vec<Point> = (0..60_000).map(|i| [(i % 300) as f32 * 0.5, (i / 300) as f32, 0.0]).collect();
        let once = drawn(&points, 3000);
        assert_eq!(once.len(), 3000);
        let reversed: Vec<Point> = points.iter().rev().chain(&points).copied().chain([[f32::NAN; 3]]).collect();
        assert_eq!(drawn(&reversed, 3000), once);
        assert_eq!(drawn(&vec![points[7]; 100_000], 10), [points[7]]);
        // Each of 100 parts of the grid has about a hundredth of them.
        let part = |[x, y, _]: &Point| (*x / 15.0) as usize * 10 + (*y / 20.0) as usize;
        let number = |wanted| once.iter().filter(|point| part(point) == wanted).count();
        assert!((0..100).map(number).all(|number| (10..60).contains(&number)));
        assert!(drawn(&[], 5).is_empty() && drawn(&points[..9], 99).len() == 9);
    }

    /// Keypoints of a cloud with `max_points` depend on these.
    #[test]
    fn the_draws_of_a_seed_stay() {
        let points: Vec<Point> = (0..1000).map(|i| [i as f32, 0.0, 0.0]).collect();
        let drawn = |number| sample(&points, number, 7).iter().map(|point| point[0] as usize).collect::<Vec<_>>();
        assert_eq!(drawn(200)[..12], [7, 17, 19, 23, 30, 41, 46, 50, 62, 66, 67, 69]);
        for number in [0, 1, 200, 1000] {
            let sample_indices = drawn(number);
            assert!(sample_indices.len() == number && sample_indices.is_sorted_by(|a, b| a < b));
        }
    }
}

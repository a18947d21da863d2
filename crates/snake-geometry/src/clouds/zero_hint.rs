//! A hint where missing returns are written as zeros.

use crate::Cloud;

/// The fewest points at 0 0 0, and their smallest share, that cannot be there by chance.
const MIN_ZEROS: usize = 10;
const SHARE: f64 = 0.01;

/// One sentence for the user if many points of a cloud are exactly 0 0 0, as scanners write rays without a return.
///
/// ```
/// use snake_geometry::{Cloud, zero_hint};
/// let points: Vec<[f32; 3]> = (0..100).map(|i| if i < 20 { [0.0; 3] } else { [i as f32, 1.0, 2.0] }).collect();
/// let hint = zero_hint(&Cloud { points, origin: [0.0; 3] }).unwrap();
/// assert!(hint.starts_with("20 of 100 points (20 %) are exactly 0 0 0"));
/// ```
pub fn zero_hint(cloud: &Cloud) -> Option<String> {
    let zero = cloud.origin.map(|v| -v as f32);
    let (number, total) = (cloud.points.iter().filter(|&&point| point == zero).count(), cloud.points.len());
    let share = number as f64 / total as f64;
    (number >= MIN_ZEROS && share >= SHARE).then(|| {
        format!(
            "{number} of {total} points ({:.0} %) are exactly 0 0 0: if they are rays without a return, leave them out or \
             write them as nan, else they count as a surface",
            100.0 * share
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn zeros_are_named_with_their_share_near_and_far_from_an_origin() {
        let hint = |zeros: usize, others: usize, origin: [f64; 3]| {
            let shifted = |p: [f64; 3]| crate::subtract_origin(p, origin);
            let others = (0..others).map(|i| shifted([5e5 + i as f64, 5e6, 3.0]));
            zero_hint(&Cloud { points: others.chain((0..zeros).map(|_| shifted([0.0; 3]))).collect(), origin })
        };
        for origin in [[0.0; 3], [500_064.25, 5e6, 0.0]] {
            assert!(hint(300, 300, origin).unwrap().starts_with("300 of 600 points (50 %)"));
            assert!(hint(10, 990, origin).unwrap().contains("(1 %)"));
            assert_eq!(hint(9, 20, origin), None, "a vertex that faces share");
            assert_eq!(hint(10, 991, origin), None);
        }
        assert_eq!(hint(0, 0, [0.0; 3]), None);
    }
}

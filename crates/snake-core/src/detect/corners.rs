//! The corner response: how much the cloud looks like a corner, an end or a tip at a position.

use super::localize::Place;
use crate::Result;
use crate::field::Field;
use snake_geometry::{Point, RadiusCells, in_parallel};

/// Radius of the neighbourhood, in voxels. Set by hand: on synthetic shapes, 3.2 found more landmarks than 1.6 and 2.4.
const RADIUS: f32 = 3.0;

/// Largest value of [`Place::corner`] that counts in the rank.
const CORNER: f32 = 0.15;

/// Weight of the corner value in the rank; the saliency has weight 1.
const WEIGHT: f32 = 3.0;

/// A straight edge raises the rank by about this much above the saliency; corners, ends and tips raise it more.
pub(super) const EDGE: f32 = 0.4;

/// The rank of each place as a corner, an end or a tip.
pub(super) fn ranks(field: &Field, places: &[Place], scores: &[f32]) -> Result<Vec<f32>> {
    let positions: Vec<Point> = places.iter().map(|place| place.position).collect();
    let offsets = offsets(field.points(), &positions, RADIUS * field.voxel_size())?;
    let rank = |((score, place), offset): ((&f32, &Place), f32)| score + offset + WEIGHT * place.corner.min(CORNER);
    Ok(scores.iter().zip(places).zip(offsets).map(rank).collect())
}

/// The distance from each position to the mean of the points within `radius`, as a share of the
/// radius. It is 0 in the middle of a plane and grows as the surface becomes one-sided.
///
/// # Errors
/// [`crate::Error::Input`] for more points than [`u32::MAX`].
fn offsets(points: &[Point], positions: &[Point], radius: f32) -> Result<Vec<f32>> {
    let cells = RadiusCells::new(points, radius)?;
    let offset = |position: &Point| {
        let (mut sum, mut count) = ([0.0; 3], 0);
        cells.within(position, radius, |index| {
            (0..3).for_each(|axis| sum[axis] += points[index][axis] - position[axis]);
            count += 1;
        });
        sum.iter().map(|value| value * value).sum::<f32>().sqrt() / (count.max(1) as f32 * radius)
    };
    Ok(in_parallel(positions.iter(), offset))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_corner_has_more_than_an_edge_and_that_more_than_a_plane() {
        let grid = (0..40 * 40).map(|i| [(i % 40) as f32 * 0.05 - 1.0, (i / 40) as f32 * 0.05 - 1.0, 0.0]);
        let points: Vec<Point> = grid.collect();
        let shares = offsets(&points, &[[0.0; 3], [-1.0, 0.0, 0.0], [-1.0, -1.0, 0.0], [9.0; 3]], 0.4).unwrap();
        assert!(shares[0] < 0.01 && shares[3] == 0.0, "{shares:?}");
        // The mean of a half disc lies 4 / (3π) radii from the centre, that of a quarter disc √2 times as far.
        assert!((shares[1] - 0.42).abs() < 0.06 && (shares[2] - 0.6).abs() < 0.08, "{shares:?}");
    }
}

//! Free space: the cells of a grid through which a sensor looked.

use crate::cloud::depth_image::{DepthImage, Sight};
use snake_geometry::{Vector, in_parallel};

/// Number of cells of a grid, at most; a cloud of greater extent gets larger cells.
const MAX_CELLS: f64 = 1e6;

/// A grid of cells around a cloud, each of them free or not.
pub(super) struct FreeSpace {
    corner: Vector,
    side: f64,
    sides: [usize; 3],
    is_free: Vec<bool>,
}

impl FreeSpace {
    /// The cells around finite points, whose sides are at least `side`.
    pub(super) fn new(points: &[Vector], image: &DepthImage, side: f64) -> Self {
        let corner = points.iter().copied().reduce(|a, b| a.inf(&b)).unwrap_or_default();
        let extent = points.iter().copied().reduce(|a, b| a.sup(&b)).unwrap_or_default() - corner;
        let cells_at = |side: f64| extent.map(|v| (v / side).floor() + 1.0);
        let mut side = side;
        while cells_at(side).product() > MAX_CELLS {
            side *= 1.2;
        }
        let sides = <[f64; 3]>::from(cells_at(side)).map(|cells| cells as usize);
        let center = |cell: usize| {
            let at = [cell % sides[0], cell / sides[0] % sides[1], cell / sides[0] / sides[1]];
            corner + side * Vector::from(at.map(|v| v as f64 + 0.5))
        };
        let is_free = |cell| image.sight(&center(cell)) == Sight::Free;
        let is_free = in_parallel(0..sides.iter().product::<usize>(), is_free);
        Self { corner, side, sides, is_free }
    }

    /// Whether the sensor looked through the cell of a point.
    pub(super) fn contains(&self, point: &Vector) -> bool {
        let [x, y, z] = <[f64; 3]>::from((point - self.corner) / self.side);
        let is_within = |(v, cells): (f64, usize)| v >= 0.0 && v < cells as f64;
        let [columns, rows, _] = self.sides;
        [x, y, z].into_iter().zip(self.sides).all(is_within)
            && self.is_free[(z as usize * rows + y as usize) * columns + x as usize]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloud::depth_image::COARSE;

    #[test]
    fn space_before_a_wall_is_free_and_space_behind_it_or_outside_is_not() {
        let grid = (-40..40).flat_map(|y| (-40..40).map(move |z| (0.05 * f64::from(y), 0.05 * f64::from(z))));
        let mut points: Vec<Vector> = grid.map(|(y, z)| Vector::new(3.0, y, z)).collect();
        points.extend([Vector::zeros(), Vector::new(5.0, 0.0, 0.0)]);
        let image = DepthImage::new(&points[..6400], Vector::zeros(), 0.1, COARSE);
        let space = FreeSpace::new(&points, &image, 0.1);
        let at = |x: f64| space.contains(&Vector::new(x, 0.02, 0.02));
        assert_eq!([1.5, 3.02, 4.5, -0.5, 9.0, f64::NAN].map(at), [true, false, false, false, false, false]);
    }

    #[test]
    fn grids_of_far_points_have_larger_cells() {
        let points = [Vector::zeros(), Vector::repeat(1e6)];
        let image = DepthImage::new(&points, Vector::zeros(), 0.1, COARSE);
        let space = FreeSpace::new(&points, &image, 0.1);
        assert!(space.is_free.len() as f64 <= MAX_CELLS && space.side > 1e4);
    }
}

//! Regular query grids, for images and volumes of a field.

use crate::field::Field;
use crate::{Error, Result};
use snake_geometry::Point;

/// A regular grid over the box of a field's feature volume, in the cloud's frame and units; it includes both ends. The box is
/// the network's cube ±0.5 with its padding, or the bounding box of a scene's blocks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Grid {
    /// Number of positions along each axis.
    pub resolution: usize,
    /// The first position along each axis.
    pub low: Point,
    /// The last position along each axis.
    pub high: Point,
}

impl Grid {
    /// The coordinate of an index along an axis: `low + index * (high - low) / (resolution - 1)`.
    pub fn coordinate(&self, axis: usize, index: usize) -> f32 {
        coordinate(self.low[axis], self.high[axis], self.resolution, index)
    }

    /// The two axes of a plane perpendicular to `axis` (0 to 2), ascending.
    pub fn plane_axes(axis: usize) -> [usize; 2] {
        [[1, 2], [0, 2], [0, 1]][axis]
    }

    /// The `resolution²` grid positions in a plane perpendicular to `axis`, at the coordinate `position` along it.
    ///
    /// The first of the other two axes varies fastest, so consecutive planes perpendicular to z are `[z][y][x]`.
    ///
    /// ```
    /// let grid = snake_core::Grid { resolution: 2, low: [0.0, 10.0, 20.0], high: [1.0, 11.0, 21.0] };
    /// assert_eq!(grid.plane(1, 5.0), [[0.0, 5.0, 20.0], [1.0, 5.0, 20.0], [0.0, 5.0, 21.0], [1.0, 5.0, 21.0]]);
    /// ```
    pub fn plane(&self, axis: usize, position: f32) -> Vec<Point> {
        let [fast, slow] = Self::plane_axes(axis);
        let mut queries = Vec::with_capacity(self.resolution * self.resolution);
        for row in 0..self.resolution {
            for column in 0..self.resolution {
                let mut query = [position; 3];
                query[fast] = self.coordinate(fast, column);
                query[slow] = self.coordinate(slow, row);
                queries.push(query);
            }
        }
        queries
    }

    /// Calls `values` with the positions of each plane, and returns all values as an array `[z][y][x]`.
    ///
    /// ```
    /// use snake_core::{Builtin, EncodeOptions, Model};
    /// # let points: Vec<[f32; 3]> = (0..500).map(|i| { let a = i as f32 * 0.1; [a.cos(), a.sin(), (a * 0.3).sin()] }).collect();
    /// let field = Model::builtin(Builtin::Compact).encode(&points, &EncodeOptions::default())?;
    /// let saliency = field.grid(32)?.array(|queries| field.saliency(queries))?;
    /// assert_eq!(saliency.dim(), (32, 32, 32));
    /// # Ok::<(), snake_core::Error>(())
    /// ```
    ///
    /// # Errors
    /// Those of `values`, and [`Error::Input`] when it does not return a value for each position.
    pub fn array(&self, mut values: impl FnMut(&[Point]) -> Result<Vec<f32>>) -> Result<ndarray::Array3<f32>> {
        let mut all = Vec::with_capacity(self.resolution.pow(3));
        for index in 0..self.resolution {
            all.extend(values(&self.plane(2, self.coordinate(2, index)))?);
        }
        let number = all.len();
        ndarray::Array3::from_shape_vec([self.resolution; 3], all).map_err(|_| {
            let reason = format!("{number} for a grid of {}³ positions", self.resolution);
            Error::Input { what: "values", reason }
        })
    }
}

/// Coordinate `index` of `resolution` evenly spaced coordinates from `low` to `high`, both ends included.
pub(crate) fn coordinate(low: f32, high: f32, resolution: usize, index: usize) -> f32 {
    let share = index as f32 / (resolution - 1) as f32;
    low * (1.0 - share) + high * share
}

impl Field {
    /// The grid over this field's volume with `resolution` positions along each axis.
    ///
    /// ```
    /// use snake_core::{Builtin, EncodeOptions, Model};
    /// # let points: Vec<[f32; 3]> = (0..500).map(|i| { let a = i as f32 * 0.1; [a.cos(), a.sin(), (a * 0.3).sin()] }).collect();
    /// let field = Model::builtin(Builtin::Compact).encode(&points, &EncodeOptions::default())?;
    /// let grid = field.grid(64)?;
    /// let slice = field.saliency(&grid.plane(2, 0.0))?; // [y][x] where z = 0
    /// assert_eq!(slice.len(), 64 * 64);
    /// # Ok::<(), snake_core::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Option`] when the resolution is out of its range.
    pub fn grid(&self, resolution: usize) -> Result<Grid> {
        if !(2..=512).contains(&resolution) {
            return Err(Error::Option { name: "resolution", value: resolution.to_string(), allowed: "2 to 512" });
        }
        Ok(Grid { resolution, low: self.corner(0), high: self.corner(1) })
    }
}

#[cfg(test)]
mod tests {
    use crate::detect::tests::cylinder;

    #[test]
    fn arrays_have_the_values_of_their_positions() {
        let (_, field) = cylinder();
        let grid = field.grid(9).unwrap();
        let array = grid.array(|queries| field.occupancy(queries)).unwrap();
        for (z, y, x) in [(0, 0, 0), (3, 5, 7), (8, 1, 4)] {
            let query = [grid.coordinate(0, x), grid.coordinate(1, y), grid.coordinate(2, z)];
            assert_eq!(array[[z, y, x]], field.occupancy(&[query]).unwrap()[0]);
        }
        assert!(field.grid(1).is_err() && field.grid(513).is_err());
        assert!(grid.array(|_| Ok(vec![0.0])).unwrap_err().to_string().contains("9 for a grid"));
        let (volume, shape) = (field.volume(), field.volume().shape());
        let [_, height, width, channels] = shape;
        assert_eq!(volume.view().shape(), shape);
        let index = ((3 * height + 4) * width + 5) * channels + 6;
        assert_eq!(volume.view()[[3, 4, 5, 6]], volume.features()[index]);
    }
}

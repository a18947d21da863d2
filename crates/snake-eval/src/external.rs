//! Keypoints and descriptors of other methods, from files.

use std::path::Path;

use snake_geometry::{Point, nearest_points, subtract_origin};
use snake_io::{find_arrays, read_arrays};

use crate::error::{Error, Result};

/// The keypoints of a cloud, best first.
#[derive(Debug, Clone, PartialEq)]
pub struct ExternalKeypoints {
    /// Positions `(K, 3)` in the cloud's frame.
    pub positions: Vec<Point>,
    /// A descriptor of each keypoint, `(K, dimension)`, flat; none if the file has none.
    pub descriptors: Vec<f32>,
    /// Length of a descriptor; 0 if the file has none.
    pub dimension: usize,
}

impl ExternalKeypoints {
    /// Reads an `.npz` archive with `keypoints` `(K, 3)` and, unless these are ranked, `scores` `(K,)`; `descriptors` `(K, D)` are
    /// optional too. Equal scores keep their order. The origin of the cloud is subtracted from the positions.
    ///
    /// # Errors
    /// [`Error::File`] when the file cannot be read or lacks `keypoints`, [`Error::Layout`] for another shape or a value that
    /// is not finite.
    pub fn read(path: &Path, origin: [f64; 3]) -> Result<Self> {
        let wrong = |reason: String| Error::layout(path, reason);
        let keypoints = read_arrays(path, &["keypoints"])?.remove(0);
        let [number, 3] = keypoints.shape[..] else {
            return Err(wrong(format!("keypoints have the shape {:?}; needed is (K, 3)", keypoints.shape)));
        };
        let mut others = find_arrays(path, &["scores", "descriptors"])?.into_iter();
        let mut rows = |name: &str, dimensions: usize| match others.next().flatten() {
            Some(array) if array.shape.len() != dimensions || array.shape[0] != number => {
                Err(wrong(format!("{name} have the shape {:?} for {number} keypoints", array.shape)))
            }
            array => Ok(array),
        };
        let (scores, descriptors) = (rows("scores", 1)?, rows("descriptors", 2)?);
        let mut all = std::iter::once(&keypoints).chain(&scores).chain(&descriptors);
        if all.any(|array| array.items.iter().any(|value| !(*value as f32).is_finite())) {
            return Err(wrong("a value is not finite".into()));
        }
        let mut order: Vec<usize> = (0..number).collect();
        if let Some(scores) = scores {
            order.sort_by(|&a, &b| scores.items[b].total_cmp(&scores.items[a]));
        }
        let position = |&i: &usize| subtract_origin(std::array::from_fn(|axis| keypoints.items[3 * i + axis]), origin);
        let dimension = descriptors.as_ref().map_or(0, |array| array.shape[1]);
        let values = descriptors.map_or_else(Vec::new, |array| array.items);
        let row = |&i: &usize| values[i * dimension..(i + 1) * dimension].iter().map(|&value| value as f32);
        let descriptors = order.iter().flat_map(row).collect();
        Ok(Self { positions: order.iter().map(position).collect(), descriptors, dimension })
    }

    /// The descriptor of the nearest keypoint for each point `(N, 3)`: `(N, D)`, flat. Among equally near keypoints the best one
    /// counts. For methods that describe every point of a cloud.
    ///
    /// # Errors
    /// [`Error::Core`] for more keypoints than 32-bit indices can count.
    pub fn descriptors_at(&self, points: &[Point]) -> Result<Vec<f32>> {
        let dimension = self.dimension;
        if self.descriptors.is_empty() {
            return Ok(Vec::new());
        }
        let row = |keypoint: usize| &self.descriptors[keypoint * dimension..][..dimension];
        Ok(nearest_points(&self.positions, points)?.into_iter().flat_map(row).copied().collect())
    }
}

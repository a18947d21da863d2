//! Keypoints and descriptors of other methods, from files.

use std::path::Path;

use snake_geometry::Point;
use snake_io::{Array, read_arrays};

use crate::error::{Error, Result};

/// The keypoints of a cloud, best first.
#[derive(Debug, Clone, PartialEq)]
pub struct ExternalKeypoints {
    /// Positions `(K, 3)` in the cloud's frame.
    pub positions: Vec<Point>,
    /// A descriptor of each keypoint, all of one length; none if the file has none.
    pub descriptors: Vec<Vec<f32>>,
}

impl ExternalKeypoints {
    /// Reads an `.npz` archive with `keypoints` `(K, 3)` and, unless these are ranked, `scores` `(K,)`; `descriptors` `(K, D)` are
    /// optional too. Equal scores keep their order.
    ///
    /// # Errors
    /// [`Error::File`] when the file cannot be read or lacks `keypoints`, [`Error::Layout`] for another shape or a value that
    /// is not finite.
    pub fn read(path: &Path) -> Result<Self> {
        let wrong = |reason: String| Error::layout(path, reason);
        let [keypoints] = &read_arrays(path, &["keypoints"])?[..] else { unreachable!("one name, one array") };
        let [number, 3] = keypoints.shape[..] else {
            return Err(wrong(format!("keypoints have the shape {:?}; needed is (K, 3)", keypoints.shape)));
        };
        let rows = |name: &str| -> Result<Option<Array>> {
            let Ok(mut arrays) = read_arrays(path, &[name]) else { return Ok(None) };
            let array = arrays.remove(0);
            match array.shape.first() {
                Some(&rows) if rows == number => Ok(Some(array)),
                _ => Err(wrong(format!("{name} have the shape {:?} for {number} keypoints", array.shape))),
            }
        };
        let (scores, descriptors) = (rows("scores")?, rows("descriptors")?);
        let all = [Some(keypoints), scores.as_ref(), descriptors.as_ref()];
        if all.into_iter().flatten().any(|array| array.items.iter().any(|value| !value.is_finite())) {
            return Err(wrong("a value is not finite".into()));
        }
        let mut order: Vec<usize> = (0..number).collect();
        if let Some(scores) = scores {
            order.sort_by(|&a, &b| scores.items[b].total_cmp(&scores.items[a]));
        }
        let position = |&i: &usize| std::array::from_fn(|axis| keypoints.items[3 * i + axis] as f32);
        let descriptor = |array: &Array, i: usize| {
            let length = array.items.len() / number;
            array.items[i * length..(i + 1) * length].iter().map(|&value| value as f32).collect()
        };
        Ok(Self {
            positions: order.iter().map(position).collect(),
            descriptors: descriptors
                .map_or_else(Vec::new, |array| order.iter().map(|&i| descriptor(&array, i)).collect()),
        })
    }
}

//! Clouds whose layout is not `&[[f32; 3]]`.

use crate::{Error, Point, Result};

/// A cloud that provides its points one by one, for `FrameDetector::detect_into` of snake-core. For other calls,
/// [`PointSource::to_points`] copies it.
///
/// Types that have the layout of `[f32; 3]`, such as `glam::Vec3` and `nalgebra::Point3<f32>`, need none of this:
/// `bytemuck::cast_slice` turns a slice of them into a slice of points without a copy. `bytemuck::try_cast_slice` returns an
/// error for types of another layout.
///
/// Points that are not finite stay: the detector skips them, and
/// [`Keypoint::nearest_index`](crate::Keypoint::nearest_index) counts them.
pub trait PointSource {
    /// Number of points, including those that are not finite.
    fn num_points(&self) -> usize;

    /// Point `index`, in cloud units.
    ///
    /// # Panics
    /// If the index is not below [`PointSource::num_points`].
    fn point(&self, index: usize) -> Point;

    /// All points `(N, 3)`, in order.
    fn to_points(&self) -> Vec<Point> {
        (0..self.num_points()).map(|index| self.point(index)).collect()
    }
}

impl PointSource for [Point] {
    fn num_points(&self) -> usize {
        self.len()
    }

    fn point(&self, index: usize) -> Point {
        self[index]
    }
}

impl PointSource for Vec<Point> {
    fn num_points(&self) -> usize {
        self.len()
    }

    fn point(&self, index: usize) -> Point {
        self[index]
    }
}

/// A cloud as three slices, one for each axis.
///
/// ```
/// use snake_geometry::{PointSource, SeparateAxes};
///
/// let cloud = SeparateAxes::new(&[1.0, 2.0], &[3.0, 4.0], &[5.0, 6.0])?;
/// assert_eq!(cloud.to_points(), [[1.0, 3.0, 5.0], [2.0, 4.0, 6.0]]);
/// # Ok::<(), snake_geometry::Error>(())
/// ```
#[derive(Debug, Clone, Copy)]
pub struct SeparateAxes<'a> {
    x: &'a [f32],
    y: &'a [f32],
    z: &'a [f32],
}

impl<'a> SeparateAxes<'a> {
    /// The cloud of these coordinates, in cloud units.
    ///
    /// # Errors
    /// [`Error::Input`] when the slices differ in length.
    pub fn new(x: &'a [f32], y: &'a [f32], z: &'a [f32]) -> Result<Self> {
        for (what, values) in [("y", y), ("z", z)] {
            if values.len() != x.len() {
                let reason = format!("{} values, but x has {}", values.len(), x.len());
                return Err(Error::Input { what, reason });
            }
        }
        Ok(Self { x, y, z })
    }
}

impl PointSource for SeparateAxes<'_> {
    fn num_points(&self) -> usize {
        self.x.len()
    }

    fn point(&self, index: usize) -> Point {
        [self.x[index], self.y[index], self.z[index]]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_are_points_and_those_of_different_lengths_are_refused_by_name() {
        let axes = SeparateAxes::new(&[1.0, 2.0], &[3.0, 4.0], &[5.0, 6.0]).unwrap();
        assert_eq!(axes.to_points(), [[1.0, 3.0, 5.0], [2.0, 4.0, 6.0]]);
        let error = |y: &[f32], z: &[f32]| SeparateAxes::new(&[1.0, 2.0], y, z).unwrap_err().to_string();
        assert_eq!(error(&[1.0], &[1.0, 2.0]), "y: 1 values, but x has 2");
        assert_eq!(error(&[1.0, 2.0], &[1.0, 2.0, 3.0]), "z: 3 values, but x has 2");
    }
}

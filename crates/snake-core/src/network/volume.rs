//! The feature volume and its frame. Axis order, padding and clamping are defined only in this file.

use crate::network::scene::BlockGrid;
use snake_geometry::Point;
use snake_kernels::{BLOCK_SIDE, Buffer, Corners, Scratch, SimdLevel, interpolate, interpolate_backward};

/// The positions of a volume's voxels in the network's frame (ConvONet's normalisation of coordinates).
///
/// A coordinate is divided by `1 + padding` and mapped to [0, 1): x and y by adding 0.5, z by its bounds. Coordinates
/// outside are clamped, so far queries read the border and have zero gradient along that axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VolumeFrame {
    /// Number of voxels along x, y, z.
    pub resolution: [usize; 3],
    /// The volume spans ±0.5 · (1 + padding) along x and y.
    pub padding: f32,
    /// Lower and upper z bound (before padding).
    pub z_bounds: [f32; 2],
}

impl VolumeFrame {
    /// Added to divisors by the released code; kept because the weights were trained with it.
    const EPSILON: f32 = 1e-7;

    /// D, H, W: voxels along z, y, x.
    pub(crate) fn size(&self) -> [usize; 3] {
        let [x, y, z] = self.resolution;
        [z, y, x]
    }

    /// The size of a voxel along x, of a cloud with so many units in one network unit.
    pub(crate) fn voxel_size(&self, scale: f32) -> f32 {
        scale * (1.0 + self.padding) / self.resolution[0] as f32
    }

    /// Lower and upper end of the volume along each axis, in the network's frame.
    pub(crate) fn bounds(&self) -> [[f32; 2]; 3] {
        [[-0.5, 0.5], [-0.5, 0.5], self.z_bounds].map(|ends| ends.map(|end| end * (1.0 + self.padding)))
    }

    /// Maps a coordinate of the network's frame so that the volume spans [0, 1).
    fn unclamped(&self, axis: usize, coordinate: f32) -> f32 {
        let scaled = coordinate / (1.0 + self.padding + Self::EPSILON);
        let [z_min, z_max] = self.z_bounds;
        if axis < 2 { scaled + 0.5 } else { (scaled - z_min) / (z_max - z_min + Self::EPSILON) }
    }

    /// [`VolumeFrame::unclamped`], clamped to [0, 1).
    fn unit(&self, axis: usize, coordinate: f32) -> f32 {
        let unit = self.unclamped(axis, coordinate);
        if unit >= 1.0 { 1.0 - Self::EPSILON } else { unit.max(0.0) }
    }

    /// Flat index `x + X (y + Y z)` of the voxel that contains a point.
    pub(crate) fn voxel(&self, point: Point) -> usize {
        (0..3).map(|axis| self.voxel_along(axis, point[axis])).sum()
    }

    /// One coordinate's part of the flat index of the voxel.
    pub(crate) fn voxel_along(&self, axis: usize, coordinate: f32) -> usize {
        self.place_along(axis, coordinate) * self.resolution[..axis].iter().product::<usize>()
    }

    /// The index along an axis of the voxel that contains a coordinate.
    pub(crate) fn place_along(&self, axis: usize, coordinate: f32) -> usize {
        (self.unit(axis, coordinate) * self.resolution[axis] as f32) as usize
    }

    /// The index along an axis of the lower of the two voxels around a coordinate, and the position from it to the upper.
    pub(crate) fn cell_along(&self, axis: usize, coordinate: f32) -> (usize, f32) {
        let last = self.resolution[axis] - 1;
        let place = self.unit(axis, coordinate) * last as f32;
        let low = (place as usize).min(last - 1);
        (low, place - low as f32)
    }

    /// The eight voxels around a query. The centres of the first and last voxels lie on the volume's faces ("align
    /// corners").
    pub(crate) fn corners(&self, query: Point) -> Corners {
        let cell: [(usize, f32); 3] = std::array::from_fn(|axis| self.cell_along(axis, query[axis]));
        let stride = [1, self.resolution[0], self.resolution[0] * self.resolution[1]];
        let voxels = std::array::from_fn(|corner| {
            (0..3).map(|axis| (cell[axis].0 + (corner >> axis & 1)) * stride[axis]).sum::<usize>() as u32
        });
        Corners { voxels, fraction: cell.map(|(_, fraction)| fraction) }
    }

    /// Voxels per network unit along each axis at a query. The factor converts a derivative per voxel to one per unit;
    /// it is zero along axes where the query is clamped.
    pub(crate) fn voxels_per_unit(&self, query: Point) -> Point {
        let padded = 1.0 + self.padding + Self::EPSILON;
        let extent = [padded, padded, padded * (self.z_bounds[1] - self.z_bounds[0] + Self::EPSILON)];
        std::array::from_fn(|axis| {
            let unit = self.unclamped(axis, query[axis]);
            let inside = unit > 0.0 && unit < 1.0;
            if inside { (self.resolution[axis] - 1) as f32 / extent[axis] } else { 0.0 }
        })
    }
}

/// The positions of a volume's voxels.
#[derive(Debug, Clone)]
pub(crate) enum VolumeGrid {
    /// All voxels of a cube.
    Cube(VolumeFrame),
    /// The voxels of a scene's blocks.
    Blocks(BlockGrid),
}

impl VolumeGrid {
    /// The eight voxels around a query.
    fn corners(&self, query: Point) -> Corners {
        match self {
            Self::Cube(frame) => frame.corners(query),
            Self::Blocks(blocks) => blocks.corners(query),
        }
    }

    /// Voxels per network unit along each axis at a query.
    pub(crate) fn voxels_per_unit(&self, query: Point) -> Point {
        match self {
            Self::Cube(frame) => frame.voxels_per_unit(query),
            Self::Blocks(_) => [1.0; 3],
        }
    }

    /// Lower and upper end of the volume along each axis, in the network's frame.
    pub(crate) fn bounds(&self) -> [[f32; 2]; 3] {
        match self {
            Self::Cube(frame) => frame.bounds(),
            Self::Blocks(blocks) => blocks.bounds().map(|ends| ends.map(|end| end as f32)),
        }
    }
}

/// The feature volume of one cloud: the output of the encoder and the input of both decoders.
#[derive(Debug, Clone)]
pub struct Volume {
    pub(crate) grid: VolumeGrid,
    pub(crate) channels: usize,
    /// `[z][y][x][channel]`; of a scene `[block][z][y][x][channel]`.
    pub(crate) values: Buffer,
}

impl Volume {
    /// The positions of the voxels; `None` for a scene, of which only blocks about the points are stored.
    pub fn frame(&self) -> Option<VolumeFrame> {
        match self.grid {
            VolumeGrid::Cube(frame) => Some(frame),
            VolumeGrid::Blocks(_) => None,
        }
    }

    /// The features, flat, in the order of [`Volume::shape`].
    pub fn features(&self) -> &[f32] {
        &self.values
    }

    /// The number of features along each dimension: `[z][y][x][channel]`. Of a scene, z counts the planes of its blocks of
    /// 4³ voxels one after another; the first block holds the features far from all points.
    pub fn shape(&self) -> [usize; 4] {
        match &self.grid {
            VolumeGrid::Cube(frame) => {
                let [depth, height, width] = frame.size();
                [depth, height, width, self.channels]
            }
            VolumeGrid::Blocks(blocks) => [(blocks.len() + 1) * BLOCK_SIDE, BLOCK_SIDE, BLOCK_SIDE, self.channels],
        }
    }

    /// The features as an array with the dimensions of [`Volume::shape`], without a copy.
    #[cfg(feature = "ndarray")]
    pub fn view(&self) -> ndarray::ArrayView4<'_, f32> {
        ndarray::ArrayView::from_shape(self.shape(), self.features()).expect("as many features as the shape says")
    }

    /// Writes trilinear features `(queries, channels)` and returns the corners that were read.
    pub(crate) fn interpolate(&self, grid: &VolumeGrid, queries: &[Point], features: &mut [f32]) -> Scratch<Corners> {
        let corners = Scratch::collect(queries.len(), queries.iter().map(|&query| grid.corners(query)));
        interpolate(SimdLevel::current(), &self.values, self.channels, &corners, features);
        corners
    }

    /// Derivatives `(queries, 3)` per voxel along x, y, z, from the gradient with respect to the features
    /// `(queries, channels)`, at the corners from [`Volume::interpolate`].
    pub(crate) fn interpolate_backward(&self, corners: &[Corners], in_feature: &[f32]) -> Scratch<Point> {
        let mut gradients = Scratch::zeros(corners.len());
        let level = SimdLevel::current();
        interpolate_backward(level, &self.values, self.channels, corners, in_feature, &mut gradients);
        gradients
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FRAME: VolumeFrame = VolumeFrame { resolution: [16, 12, 8], padding: 0.125, z_bounds: [-0.25, 0.25] };

    #[test]
    fn voxels_run_x_first_and_far_points_fall_on_the_border() {
        assert_eq!(FRAME.voxel([-9.0, -9.0, -9.0]), 0);
        assert_eq!(FRAME.voxel([9.0, -9.0, -9.0]), 15);
        assert_eq!(FRAME.voxel([-9.0, 9.0, -9.0]), 11 * 16);
        assert_eq!(FRAME.voxel([9.0, 9.0, 9.0]), 16 * 12 * 8 - 1);
        assert_eq!(FRAME.voxel([0.0, 0.0, 0.0]), 8 + 16 * (6 + 12 * 3));
    }

    #[test]
    fn clamped_axes_have_no_gradient() {
        assert_eq!(FRAME.voxels_per_unit([0.6, 0.0, -0.3])[0], 0.0);
        assert!(FRAME.voxels_per_unit([0.6, 0.0, 0.0])[1] > 0.0);
        assert_eq!(FRAME.voxels_per_unit([0.0, 0.0, -0.3])[2], 0.0);
    }
}

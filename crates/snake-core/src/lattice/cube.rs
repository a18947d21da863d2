//! The cube that every cloud of a model is scaled to. Axis order, padding and clamping are defined only in this file.

use snake_geometry::Point;
use snake_kernels::Corners;

/// The positions of a volume's voxels in the network's frame (ConvONet's normalisation of coordinates).
///
/// A coordinate is divided by `1 + padding` and mapped to [0, 1): x and y by adding 0.5, z by its bounds. Coordinates
/// outside are clamped: far queries read the border, and their features have zero gradient along that axis.
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

    /// The voxel size along x in cloud units; `scale` is cloud units per network unit.
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

    /// The contribution of one coordinate to the flat index of its voxel.
    pub(crate) fn voxel_along(&self, axis: usize, coordinate: f32) -> usize {
        self.place_along(axis, coordinate) * self.resolution[..axis].iter().product::<usize>()
    }

    /// The index along an axis of the voxel that contains a coordinate.
    pub(crate) fn place_along(&self, axis: usize, coordinate: f32) -> usize {
        (self.unit(axis, coordinate) * self.resolution[axis] as f32) as usize
    }

    /// The index of the lower of the two voxels around a coordinate, and the fraction of the way to the upper one.
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

//! The starting queries of a cube: a regular grid over it.

use super::cube::VolumeFrame;
use crate::options::DetectOptions;
use snake_geometry::{
    Point,
    rotations::{Rotation, rotate_inverse},
};

/// The query grid of a detection, in the orientation of the volume. It generates a few planes at a
/// time, to save memory.
#[derive(Debug)]
pub(super) struct QueryGrid {
    /// The coordinates of the queries along each axis, each with its contribution to the flat voxel index.
    axes: [Vec<(f32, usize)>; 3],
    /// Whether the queries in each voxel are evaluated; `None`: all are.
    band: Option<Vec<bool>>,
    orientation: Rotation,
}

impl QueryGrid {
    /// The grid over ±0.5 along x and y, and over the volume's bounds along z.
    /// `points` is the cloud in the frame of the volume.
    pub(super) fn new(
        frame: &VolumeFrame,
        points: impl Iterator<Item = Point>,
        orientation: &Rotation,
        options: &DetectOptions,
    ) -> Self {
        let resolution = options.query_resolution;
        let [z_min, z_max] = frame.z_bounds;
        let axes = std::array::from_fn(|axis| {
            let [low, high] = if axis < 2 { [-0.5, 0.5] } else { [z_min, z_max] };
            let coordinates = (0..resolution).map(|i| coordinate(low, high, resolution, i));
            let voxels = coordinates.map(|coordinate| (coordinate, frame.voxel_along(axis, coordinate)));
            voxels.collect()
        });
        let band = (options.query_band > 0).then(|| voxels_near_points(points, frame, options.query_band));
        Self { axes, band, orientation: *orientation }
    }

    pub(super) fn resolution(&self) -> usize {
        self.axes[0].len()
    }

    /// Appends the queries of one plane of the grid across x, z fastest, in the network's frame.
    pub(super) fn append_plane(&self, x: usize, queries: &mut Vec<Point>) {
        let (x, voxel_x) = self.axes[0][x];
        for &(y, voxel_y) in &self.axes[1][..] {
            let is_near = |voxel_z: usize| self.band.as_ref().is_none_or(|band| band[voxel_x + voxel_y + voxel_z]);
            let near = self.axes[2].iter().filter(|(_, voxel_z)| is_near(*voxel_z));
            queries.extend(near.map(|&(z, _)| rotate_inverse(&self.orientation, [x, y, z])));
        }
    }
}

/// Coordinate `i` of `resolution` coordinates from `low` to `high`. It is computed from the nearer end, as in
/// torch.linspace, so the grid is exactly symmetric.
fn coordinate(low: f32, high: f32, resolution: usize, i: usize) -> f32 {
    let step = (high - low) / resolution.saturating_sub(1).max(1) as f32;
    if i < resolution / 2 || resolution == 1 {
        low + step * i as f32
    } else {
        high - step * (resolution - 1 - i) as f32
    }
}

/// Whether each voxel has a voxel with input points within `reach` voxels along every axis.
fn voxels_near_points(points: impl Iterator<Item = Point>, frame: &VolumeFrame, reach: usize) -> Vec<bool> {
    let mut near = vec![false; frame.resolution.iter().product()];
    points.for_each(|point| near[frame.voxel(point)] = true);
    let (mut before, mut stride) = (near.clone(), 1);
    for length in frame.resolution {
        before.copy_from_slice(&near);
        for (voxel, near) in near.iter_mut().enumerate() {
            let place = voxel / stride % length;
            let line = voxel - place * stride;
            *near = (place.saturating_sub(reach)..=(place + reach).min(length - 1)).any(|i| before[line + i * stride]);
        }
        stride *= length;
    }
    near
}

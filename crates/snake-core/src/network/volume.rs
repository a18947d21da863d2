//! The feature volume.

use crate::lattice::{Lattice, VolumeFrame};
use snake_geometry::Point;
use snake_kernels::{Buffer, Corners, SimdLevel, interpolate, interpolate_backward};

/// The feature volume of one cloud: the output of the encoder and the input of both decoders.
#[derive(Debug, Clone)]
pub struct Volume {
    pub(crate) lattice: Lattice,
    pub(crate) channels: usize,
    /// `[z][y][x][channel]`; in a scene `[block][z][y][x][channel]`.
    pub(crate) values: Buffer,
}

impl Volume {
    /// The positions of the voxels; `None` for a scene, which stores only blocks around the points.
    pub fn frame(&self) -> Option<VolumeFrame> {
        self.lattice.frame()
    }

    /// The features, flat, in the order of [`Volume::shape`].
    pub fn features(&self) -> &[f32] {
        &self.values
    }

    /// The number of features along each dimension: `[z][y][x][channel]`. In a scene, blocks of 4³ voxels are stacked
    /// along z; the first block holds the features far from all points.
    pub fn shape(&self) -> [usize; 4] {
        let [depth, height, width] = self.lattice.size();
        [depth, height, width, self.channels]
    }

    /// The features as an array with the dimensions of [`Volume::shape`], without a copy.
    pub fn view(&self) -> ndarray::ArrayView4<'_, f32> {
        ndarray::ArrayView::from_shape(self.shape(), self.features()).expect("as many features as the shape says")
    }

    /// Writes trilinearly interpolated features `(queries, channels)` and returns the corners that were read.
    pub(crate) fn interpolate(&self, lattice: &Lattice, queries: &[Point], features: &mut [f32]) -> Vec<Corners> {
        let corners: Vec<Corners> = queries.iter().map(|&query| lattice.corners(query)).collect();
        interpolate(SimdLevel::current(), &self.values, self.channels, &corners, features);
        corners
    }

    /// Derivatives `(queries, 3)` per voxel along x, y, z, from the gradient with respect to the features
    /// `(queries, channels)`, at the corners from [`Volume::interpolate`].
    pub(crate) fn interpolate_backward(&self, corners: &[Corners], in_feature: &[f32]) -> Vec<Point> {
        let mut gradients = vec![[0.0; 3]; corners.len()];
        let level = SimdLevel::current();
        interpolate_backward(level, &self.values, self.channels, corners, in_feature, &mut gradients);
        gradients
    }
}

//! PointNet with local pooling: between blocks, each point also receives the maximum over the points of its voxel.
//!
//! Voxels are independent of each other. The network therefore processes a few voxels at a time through all blocks and
//! stores only the sums of their features, so memory does not grow with the number of points.

use super::pointnet_blocks::{FirstBlock, PooledBlock, VoxelTerms};
use crate::Result;
use crate::control::Counter;
use crate::lattice::VoxelGroups;
use crate::network::config::ModelConfig;
use crate::network::layers::{Linear, TILE};
use crate::network::weights::Scope;
use snake_geometry::{Point, in_parallel, try_in_parallel};
use snake_kernels::{Epilogue, SimdLevel, max_rows};

/// Points in the voxels of one task: their features fit the second-level cache.
const CHUNK: usize = 2048;

/// If a voxel has more points than this, their features are recomputed after each block instead of stored.
const LARGE: usize = 16 * CHUNK;

/// The point encoder before scattering.
#[derive(Debug)]
pub(crate) struct PointNet {
    hidden: usize,
    first: FirstBlock,
    /// The other blocks.
    blocks: Vec<PooledBlock>,
    fc_c: Linear,
}

impl PointNet {
    pub(crate) fn load(scope: &Scope, config: &ModelConfig) -> Result<Self> {
        let hidden = config.hidden_dim;
        let block = |i| PooledBlock::load(&scope.at(&format!("blocks.{i}")), hidden);
        Ok(Self {
            hidden,
            first: FirstBlock::load(scope, hidden)?,
            blocks: (1..config.resnet_blocks).map(block).collect::<Result<_>>()?,
            fc_c: Linear::load(&scope.at("fc_c"), hidden, config.c_dim)?,
        })
    }

    /// The progress units of [`PointNet::add_to_voxels`]: each point in each block and in the last layer.
    pub(super) fn work(&self, num_points: usize) -> usize {
        num_points * (self.blocks.len() + 2)
    }

    /// Number of channels of a feature.
    pub(super) fn channels(&self) -> usize {
        self.fc_c.outputs()
    }

    /// Adds the features of the points to the sums of their voxels. `point` returns a point in the network's frame.
    pub(super) fn add_to_voxels(
        &self,
        groups: &VoxelGroups,
        point: impl Fn(usize) -> Point + Sync,
        add: impl Fn(Point, &[f32], &mut [f32]) + Sync,
        sums: &mut [f32],
        counter: &Counter,
    ) -> Result<()> {
        groups.in_parts(CHUNK, sums, &|voxels, sums| {
            counter.check()?;
            let num_points = groups.num_points(voxels.clone());
            let points: Vec<Point> = groups.members(voxels.clone()).map(&point).collect();
            if num_points > LARGE {
                return self.large_voxel_sums(&points, sums, &add, counter);
            }
            let sizes: Vec<usize> = voxels.map(|voxel| groups.num_points(voxel..voxel + 1)).collect();
            self.chunk_sums(&points, &sizes, sums, &add);
            counter.add(self.work(num_points));
            Ok(())
        })
    }

    /// Computes the sums of voxels from points that are ordered by voxel; voxel `i` has `sizes[i]` points.
    fn chunk_sums(
        &self,
        points: &[Point],
        sizes: &[usize],
        sums: &mut [f32],
        add: &impl Fn(Point, &[f32], &mut [f32]),
    ) {
        let width = sums.len() / sizes.len();
        let rows = sizes.iter().enumerate().flat_map(|(voxel, &size)| std::iter::repeat_n(voxel, size));
        let voxel_of_row: Vec<usize> = rows.collect();
        let mut features = vec![0.0; points.len() * self.hidden];
        let mut maxima = vec![0.0; sizes.len() * self.hidden];
        let tiles = features.chunks_mut(TILE * self.hidden).zip(points.chunks(TILE));
        tiles.for_each(|(features, points)| self.first.forward(points, features));
        for block in &self.blocks {
            maxima.fill(f32::NEG_INFINITY);
            max_rows(SimdLevel::current(), &features, self.hidden, &voxel_of_row, &mut maxima);
            let terms = block.voxel_terms(&maxima);
            let tiles = features.chunks_mut(TILE * self.hidden).zip(voxel_of_row.chunks(TILE));
            tiles.for_each(|(features, voxels)| block.forward(&terms, voxels, features));
        }
        let tiles = features.chunks(TILE * self.hidden).zip(points.chunks(TILE)).zip(voxel_of_row.chunks(TILE));
        for ((features, points), voxels) in tiles {
            let mut output = vec![0.0; voxels.len() * self.channels()];
            self.fc_c.forward(features, &mut output, Epilogue::Store);
            for ((&point, feature), voxel) in points.iter().zip(output.chunks_exact(self.channels())).zip(voxels) {
                add(point, feature, &mut sums[voxel * width..][..width]);
            }
        }
    }

    /// The sums of one voxel. After each pooling, all earlier blocks run again, so only a part of the features is in
    /// memory at a time.
    fn large_voxel_sums(
        &self,
        points: &[Point],
        sums: &mut [f32],
        add: &impl Fn(Point, &[f32], &mut [f32]),
        counter: &Counter,
    ) -> Result<()> {
        let mut terms = Vec::with_capacity(self.blocks.len());
        for block in &self.blocks {
            let chunk_maxima = |chunk: &[Point]| {
                counter.check()?;
                let mut most = vec![f32::NEG_INFINITY; self.hidden];
                for tile in chunk.chunks(TILE) {
                    let features = self.features_after(&terms, tile);
                    max_rows(SimdLevel::current(), &features, self.hidden, &[0; TILE], &mut most);
                }
                counter.add(chunk.len());
                Ok(most)
            };
            let maxima_by_chunk = try_in_parallel(points.chunks(CHUNK), chunk_maxima)?;
            let mut most = vec![f32::NEG_INFINITY; self.hidden];
            maxima_by_chunk
                .iter()
                .for_each(|chunk_maxima| max_rows(SimdLevel::current(), chunk_maxima, self.hidden, &[0], &mut most));
            terms.push(block.voxel_terms(&most));
        }
        for points in points.chunks(LARGE) {
            counter.check()?;
            let outputs = in_parallel(points.chunks(TILE), |tile| {
                let mut output = vec![0.0; tile.len() * self.channels()];
                self.fc_c.forward(&self.features_after(&terms, tile), &mut output, Epilogue::Store);
                output
            });
            let features = outputs.iter().flat_map(|output| output.chunks_exact(self.channels()));
            points.iter().zip(features).for_each(|(&point, feature)| add(point, feature, sums));
            counter.add(2 * points.len());
        }
        Ok(())
    }

    /// The features `(points, hidden)` of a tile of points in one voxel, after the first block and one more block for
    /// each element of `terms`, the terms of that voxel.
    fn features_after(&self, terms: &[VoxelTerms], points: &[Point]) -> Vec<f32> {
        let mut features = vec![0.0; points.len() * self.hidden];
        self.first.forward(points, &mut features);
        for (block, terms) in self.blocks.iter().zip(terms) {
            block.forward(terms, &[0; TILE][..points.len()], &mut features);
        }
        features
    }
}

#[cfg(test)]
mod tests {
    use chacha20::ChaCha8Rng;
    use rand::{RngExt, SeedableRng};

    use super::*;
    use crate::lattice::VolumeFrame;
    use crate::{Builtin, Model};

    /// Combines each row of `features` with row `target` of `pooled`, in order.
    fn pool(features: &[f32], width: usize, target: &[usize], pooled: &mut [f32], combine: impl Fn(f32, f32) -> f32) {
        for (feature, &target) in features.chunks_exact(width).zip(target) {
            for (pooled, &value) in pooled[target * width..].iter_mut().zip(feature) {
                *pooled = combine(*pooled, value);
            }
        }
    }

    impl PointNet {
        /// The reference implementation: features `(points, c_dim)` of all points, and the mean over each occupied
        /// voxel.
        pub(crate) fn plain(&self, points: &[Point], frame: &VolumeFrame) -> [Vec<f32>; 2] {
            let mut voxels: Vec<usize> = points.iter().map(|&point| frame.voxel(point)).collect();
            let mut occupied = voxels.clone();
            occupied.sort_unstable();
            occupied.dedup();
            voxels.iter_mut().for_each(|voxel| *voxel = occupied.partition_point(|other| other < voxel));
            let mut features = vec![0.0; points.len() * self.hidden];
            self.first.forward(points, &mut features);
            for block in &self.blocks {
                let mut maxima = vec![f32::NEG_INFINITY; occupied.len() * self.hidden];
                pool(&features, self.hidden, &voxels, &mut maxima, f32::max);
                block.forward(&block.voxel_terms(&maxima), &voxels, &mut features);
            }
            let mut output = vec![0.0; points.len() * self.channels()];
            self.fc_c.forward(&features, &mut output, Epilogue::Store);
            let mut means = vec![0.0; occupied.len() * self.channels()];
            pool(&output, self.channels(), &voxels, &mut means, |sum, feature| sum + feature);
            for (voxel, mean) in means.chunks_exact_mut(self.channels()).enumerate() {
                let size = voxels.iter().filter(|&&other| other == voxel).count();
                mean.iter_mut().for_each(|sum| *sum /= size as f32);
            }
            [output, means]
        }
    }

    #[test]
    fn voxels_of_any_size_have_the_bits_of_the_textbook() {
        let model = Model::builtin(Builtin::Compact);
        let (encoder, frame) = (&model.network().encoder.dense().points, model.config().frame().unwrap());
        let mut random = ChaCha8Rng::seed_from_u64(1);
        // Clusters in a few voxels, as in a scan with an outlier, and points spread over the whole volume.
        for (crowd, others) in
            [(0, 1), (0, 700), (1, 63), (65, 64), (CHUNK, 3000), (LARGE, 500), (LARGE + 1, 7), (2 * LARGE + 99, 0)]
        {
            let mut point = |size: f32| std::array::from_fn(|_| size * (random.random::<f32>() - 0.5));
            let points: Vec<Point> = (0..crowd + others).map(|i| point(if i < crowd { 0.02 } else { 1.0 })).collect();
            let (mut groups, mut means) = (VoxelGroups::default(), vec![f32::NAN; 3]);
            groups.fill(points.len(), |index| points[index], &frame).unwrap();
            encoder.voxel_means(&groups, |index| points[index], &mut means, &Counter::default()).unwrap();
            assert_eq!(means, encoder.plain(&points, &frame)[1], "{crowd} and {others}");
        }
    }
}

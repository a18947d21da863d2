//! PointNet with local pooling: between blocks each point also sees the maximum over its voxel's points.

use rayon::prelude::*;

use crate::Result;
use crate::model::ModelConfig;
use crate::nn::{Linear, ResnetBlockFc, TILE};
use crate::points::Point;
use crate::progress::Counter;
use crate::volume::VolumeFrame;
use crate::weights::Scope;
use snake_kernels::Epilogue;

/// Which points share a voxel.
#[derive(Debug)]
pub(crate) struct VoxelGroups {
    /// Occupied voxels in rising order, each with the end of its run in `members`.
    runs: Vec<(usize, usize)>,
    /// Point indices, voxel by voxel, in rising order within a voxel.
    members: Vec<u32>,
    /// The run that each point belongs to.
    run_of_point: Vec<u32>,
}

impl VoxelGroups {
    pub(crate) fn new(points: &[Point], frame: &VolumeFrame) -> Self {
        let mut keys: Vec<(usize, u32)> = points.iter().map(|&p| frame.voxel(p)).zip(0..).collect();
        keys.par_sort_unstable();
        let (mut runs, mut run_of_point) = (Vec::new(), vec![0; points.len()]);
        for (end, &(voxel, point)) in (1..).zip(&keys) {
            match runs.last_mut() {
                Some((last, run_end)) if *last == voxel => *run_end = end,
                _ => runs.push((voxel, end)),
            }
            run_of_point[point as usize] = runs.len() as u32 - 1;
        }
        Self { runs, members: keys.into_iter().map(|(_, point)| point).collect(), run_of_point }
    }

    pub(crate) fn num_points(&self) -> usize {
        self.members.len()
    }

    /// Occupied voxels in rising order.
    pub(crate) fn voxels(&self) -> impl Iterator<Item = usize> {
        self.runs.iter().map(|run| run.0)
    }

    fn members(&self, run: usize) -> &[u32] {
        let start = run.checked_sub(1).map_or(0, |before| self.runs[before].1);
        &self.members[start..self.runs[run].1]
    }

    /// Maximum over each run's points: `(points, width)` to `(runs, width)`.
    fn max_pool(&self, features: &[f32], width: usize, counter: &Counter) -> Vec<f32> {
        self.pool(features, width, f32::NEG_INFINITY, f32::max, counter)
    }

    /// Mean over each run's points: `(points, width)` to `(runs, width)`.
    pub(crate) fn mean_pool(&self, features: &[f32], width: usize, counter: &Counter) -> Vec<f32> {
        let mut sums = self.pool(features, width, 0.0, |sum, feature| sum + feature, counter);
        for (run, sum) in sums.chunks_exact_mut(width).enumerate() {
            sum.iter_mut().for_each(|s| *s /= self.members(run).len() as f32);
        }
        sums
    }

    /// Combines the features of each run's points, in rising order of the points.
    fn pool(
        &self,
        features: &[f32],
        width: usize,
        start: f32,
        combine: impl Fn(f32, f32) -> f32 + Sync,
        counter: &Counter,
    ) -> Vec<f32> {
        let mut pooled = vec![start; self.runs.len() * width];
        pooled.par_chunks_mut(width).enumerate().for_each(|(run, pooled)| {
            for &point in self.members(run) {
                for (p, &f) in pooled.iter_mut().zip(&features[point as usize * width..]) {
                    *p = combine(*p, f);
                }
            }
            counter.add(self.members(run).len());
        });
        pooled
    }
}

/// The point encoder before scattering.
#[derive(Debug)]
pub(crate) struct PointNet {
    hidden: usize,
    fc_pos: Linear,
    blocks: Vec<ResnetBlockFc>,
    fc_c: Linear,
}

impl PointNet {
    pub(crate) fn load(scope: &Scope, config: &ModelConfig) -> Result<Self> {
        let hidden = config.hidden_dim;
        let block = |i| ResnetBlockFc::load(&scope.at(&format!("blocks.{i}")), 2 * hidden, hidden);
        Ok(Self {
            hidden,
            fc_pos: Linear::load(&scope.at("fc_pos"), 3, 2 * hidden)?,
            blocks: (0..config.resnet_blocks).map(block).collect::<Result<_>>()?,
            fc_c: Linear::load(&scope.at("fc_c"), hidden, config.c_dim)?,
        })
    }

    /// What [`PointNet::features`] counts: each point in each block, in the pooling between two, and in the last layer.
    pub(crate) fn work(&self, num_points: usize) -> usize {
        num_points * 2 * self.blocks.len()
    }

    /// Features `(points, c_dim)` of points in the network's frame.
    pub(crate) fn features(&self, points: &[Point], groups: &VoxelGroups, counter: &Counter) -> Vec<f32> {
        let wide = 2 * self.hidden;
        let mut features = vec![0.0; points.len() * self.hidden];
        for (depth, block) in self.blocks.iter().enumerate() {
            let pooled = if depth == 0 { Vec::new() } else { groups.max_pool(&features, self.hidden, counter) };
            features.par_chunks_mut(TILE * self.hidden).enumerate().for_each(|(tile, features)| {
                let first = tile * TILE;
                let rows = features.len() / self.hidden;
                let mut input = vec![0.0; rows * wide];
                if depth == 0 {
                    self.fc_pos.forward(points[first..first + rows].as_flattened(), &mut input, Epilogue::Store);
                } else {
                    for (row, input) in input.chunks_exact_mut(wide).enumerate() {
                        let run = groups.run_of_point[first + row] as usize;
                        input[..self.hidden].copy_from_slice(&features[row * self.hidden..][..self.hidden]);
                        input[self.hidden..].copy_from_slice(&pooled[run * self.hidden..][..self.hidden]);
                    }
                }
                block.forward(&input, features);
                counter.add(rows);
            });
        }
        let c_dim = self.fc_c.outputs();
        let mut output = vec![0.0; points.len() * c_dim];
        let tiles = features.par_chunks(TILE * self.hidden);
        output.par_chunks_mut(TILE * c_dim).zip(tiles).for_each(|(out, input)| {
            self.fc_c.forward(input, out, Epilogue::Store);
            counter.add(input.len() / self.hidden);
        });
        output
    }
}

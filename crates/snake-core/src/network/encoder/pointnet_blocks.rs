//! The residual blocks of PointNet, `shortcut(x) + fc_1(relu(fc_0(relu(x))))`, without repeated arithmetic.
//!
//! The input of every block but the first is a point's feature and the maximum over its voxel. The maximum's contribution
//! to a layer is the same for all points of a voxel, so it is computed once per voxel. The first block's input is a linear
//! function of the position, and so is its shortcut.

use crate::Result;
use crate::network::layers::Linear;
use crate::network::weights::Scope;
use snake_geometry::Point;
use snake_kernels::{Epilogue, SimdLevel, relu};

/// The first layer and the first block.
#[derive(Debug)]
pub(super) struct FirstBlock {
    fc_pos: Linear,
    fc_0: Linear,
    fc_1: Linear,
    /// The product of `fc_pos` and the shortcut, as one layer.
    shortcut: Linear,
}

impl FirstBlock {
    /// Loads `fc_pos` and `blocks.0` of a scope.
    pub(super) fn load(scope: &Scope, hidden: usize) -> Result<Self> {
        let (pos, block, width) = (scope.at("fc_pos"), scope.at("blocks.0"), 2 * hidden);
        let (weight, bias) = (pos.tensor("weight", &[width, 3])?, pos.tensor("bias", &[width])?);
        let shortcut = block.at("shortcut").tensor("weight", &[hidden, width])?;
        let product = |row: &[f32], value: &dyn Fn(usize) -> f32| -> f32 {
            row.iter().enumerate().map(|(k, w)| f64::from(*w) * f64::from(value(k))).sum::<f64>() as f32
        };
        let rows = shortcut.chunks_exact(width);
        let position_product: Vec<f32> =
            rows.clone().flat_map(|row| [0, 1, 2].map(|axis| product(row, &|k| weight[3 * k + axis]))).collect();
        let bias_product: Vec<f32> = rows.map(|row| product(row, &|k| bias[k])).collect();
        Ok(Self {
            fc_pos: Linear::new(3, width, &weight, &bias),
            fc_0: Linear::load(&block.at("fc_0"), width, hidden)?,
            fc_1: Linear::load(&block.at("fc_1"), hidden, hidden)?,
            shortcut: Linear::new(3, hidden, &position_product, &bias_product),
        })
    }

    /// The features `(points, hidden)` of points.
    pub(super) fn forward(&self, points: &[Point], features: &mut [f32]) {
        let mut input = vec![0.0; 2 * features.len()];
        self.fc_pos.forward(points.as_flattened(), &mut input, Epilogue::Relu);
        let mut hidden = vec![0.0; features.len()];
        self.fc_0.forward(&input, &mut hidden, Epilogue::Relu);
        self.shortcut.forward(points.as_flattened(), features, Epilogue::Store);
        self.fc_1.forward(&hidden, features, Epilogue::Add);
    }
}

/// A layer whose input is a point's feature and the maximum over its voxel, as two layers whose outputs are added.
#[derive(Debug)]
struct SplitLinear {
    point: Linear,
    voxel: Linear,
}

impl SplitLinear {
    /// Splits a weight matrix `(hidden, 2 hidden)`.
    fn new(hidden: usize, weight: &[f32], bias: &[f32]) -> Self {
        let half = |first: usize| -> Vec<f32> {
            weight.chunks_exact(2 * hidden).flat_map(|row| &row[first..first + hidden]).copied().collect()
        };
        Self {
            point: Linear::new(hidden, hidden, &half(0), &[]),
            voxel: Linear::new(hidden, hidden, &half(hidden), bias),
        }
    }
}

/// A block whose input is pooled over voxels.
#[derive(Debug)]
pub(super) struct PooledBlock {
    hidden: usize,
    fc_0: SplitLinear,
    fc_1: Linear,
    shortcut: SplitLinear,
}

/// What the maximum of each voxel contributes to `fc_0` and to the shortcut of its points, each `(voxels, hidden)`.
pub(super) struct VoxelTerms {
    fc_0: Vec<f32>,
    shortcut: Vec<f32>,
}

impl PooledBlock {
    pub(super) fn load(scope: &Scope, hidden: usize) -> Result<Self> {
        let (fc_0, shape) = (scope.at("fc_0"), [hidden, 2 * hidden]);
        let shortcut = scope.at("shortcut").tensor("weight", &shape)?;
        Ok(Self {
            hidden,
            fc_0: SplitLinear::new(hidden, &fc_0.tensor("weight", &shape)?, &fc_0.tensor("bias", &[hidden])?),
            fc_1: Linear::load(&scope.at("fc_1"), hidden, hidden)?,
            shortcut: SplitLinear::new(hidden, &shortcut, &[]),
        })
    }

    /// The terms of voxels from their maxima `(voxels, hidden)`.
    pub(super) fn voxel_terms(&self, maxima: &[f32]) -> VoxelTerms {
        let mut input = vec![0.0; maxima.len()];
        relu(SimdLevel::current(), maxima, &mut input);
        let mut terms = VoxelTerms { fc_0: vec![0.0; maxima.len()], shortcut: vec![0.0; maxima.len()] };
        self.fc_0.voxel.forward(&input, &mut terms.fc_0, Epilogue::Store);
        self.shortcut.voxel.forward(maxima, &mut terms.shortcut, Epilogue::Store);
        terms
    }

    /// Replaces the features `(points, hidden)` by the block's output. `voxels` holds each point's row of the terms.
    pub(super) fn forward(&self, terms: &VoxelTerms, voxels: &[usize], features: &mut [f32]) {
        let rows_of_terms = |terms: &[f32]| {
            let mut rows = Vec::with_capacity(features.len());
            voxels.iter().for_each(|voxel| rows.extend_from_slice(&terms[voxel * self.hidden..][..self.hidden]));
            rows
        };
        let (mut hidden, mut output) = (rows_of_terms(&terms.fc_0), rows_of_terms(&terms.shortcut));
        let (mut input, mut rectified) = (vec![0.0; features.len()], vec![0.0; features.len()]);
        relu(SimdLevel::current(), features, &mut input);
        self.fc_0.point.forward(&input, &mut hidden, Epilogue::AddAndRelu(&mut rectified));
        self.shortcut.point.forward(features, &mut output, Epilogue::Add);
        self.fc_1.forward(&rectified, &mut output, Epilogue::Add);
        features.copy_from_slice(&output);
    }
}

//! Clouds of different size: each pair has the voxels that suit the smaller cloud.

use std::collections::BTreeMap;

use snake_core::{Control, Model, Result};
use snake_geometry::{Length, Point};

use super::TUNING;
use crate::options::RegisterOptions;
use crate::steps::prepare;
use crate::steps::{PreparedCloud, PreparedClouds};

/// All clouds with the voxels of the usual scale, and those of larger and smaller scales where
/// clouds have them.
pub(super) struct Scales {
    usual: PreparedClouds,
    /// The scale of each cloud, 0 for the usual one, as a power of `scale_ratio`.
    scale_numbers: Vec<i32>,
    /// The other scales: the clouds of this size and larger ones, and the place of each.
    others: BTreeMap<i32, (PreparedClouds, Vec<Option<usize>>)>,
}

impl Scales {
    pub(super) fn new(
        clouds: &[&[Point]],
        viewpoints: &[Option<[f64; 3]>],
        model: Option<&Model>,
        options: &RegisterOptions,
        control: &Control,
    ) -> Result<Self> {
        let usual = prepare(clouds, viewpoints, model, options, control)?;
        let voxel_size = usual.lengths.voxel_size;
        let scale_numbers: Vec<i32> = match options.voxel_size {
            Some(_) => vec![0; clouds.len()],
            None => usual.clouds.iter().map(|cloud| scale(cloud.default_voxel_size() / voxel_size)).collect(),
        };
        let mut others = BTreeMap::new();
        for &scale in scale_numbers.iter().filter(|scale| **scale != 0) {
            if others.contains_key(&scale) {
                continue;
            }
            let members: Vec<usize> = (0..clouds.len()).filter(|&cloud| scale_numbers[cloud] >= scale).collect();
            let mut places = vec![None; clouds.len()];
            members.iter().enumerate().for_each(|(place, &cloud)| places[cloud] = Some(place));
            let size = Length::Units(voxel_size * TUNING.scale_ratio.powi(scale));
            let (clouds, viewpoints): (Vec<&[Point]>, Vec<Option<[f64; 3]>>) =
                members.iter().map(|&cloud| (clouds[cloud], viewpoints.get(cloud).copied().flatten())).unzip();
            let options = options.with_voxel_size(Some(size));
            others.insert(scale, (prepare(&clouds, &viewpoints, model, &options, control)?, places));
        }
        Ok(Self { usual, scale_numbers, others })
    }

    /// All clouds with the usual voxels.
    pub(super) fn usual(&self) -> &[PreparedCloud] {
        &self.usual.clouds
    }

    /// The scale at which clouds are compared: that of the smallest.
    pub(super) fn common(&self, clouds: &[usize]) -> i32 {
        clouds.iter().map(|&cloud| self.scale_numbers[cloud]).min().unwrap_or(0)
    }

    /// A cloud with the voxels of its own size or a smaller one.
    pub(super) fn cloud(&self, cloud: usize, scale: i32) -> &PreparedCloud {
        match self.others.get(&scale) {
            Some((prepared, places)) => places[cloud].map_or(&self.usual.clouds[cloud], |at| &prepared.clouds[at]),
            None => &self.usual.clouds[cloud],
        }
    }

    /// A cloud with the voxels of its own size.
    pub(super) fn own(&self, cloud: usize) -> &PreparedCloud {
        self.cloud(cloud, self.scale_numbers[cloud])
    }

    pub(super) fn inlier_distance(&self, scale: i32) -> f64 {
        self.others
            .get(&scale)
            .map_or(self.usual.lengths.inlier_distance, |(prepared, _)| prepared.lengths.inlier_distance)
    }

    pub(super) fn len(&self) -> usize {
        self.scale_numbers.len()
    }
}

/// The scale of voxels that are so many times as large as the usual ones.
fn scale(ratio: f64) -> i32 {
    (ratio.ln() / TUNING.scale_ratio.ln()).round() as i32
}

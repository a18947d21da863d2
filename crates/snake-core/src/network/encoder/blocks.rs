//! The encoder of a scene: PointNet within cells, scattering to the nodes, U-Net on blocks.

use snake_kernels::BLOCK_VOXELS;

use super::EncoderMemory;
use super::pointnet::PointNet;
use super::scatter_blocks as scatter;
use super::unet_blocks::BlockUnet;
use crate::control::Counter;
use crate::lattice::{Cells, FinestLevel, Lattice, Level, MAX_NODE, VoxelGroups, levels};
use crate::network::check;
use crate::network::config::ModelConfig;
use crate::network::volume::Volume;
use crate::network::weights::Scope;
use crate::{Error, Result};
use snake_geometry::Point;

/// The encoder of a scene model.
#[derive(Debug)]
pub(crate) struct BlockEncoder {
    pub(crate) points: PointNet,
    unet: BlockUnet,
    /// A node's sum of features is divided by its mass, but at least by this.
    scatter_mass: f32,
}

impl BlockEncoder {
    pub(crate) fn load(scope: &Scope, config: &ModelConfig, scatter_mass: f32) -> Result<Self> {
        Ok(Self {
            points: PointNet::load(scope, config)?,
            unet: BlockUnet::load(&scope.at("unet3d"), config)?,
            scatter_mass,
        })
    }

    /// Encodes points, given in voxels.
    pub(crate) fn encode(&self, points: &[Point], memory: &mut EncoderMemory, counter: &Counter) -> Result<Volume> {
        self.encode_also(points, &[], memory, counter)
    }

    /// [`BlockEncoder::encode`] with additional blocks around the cells `more`, which add no points.
    pub(super) fn encode_also(
        &self,
        points: &[Point],
        more: &[[i32; 3]],
        memory: &mut EncoderMemory,
        counter: &Counter,
    ) -> Result<Volume> {
        let cells = self.cells(points, &mut memory.groups)?;
        let channels = self.points.channels();
        let finest = finest_level(cells.iter().chain(more).copied(), channels)?;
        counter.check()?;
        let levels = levels(self.unet.num_levels(), finest);
        counter.check()?;
        let num_grouped = memory.groups.num_points(0..cells.len());
        counter.set_total(self.points.work(num_grouped) + self.unet.work(&levels));
        let offset = |index: usize| points[index].map(|v| v - v.floor() - 0.5);
        let width = scatter::slots_width(channels);
        let num_sums = cells.len() * width;
        let num_nodes = (levels[0].filled.len() + 1) * BLOCK_VOXELS * channels;
        let mut unet_memory = self.unet.memory(&levels, num_sums);
        let first_node = unet_memory.len() - num_nodes;
        let (sums, nodes) = unet_memory.split_at_mut(first_node);
        let sums = &mut sums[..num_sums];
        sums.fill(0.0);
        self.points.add_to_voxels(&memory.groups, offset, scatter::spread, sums, counter)?;
        counter.check()?;
        self.write_nodes(&levels[0], &cells, sums, nodes);
        let values = self.unet.forward(&levels, unet_memory, counter)?;
        let grid = levels.into_iter().next().map(|level| level.near).unwrap_or_default();
        let cells = Cells::from_groups(points, &memory.groups, &cells);
        Ok(Volume { lattice: Lattice::Blocks(grid, cells), channels, values })
    }

    /// Groups points by cell. Returns the lowest node of each cell with points.
    fn cells(&self, points: &[Point], groups: &mut VoxelGroups) -> Result<Vec<[i32; 3]>> {
        if let Some(point) = points.iter().find(|point| !point.iter().all(|v| v.abs() < MAX_NODE)) {
            let allowed = "at least a millionth of the cloud's extent";
            let value = format!(
                "so small that the cloud is {:.0} voxels wide",
                point.iter().fold(0.0, |m: f32, v| m.max(v.abs()))
            );
            return Err(Error::Option { name: "voxel_size", value, allowed });
        }
        groups.fill_sparse(points)
    }

    /// Writes the input of the U-Net: block 0, which stands for missing blocks, and the filled blocks.
    fn write_nodes(&self, level: &Level, cells: &[[i32; 3]], sums: &[f32], nodes: &mut [f32]) {
        let channels = self.points.channels();
        let (missing, nodes) = nodes.split_at_mut(BLOCK_VOXELS * channels);
        missing.fill(0.0);
        scatter::gather(&level.filled, &level.neighbors, cells, sums, self.scatter_mass, channels, nodes);
    }
}

/// The finest level for cells. Refuses a volume that needs too much memory; the error names a voxel size that fits.
fn finest_level(cells: impl Iterator<Item = [i32; 3]> + Clone, channels: usize) -> Result<FinestLevel> {
    let max = check::max_blocks(channels);
    if let Some(level) = FinestLevel::new(cells.clone(), max) {
        return Ok(level);
    }
    let fits = |halvings: &u32| FinestLevel::new(cells.clone().map(|cell| cell.map(|i| i >> halvings)), max).is_some();
    // All cells lie within 2^20 nodes of zero, so after 20 halvings few are left.
    let factor = 1 << (1..20).find(fits).unwrap_or(20);
    let value =
        format!("so small that more than {max} blocks of 4 x 4 x 4 voxels are needed; {factor} times this size fits");
    Err(Error::Option { name: "voxel_size", value, allowed: "a size that needs at most a gibibyte of features" })
}

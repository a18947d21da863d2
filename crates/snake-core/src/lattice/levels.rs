//! The blocks of each level of the U-Net.

use snake_geometry::in_parallel;
use snake_kernels::BLOCK_SIDE;

use super::blocks::{BlockGrid, children, half_of_parent, places_between};

/// A level has blocks for all nodes within this distance of the points' cells, or of the next finer level's blocks. Two
/// convolutions reach this far, so the blocks hold all features that the encoder computes from the points.
const REACH: i32 = 2;

/// The same distance for the near blocks: they hold the output of one convolution of the points' features.
const NEAR: i32 = 1;

/// The same distance for the filled blocks: they hold the features of the points.
const FILLED: i32 = 0;

/// One level: its blocks and where their neighbours are stored.
#[derive(Debug, Default)]
pub(crate) struct Level {
    pub(crate) grid: BlockGrid,
    /// The blocks near the points, which have the lowest numbers; at coarser levels, all blocks. The
    /// encoder's first convolution and the decoder's last one compute only these.
    pub(crate) near: BlockGrid,
    /// The blocks that hold the features of the points, which have the lowest numbers of all; at coarser levels, all
    /// blocks. The encoder's first convolution reads only these.
    pub(crate) filled: BlockGrid,
    /// For each block, the numbers of the 27 blocks at its place and around it.
    pub(crate) neighbors: Vec<[u32; 27]>,
    /// For each block, the 27 blocks at and around its parent in the next coarser level, and in which half of it the block lies.
    pub(crate) coarser: Vec<[u32; 27]>,
    pub(crate) halves: Vec<u8>,
    /// For each block, the eight blocks of the next finer level that it covers.
    pub(crate) children: Vec<[u32; 8]>,
}

/// The blocks of the finest level for cells given by their lowest nodes: blocks that hold the cells, blocks near them, and all.
#[derive(Debug)]
pub(crate) struct FinestLevel {
    pub(crate) filled: BlockGrid,
    pub(crate) near: BlockGrid,
    pub(crate) all: BlockGrid,
}

impl FinestLevel {
    /// Returns `None` for more blocks than `max`. Memory grows with the number of cells, however many blocks there would be.
    pub(crate) fn new(cells: impl Iterator<Item = [i32; 3]> + Clone, max: usize) -> Option<Self> {
        let own = BlockGrid::new(cells.clone().map(|cell| cell.map(|i| i.div_euclid(BLOCK_SIDE as i32))));
        if own.len() > max {
            return None;
        }
        let about_cells = |reach: i32| {
            let about_cell = move |cell: [i32; 3]| places_between(cell.map(|i| i - reach), cell.map(|i| i + 1 + reach));
            BlockGrid::new(cells.clone().flat_map(about_cell))
        };
        let filled = about_cells(FILLED);
        let near = filled.with(&about_cells(NEAR));
        let all = near.with(&about_cells(REACH));
        (all.len() <= max).then_some(Self { filled, near, all })
    }
}

/// The levels of the U-Net, finest first.
pub(crate) fn levels(number: usize, FinestLevel { filled, near, all }: FinestLevel) -> Vec<Level> {
    let mut grids = vec![all];
    for level in 1..number {
        let half = BLOCK_SIDE as i32 / 2;
        let about_block = |place: [i32; 3]| {
            places_between(place.map(|i| half * i - REACH), place.map(|i| half * i + half - 1 + REACH))
        };
        grids.push(BlockGrid::new(grids[level - 1].places().flat_map(about_block)));
    }
    let mut levels: Vec<Level> = Vec::with_capacity(number);
    for (level, grid) in grids.iter().enumerate() {
        let about = |grid: &BlockGrid, shift: u32| {
            let places: Vec<_> = grids[level].places().collect();
            in_parallel(places.iter(), |place| grid.about(place.map(|i| i >> shift)))
        };
        levels.push(Level {
            neighbors: about(grid, 0),
            coarser: grids.get(level + 1).map(|coarser| about(coarser, 1)).unwrap_or_default(),
            halves: grid.places().map(half_of_parent).collect(),
            children: match level.checked_sub(1) {
                Some(finer) => grid.places().map(|place| children(&grids[finer], place)).collect(),
                None => Vec::new(),
            },
            near: if level == 0 { near.clone() } else { grid.clone() },
            filled: if level == 0 { filled.clone() } else { grid.clone() },
            grid: grid.clone(),
        });
    }
    levels
}

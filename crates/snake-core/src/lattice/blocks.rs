//! Blocks of 4x4x4 nodes of a lattice, found by their place.

use snake_kernels::{BLOCK_SIDE, BLOCK_VOXELS, Corners};

use snake_geometry::Point;

/// The place of a block along x, y, z, in blocks.
pub(crate) type Place = [i32; 3];

/// Places are within ± this along each axis. Nodes are then within ±2^20, where float32 resolves a sixteenth of a voxel.
const MAX_PLACE: i32 = 1 << 18;

/// Coordinates of points must be below this, so that all blocks around the points have places.
pub(crate) const MAX_NODE: f32 = ((MAX_PLACE - 16) * BLOCK_SIDE as i32) as f32;

/// The stored blocks of a lattice, numbered from 1 along a Z-order curve; number 0 stands for all other blocks. Blocks
/// that are close in space have close numbers, so their values are likely in the cache.
#[derive(Debug, Clone, Default)]
pub(crate) struct BlockGrid {
    /// Keys of the blocks, in the order of their numbers.
    keys: Vec<u64>,
    /// Open-addressing hash table of block numbers; 0 marks an empty entry. Its length is a power of two.
    table: Vec<u32>,
}

/// The key that orders places along a Z-order curve: it interleaves the bits of x, y and z, with x lowest.
fn key(place: Place) -> u64 {
    let [x, y, z] = place.map(|i| spread((i + MAX_PLACE) as u64));
    (z << 2) | (y << 1) | x
}

/// Inverse of [`key`].
fn place(key: u64) -> Place {
    [key, key >> 1, key >> 2].map(|bits| gather(bits) as i32 - MAX_PLACE)
}

/// Spreads the lowest 21 bits of a value to every third bit.
fn spread(value: u64) -> u64 {
    SPREADS.into_iter().fold(value, |bits, (shift, mask)| (bits | (bits << shift)) & mask)
}

/// Inverse of [`spread`]; other bits are ignored.
fn gather(bits: u64) -> u64 {
    let masks = SPREADS.map(|(_, mask)| mask).into_iter().rev().skip(1).chain([(1 << 21) - 1]);
    let shifts = SPREADS.map(|(shift, _)| shift).into_iter().rev();
    shifts.zip(masks).fold(bits & SPREADS[4].1, |bits, (shift, mask)| (bits | (bits >> shift)) & mask)
}

/// Steps that spread bits: a shift, and the mask of the bits that stay.
const SPREADS: [(u32, u64); 5] = [
    (32, 0x001F_0000_0000_FFFF),
    (16, 0x001F_0000_FF00_00FF),
    (8, 0x100F_00F0_0F00_F00F),
    (4, 0x10C3_0C30_C30C_30C3),
    (2, 0x1249_2492_4924_9249),
];

impl BlockGrid {
    /// The grid of the blocks at these places; a place may occur several times.
    pub(crate) fn new(places: impl Iterator<Item = Place>) -> Self {
        let mut keys: Vec<u64> = Vec::new();
        for key in places.map(key) {
            // Places come in runs: most repetitions follow each other.
            if keys.last() != Some(&key) {
                keys.push(key);
            }
        }
        keys.sort_unstable();
        keys.dedup();
        Self::from_keys(keys)
    }

    /// The grid of these blocks and of the blocks of `more` that are not among them, which are numbered last.
    pub(crate) fn with(&self, more: &Self) -> Self {
        let is_new = |key: &u64| self.number(place(*key)) == 0;
        Self::from_keys(self.keys.iter().copied().chain(more.keys.iter().copied().filter(is_new)).collect())
    }

    fn from_keys(keys: Vec<u64>) -> Self {
        let mut table = vec![0; (2 * keys.len()).next_power_of_two().max(2)];
        for (number, &key) in (1..).zip(&keys) {
            let mut entry = Self::first_entry(key, table.len());
            while table[entry] != 0 {
                entry = (entry + 1) % table.len();
            }
            table[entry] = number;
        }
        Self { keys, table }
    }

    fn first_entry(key: u64, length: usize) -> usize {
        (key.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> (64 - length.trailing_zeros())) as usize
    }

    /// The number of stored blocks.
    pub(crate) fn len(&self) -> usize {
        self.keys.len()
    }

    /// The places of the stored blocks, from number 1 on.
    pub(crate) fn places(&self) -> impl ExactSizeIterator<Item = Place> + Clone {
        self.keys.iter().map(|&key| place(key))
    }

    /// The number of the block at a place; 0 if it is not stored.
    pub(crate) fn number(&self, place: Place) -> u32 {
        if self.table.is_empty() || place.iter().any(|i| !(-MAX_PLACE..MAX_PLACE).contains(i)) {
            return 0;
        }
        let key = key(place);
        let mut entry = Self::first_entry(key, self.table.len());
        loop {
            match self.table[entry] {
                0 => return 0,
                number if self.keys[number as usize - 1] == key => return number,
                _ => entry = (entry + 1) % self.table.len(),
            }
        }
    }

    /// The numbers of the 27 blocks at a place and around it, x fastest.
    pub(crate) fn about(&self, [x, y, z]: Place) -> [u32; 27] {
        std::array::from_fn(|n| {
            let step = [n % 3, n / 3 % 3, n / 9].map(|step| step as i32 - 1);
            self.number([x + step[0], y + step[1], z + step[2]])
        })
    }

    /// The index of a node in values that are stored block by block.
    pub(crate) fn node(&self, node: [i32; 3]) -> u32 {
        let place = node.map(|i| i.div_euclid(BLOCK_SIDE as i32));
        self.number(place) * BLOCK_VOXELS as u32 + within_block(node)
    }

    /// The eight nodes around a query in the network's frame.
    pub(crate) fn corners(&self, query: Point) -> Corners {
        if !query.iter().all(|v| v.abs() < MAX_NODE) {
            return Corners::default();
        }
        let low = query.map(|v| v.floor() as i32);
        let fraction = std::array::from_fn(|axis| query[axis] - low[axis] as f32);
        let block = low.map(|i| i.div_euclid(BLOCK_SIDE as i32));
        let number = self.number(block);
        let voxels = std::array::from_fn(|corner| {
            let node: [i32; 3] = std::array::from_fn(|axis| low[axis] + (corner >> axis & 1) as i32);
            let place = node.map(|i| i.div_euclid(BLOCK_SIDE as i32));
            let number = if place == block { number } else { self.number(place) };
            number * BLOCK_VOXELS as u32 + within_block(node)
        });
        Corners { voxels, fraction }
    }

    /// The lowest and the highest node of the stored blocks along each axis.
    pub(crate) fn bounds(&self) -> [[i32; 2]; 3] {
        std::array::from_fn(|axis| {
            let ends = self
                .places()
                .map(|place| place[axis])
                .fold([i32::MAX, i32::MIN], |[low, high], i| [low.min(i), high.max(i)]);
            [ends[0] * BLOCK_SIDE as i32, ends[1] * BLOCK_SIDE as i32 + BLOCK_SIDE as i32 - 1]
        })
    }
}

/// The index of a node within its block, `[z][y][x]`.
fn within_block(node: [i32; 3]) -> u32 {
    let [x, y, z] = node.map(|i| i.rem_euclid(BLOCK_SIDE as i32) as u32);
    (z * BLOCK_SIDE as u32 + y) * BLOCK_SIDE as u32 + x
}

/// The places of the blocks that hold the nodes from `low` to `high`.
pub(crate) fn places_between(low: [i32; 3], high: [i32; 3]) -> impl Iterator<Item = Place> {
    let [x, y, z]: [_; 3] = std::array::from_fn(|axis| {
        let [low, high] = [low[axis], high[axis]].map(|i| i.div_euclid(BLOCK_SIDE as i32));
        low..=high
    });
    z.flat_map(move |z| {
        let x = x.clone();
        y.clone().flat_map(move |y| x.clone().map(move |x| [x, y, z]))
    })
}

/// The numbers of the eight blocks of the finer grid that the block at this place covers, x fastest.
pub(crate) fn children(fine: &BlockGrid, [x, y, z]: Place) -> [u32; 8] {
    std::array::from_fn(|n| fine.number([2 * x + (n & 1) as i32, 2 * y + (n >> 1 & 1) as i32, 2 * z + (n >> 2) as i32]))
}

/// In which half of its parent, a block of the next coarser grid, a block lies along each axis; bit 0 is x.
pub(crate) fn half_of_parent(place: Place) -> u8 {
    (0..3).map(|axis| ((place[axis] & 1) as u8) << axis).sum()
}

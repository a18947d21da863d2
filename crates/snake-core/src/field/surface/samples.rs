//! Samples of a function on a regular grid, taken only near its surface.

use crate::Result;
use crate::control::{Control, Counter};
use snake_geometry::{in_parallel, try_in_parallel};

/// Samples per axis of a block.
const SIDE: usize = 4;

/// Samples per block: as many as the decoders process at once.
const VOLUME: usize = SIDE * SIDE * SIDE;

/// Indices of a sample along x, y, z.
pub(super) type Sample = [usize; 3];

/// A grid of samples in blocks, of which only some are known. A sample is occupied if it is known and above the level.
/// Samples on the border are never occupied, so the surface is closed at the border.
pub(super) struct Samples {
    /// Samples per axis of the grid.
    pub(super) resolution: usize,
    pub(super) level: f32,
    /// The index into `values` for each block, x fastest; `None` for unknown blocks.
    slots: Vec<Option<u32>>,
    /// The values of each known block, x fastest.
    values: Vec<[f32; VOLUME]>,
}

impl Samples {
    /// Evaluates `value` near the surface: first at one sample of each block, then at all samples of the blocks whose
    /// first sample is above the level, and of the blocks with a `likely` sample. More blocks follow while an occupied
    /// sample has an unknown neighbour.
    ///
    /// A set of samples above the level that touch, also diagonally, is then completely known, with all its neighbours.
    /// A set is missed only if it contains neither one of the first samples nor a sample of a likely block. Nothing is
    /// missed if every block is likely.
    pub(super) fn near_surface(
        resolution: usize,
        level: f32,
        value: impl Fn(&[Sample]) -> Vec<f32> + Sync,
        likely: impl IntoIterator<Item = Sample>,
        control: &Control,
    ) -> Result<Self> {
        let number = resolution.div_ceil(SIDE).pow(3);
        let mut samples = Self { resolution, level, slots: vec![None; number], values: Vec::new() };
        let mut is_likely = vec![false; number];
        likely.into_iter().for_each(|sample| is_likely[samples.place(sample).0] = true);
        let middle = |block| samples.sample(block, 0).map(|i| (i + SIDE / 2).min(resolution - 1));
        let counter = control.begin("search for the surface", number);
        let search = |tile: usize| -> Result<Vec<usize>> {
            counter.check()?;
            let blocks = tile * VOLUME..number.min((tile + 1) * VOLUME);
            let values = value(&blocks.clone().map(middle).collect::<Vec<_>>());
            counter.add(blocks.len());
            let near = blocks.zip(values).filter(|&(block, value)| value > level || is_likely[block]);
            Ok(near.map(|(block, _)| block).collect())
        };
        let mut wanted = try_in_parallel(0..number.div_ceil(VOLUME), search)?.concat();
        while !wanted.is_empty() {
            samples.ask(&wanted, &value, &control.begin("occupancy", wanted.len()))?;
            wanted = in_parallel(wanted.iter(), |&block| samples.unknown_beside_occupied(block)).concat();
            wanted.sort_unstable();
            wanted.dedup();
        }
        Ok(samples)
    }

    /// Evaluates all samples of blocks.
    fn ask(
        &mut self,
        blocks: &[usize],
        value: &(impl Fn(&[Sample]) -> Vec<f32> + Sync),
        counter: &Counter,
    ) -> Result<()> {
        let values = try_in_parallel(blocks.iter(), |&block| {
            counter.check()?;
            // The last block along an axis can extend beyond the grid.
            let inside = |sample: &Sample| sample.iter().all(|&i| i < self.resolution);
            let asked: Vec<Sample> = self.block_samples(block).filter(inside).collect();
            let mut values = [f32::NEG_INFINITY; VOLUME];
            counter.add(1);
            for (&sample, value) in asked.iter().zip(value(&asked)) {
                let on_border = sample.iter().any(|&i| i == 0 || i == self.resolution - 1);
                values[self.place(sample).1] = if on_border { value.min(self.level) } else { value };
            }
            Ok(values)
        });
        for (&block, slot) in blocks.iter().zip(self.values.len() as u32..) {
            self.slots[block] = Some(slot);
        }
        self.values.extend(values?);
        Ok(())
    }

    fn unknown_beside_occupied(&self, block: usize) -> Vec<usize> {
        let mut unknown = Vec::new();
        for sample in self.block_samples(block).filter(|&sample| self.occupied(sample)) {
            // An occupied sample is not on the border.
            for step in 0..27 {
                let neighbour = [sample[0] + step % 3 - 1, sample[1] + step / 3 % 3 - 1, sample[2] + step / 9 - 1];
                let (beside, _) = self.place(neighbour);
                if self.slots[beside].is_none() && !unknown.contains(&beside) {
                    unknown.push(beside);
                }
            }
        }
        unknown
    }

    /// The known blocks, in the order of the grid.
    pub(super) fn known(&self) -> Vec<usize> {
        (0..self.slots.len()).filter(|&block| self.slots[block].is_some()).collect()
    }

    /// The samples of a block, x fastest.
    pub(super) fn block_samples(&self, block: usize) -> impl Iterator<Item = Sample> {
        (0..VOLUME).map(move |place| self.sample(block, place))
    }

    /// The sample at a position in a block.
    fn sample(&self, block: usize, place: usize) -> Sample {
        let along = self.resolution.div_ceil(SIDE);
        let start = [block % along, block / along % along, block / (along * along)].map(|i| i * SIDE);
        [start[0] + place % SIDE, start[1] + place / SIDE % SIDE, start[2] + place / (SIDE * SIDE)]
    }

    /// The block of a sample, and its position in the block.
    fn place(&self, [x, y, z]: Sample) -> (usize, usize) {
        let along = self.resolution.div_ceil(SIDE);
        let block = x / SIDE + along * (y / SIDE + along * (z / SIDE));
        (block, x % SIDE + SIDE * (y % SIDE + SIDE * (z % SIDE)))
    }

    /// The value of a sample; minus infinity if it is unknown.
    pub(super) fn value(&self, sample: Sample) -> f32 {
        if sample.iter().any(|&i| i >= self.resolution) {
            return f32::NEG_INFINITY;
        }
        let (block, place) = self.place(sample);
        self.slots[block].map_or(f32::NEG_INFINITY, |slot| self.values[slot as usize][place])
    }

    pub(super) fn occupied(&self, sample: Sample) -> bool {
        self.value(sample) > self.level
    }

    /// The number of the edge from a sample to the next along an axis. Numbers grow with the block, and within a block
    /// with the sample.
    pub(super) fn edge(&self, low: Sample, axis: usize) -> u32 {
        let (block, place) = self.place(low);
        ((block * VOLUME + place) * 3 + axis) as u32
    }

    /// The lower sample and the axis of an edge.
    pub(super) fn ends(&self, edge: u32) -> (Sample, usize) {
        let (low, axis) = (edge as usize / 3, edge as usize % 3);
        (self.sample(low / VOLUME, low % VOLUME), axis)
    }
}

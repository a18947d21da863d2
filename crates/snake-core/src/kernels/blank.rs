//! Tiles that need not be computed: most of a cloud's volume is empty.
//!
//! The volume that enters the U-Net is zero but for the few voxels with points, so normalised it is one constant vector
//! there. A convolution of nothing but such voxels gives the same eight outputs for every tile of 2x2x2, unless the
//! zeros beyond the border reach in; then the outputs depend only on which border it is and how near. So a *blank* tile
//! is one whose values depend on its distance from the borders alone, counted up to `reach` tiles. A tile of the next
//! layer is blank, with a reach of one more, if its 27 neighbours are. One tile of each kind is computed and the others
//! are copies of it, equal to the last bit.

use std::collections::{BTreeMap, HashMap};

use rayon::prelude::*;

/// The blank tiles of a volume.
#[derive(Debug, Clone)]
pub(crate) struct Blank {
    /// Tiles along z, y, x.
    tiles: [usize; 3],
    /// Of each tile, z slowest.
    blank: Vec<bool>,
    reach: usize,
}

impl Blank {
    /// Of a volume of `size` D, H, W that is zero but for these voxels.
    pub(crate) fn around(size: [usize; 3], voxels: impl Iterator<Item = usize>) -> Self {
        let tiles = size.map(|n| n.div_ceil(2));
        let mut blank = vec![true; tiles.iter().product()];
        for voxel in voxels {
            let [z, y, x] = [voxel / (size[1] * size[2]), voxel / size[2] % size[1], voxel % size[2]].map(|i| i / 2);
            blank[(z * tiles[1] + y) * tiles[2] + x] = false;
        }
        Self { tiles, blank, reach: 0 }
    }

    /// Of the result of a 3x3x3 convolution.
    pub(crate) fn convolved(&self) -> Self {
        let [_, height, width] = self.tiles;
        let near = |i: usize, n: usize| i.saturating_sub(1)..(i + 2).min(n);
        let neighbours_blank = |tile: usize| {
            let [z, y, x] = [tile / (height * width), tile / width % height, tile % width];
            near(z, self.tiles[0]).all(|z| {
                near(y, height).all(|y| self.blank[(z * height + y) * width..][near(x, width)].iter().all(|&b| b))
            })
        };
        let blank = (0..self.blank.len()).into_par_iter().map(neighbours_blank).collect();
        Self { blank, reach: self.reach + 1, ..*self }
    }

    /// For each blank tile the first of its kind, which may be itself; none for the others.
    pub(crate) fn originals(&self) -> Vec<Option<u32>> {
        let [_, height, width] = self.tiles;
        let kind = |i: usize, n: usize| {
            if i < self.reach { i } else { (n - 1 - i).min(self.reach) + self.reach }
        };
        let mut first = HashMap::new();
        let original = |(tile, &blank): (usize, &bool)| {
            let [z, y, x] = [tile / (height * width), tile / width % height, tile % width];
            let kinds = [kind(z, self.tiles[0]), kind(y, height), kind(x, width)];
            blank.then(|| *first.entry(kinds).or_insert(tile as u32))
        };
        self.blank.iter().enumerate().map(original).collect()
    }
}

/// Fills the tiles of `output` (`size` D, H, W, `channels`) that are copies of another, and adds what they add to the
/// channels' sums and sums of squares.
pub(crate) fn copy_blank(
    originals: &[Option<u32>],
    [_, height, width]: [usize; 3],
    channels: usize,
    output: &mut [f32],
    sums: &mut [[f64; 2]],
) {
    let [tile_rows, tiles_along] = [height.div_ceil(2), width.div_ceil(2)];
    let mut copies = BTreeMap::new();
    for (tile, &original) in originals.iter().enumerate() {
        if let Some(original) = original.filter(|&original| original as usize != tile) {
            *copies.entry(original).or_insert(0) += 1;
        }
    }
    // The eight voxels of each original, and what a voxel beyond an odd size would add: nothing.
    let voxels_of = |original: u32| {
        let tile = original as usize;
        let (z, y, x) = (tile / (tile_rows * tiles_along), tile / tiles_along % tile_rows, tile % tiles_along);
        let mut values = vec![0.0; 8 * channels];
        for (corner, voxel) in values.chunks_exact_mut(channels).enumerate() {
            let (z, y, x) = (2 * z + corner / 4, 2 * y + corner / 2 % 2, 2 * x + corner % 2);
            if let Some(from) =
                output.get(((z * height + y) * width + x) * channels..).filter(|_| y < height && x < width)
            {
                voxel.iter_mut().zip(from).for_each(|(v, &f)| *v = f);
            }
        }
        values
    };
    let values: HashMap<u32, Vec<f32>> = copies.keys().map(|&original| (original, voxels_of(original))).collect();
    for (original, count) in copies {
        for voxel in values[&original].chunks_exact(channels) {
            for (sum, &value) in sums.iter_mut().zip(voxel) {
                sum[0] += f64::from(value) * f64::from(count);
                sum[1] += f64::from(value).powi(2) * f64::from(count);
            }
        }
    }
    output.par_chunks_mut(width * channels).enumerate().for_each(|(line, output)| {
        let (z, y) = (line / height, line % height);
        let tiles = originals.iter().enumerate().skip((z / 2 * tile_rows + y / 2) * tiles_along);
        for ((tile, original), to) in tiles.zip(output.chunks_mut(2 * channels)) {
            if let Some(original) = original.filter(|&original| original as usize != tile) {
                let from = &values[&original][(z % 2 * 4 + y % 2 * 2) * channels..];
                to.copy_from_slice(&from[..to.len()]);
            }
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_are_blank_where_no_voxel_is_near() {
        let blank = Blank::around([2, 2, 11], [4].into_iter());
        assert_eq!(blank.blank, [true, true, false, true, true, true]);
        let next = blank.convolved();
        assert_eq!(next.blank, [true, false, false, false, true, true]);
        assert_eq!(next.originals(), [Some(0), None, None, None, Some(4), Some(5)]);
        assert_eq!(next.convolved().blank, [false, false, false, false, false, true]);
    }

    #[test]
    fn tiles_inside_are_of_one_kind_and_each_border_is_another() {
        let blank = Blank::around([10, 10, 10], std::iter::empty()).convolved();
        let originals = blank.originals();
        let mut kinds: Vec<_> = originals.iter().map(|o| o.unwrap()).collect();
        assert_eq!(kinds[2 * 25 + 2 * 5 + 2], 25 + 5 + 1);
        kinds.sort_unstable();
        kinds.dedup();
        assert_eq!(kinds.len(), 27);
        let kinds: std::collections::HashSet<_> = blank.convolved().originals().into_iter().collect();
        assert_eq!(kinds.len(), 125);
    }
}

//! Voxels that need not be computed: most of a cloud's volume is empty.
//!
//! The volume that enters the U-Net is zero but for the few voxels with points, so normalised it is one constant vector
//! there. A convolution of nothing but such voxels gives the same output everywhere, unless the zeros beyond the border
//! reach in; then the output depends only on which border it is and how near. So a *blank* voxel is one whose value
//! depends on its distance from the borders alone, counted up to `reach` voxels. A voxel of the next layer is blank, with
//! a reach of one more, if its 27 neighbours are. Of the tiles that a convolution computes together and that are blank
//! throughout, one of each kind is computed; the others are copies of it, equal to the last bit.

use std::collections::{BTreeMap, HashMap};

use rayon::prelude::*;

/// The blank voxels of a volume.
#[derive(Debug, Clone)]
pub(crate) struct Blank {
    /// Voxels along z, y, x.
    size: [usize; 3],
    /// Of each voxel, z slowest.
    blank: Vec<bool>,
    reach: usize,
}

impl Blank {
    /// Of a volume of `size` D, H, W that is zero but for these voxels.
    pub(crate) fn around(size: [usize; 3], voxels: impl Iterator<Item = usize>) -> Self {
        let mut blank = vec![true; size.iter().product()];
        voxels.for_each(|voxel| blank[voxel] = false);
        Self { size, blank, reach: 0 }
    }

    /// Of the result of a 3x3x3 convolution.
    pub(crate) fn convolved(&self) -> Self {
        let [_, height, width] = self.size;
        let mut blank = self.blank.clone();
        // Along each axis in turn a voxel is blank if it and its two neighbours are.
        for (stride, length) in [(1, width), (width, height), (height * width, self.size[0])] {
            let before = blank.clone();
            for (block, before) in blank.chunks_mut(stride * length).zip(before.chunks(stride * length)) {
                block.iter_mut().zip(&before[stride..]).for_each(|(blank, &next)| *blank &= next);
                block[stride..].iter_mut().zip(before).for_each(|(blank, &last)| *blank &= last);
            }
        }
        Self { blank, reach: self.reach + 1, ..*self }
    }

    /// Of the maximum over blocks of 2x2x2; an odd last slice is dropped.
    pub(crate) fn pooled(&self) -> Self {
        let size = self.size.map(|n| n / 2);
        let blank = (0..size.iter().product()).map(|voxel| {
            let corner = split(voxel, size).map(|i| 2 * i);
            all_of(self.size, corner, 2, |voxel| self.blank[voxel])
        });
        Self { size, blank: blank.collect(), reach: self.reach.div_ceil(2) }
    }

    /// For each tile of `tile` voxels along each axis that is blank throughout, the first of its kind, which may be
    /// itself; none for the others.
    pub(crate) fn originals(&self, tile: usize) -> Vec<Option<u32>> {
        let tiles = self.size.map(|n| n.div_ceil(tile));
        // All tiles that no border reaches are alike.
        let kind = |axis: usize, i: usize| {
            let inside = i * tile >= self.reach && (i + 1) * tile + self.reach <= self.size[axis];
            if inside { usize::MAX } else { i }
        };
        let mut first = HashMap::new();
        let original = |number: usize| {
            let place = split(number, tiles);
            let kinds: [usize; 3] = std::array::from_fn(|axis| kind(axis, place[axis]));
            all_of(self.size, place.map(|i| i * tile), tile, |voxel| self.blank[voxel])
                .then(|| *first.entry(kinds).or_insert(number as u32))
        };
        (0..tiles.iter().product()).map(original).collect()
    }
}

/// The place along z, y, x of an item of a grid.
fn split(number: usize, [_, height, width]: [usize; 3]) -> [usize; 3] {
    [number / (height * width), number / width % height, number % width]
}

/// Whether something holds for all voxels of a cube that lie within the volume.
fn all_of(size: [usize; 3], corner: [usize; 3], length: usize, holds: impl Fn(usize) -> bool) -> bool {
    let [z, y, x] = std::array::from_fn(|axis| corner[axis]..(corner[axis] + length).min(size[axis]));
    z.into_iter().all(|z| y.clone().all(|y| x.clone().all(|x| holds((z * size[1] + y) * size[2] + x))))
}

/// Fills the tiles of `output` (`size` D, H, W, `channels`) that are copies of another, and adds what they add to the
/// channels' sums and sums of squares.
pub(crate) fn copy_blank(
    originals: &[Option<u32>],
    tile: usize,
    size: [usize; 3],
    channels: usize,
    output: &mut [f32],
    sums: &mut [[f64; 2]],
) {
    let [_, height, width] = size;
    let tiles = size.map(|n| n.div_ceil(tile));
    let mut copies = BTreeMap::new();
    for (number, &original) in originals.iter().enumerate() {
        if let Some(original) = original.filter(|&original| original as usize != number) {
            *copies.entry(original).or_insert(0) += 1;
        }
    }
    // The voxels of each original, and what a voxel beyond the border would add: nothing.
    let voxels_of = |original: u32| {
        let corner = split(original as usize, tiles).map(|i| i * tile);
        let mut values = vec![0.0; tile.pow(3) * channels];
        for (number, voxel) in values.chunks_exact_mut(channels).enumerate() {
            let within = split(number, [tile; 3]);
            let [z, y, x]: [usize; 3] = std::array::from_fn(|axis| corner[axis] + within[axis]);
            if z < size[0] && y < height && x < width {
                voxel.copy_from_slice(&output[((z * height + y) * width + x) * channels..][..channels]);
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
        let first = (z / tile * tiles[1] + y / tile) * tiles[2];
        for ((number, original), to) in (first..).zip(&originals[first..]).zip(output.chunks_mut(tile * channels)) {
            if let Some(original) = original.filter(|&original| original as usize != number) {
                let from = &values[&original][(z % tile * tile + y % tile) * tile * channels..];
                to.copy_from_slice(&from[..to.len()]);
            }
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_are_blank_where_no_point_is_near() {
        let blank = Blank::around([2, 2, 12], [3].into_iter());
        assert_eq!(blank.originals(2), [Some(0), None, Some(0), Some(0), Some(0), Some(0)]);
        let next = blank.convolved();
        assert_eq!(next.originals(2), [Some(0), None, None, Some(3), Some(3), Some(5)]);
        assert_eq!(next.originals(4), [None, None, Some(2)]);
        assert_eq!(next.convolved().originals(2), [None, None, None, Some(3), Some(3), Some(5)]);
        assert_eq!(next.pooled().originals(1), [Some(0), None, None, Some(3), Some(3), Some(5)]);
    }

    #[test]
    fn tiles_inside_are_of_one_kind_and_each_border_is_another() {
        let kinds = |blank: &Blank| blank.originals(2).into_iter().collect::<std::collections::HashSet<_>>().len();
        let blank = Blank::around([10, 10, 10], std::iter::empty()).convolved();
        assert_eq!(blank.originals(2)[2 * 25 + 2 * 5 + 2], Some(25 + 5 + 1));
        assert_eq!(kinds(&blank), 27);
        assert_eq!(kinds(&blank.convolved()), 27);
        assert_eq!(kinds(&blank.convolved().convolved()), 125);
    }
}

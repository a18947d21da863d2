//! Tiles that need not be computed, because the volume is constant around them.
//!
//! Most voxels of a cloud's volume hold no points. They are zero, and one constant vector after normalisation. A
//! convolution of constant voxels gives the same output everywhere, unless the zero padding beyond a border is in reach.
//! There, the output depends only on which border is near and how near it is. So a voxel is *constant* if its value
//! depends only on its distance from the borders, counted up to `reach` voxels. A convolution keeps a voxel constant if
//! its 27 neighbours are constant, and adds one to the reach. Constant tiles of one kind have equal outputs: one of them
//! is computed, and the others are copies of it, equal to the last bit.

use rayon::prelude::*;

/// The constant voxels of a volume.
#[derive(Debug, Clone)]
pub struct ConstantRegion {
    /// Voxels along z, y, x.
    size: [usize; 3],
    /// Whether each voxel is constant, `[z][y][x]`.
    constant: Vec<bool>,
    /// Constant voxels farther than this from every border have the same value.
    reach: usize,
}

impl ConstantRegion {
    /// The constant region of a volume of `size` (D, H, W) that is zero except at these voxels (flat indices).
    ///
    /// # Panics
    /// If a voxel lies outside the volume.
    pub fn around(size: [usize; 3], voxels: impl Iterator<Item = usize>) -> Self {
        let mut constant = vec![true; size.iter().product()];
        voxels.for_each(|voxel| constant[voxel] = false);
        Self { size, constant, reach: 0 }
    }

    /// The constant region after a 3x3x3 convolution.
    pub fn convolved(&self) -> Self {
        let [_, height, width] = self.size;
        let (mut constant, mut before) = (self.constant.clone(), self.constant.clone());
        // Axis by axis, a voxel stays constant if both neighbours are constant.
        for (stride, length) in [(1, width), (width, height), (height * width, self.size[0])] {
            before.copy_from_slice(&constant);
            for (block, before) in constant.chunks_mut(stride * length).zip(before.chunks(stride * length)) {
                block.iter_mut().zip(&before[stride..]).for_each(|(constant, &next)| *constant &= next);
                block[stride..].iter_mut().zip(before).for_each(|(constant, &last)| *constant &= last);
            }
        }
        Self { constant, reach: self.reach + 1, ..*self }
    }

    /// The constant region after max-pooling over blocks of 2x2x2; an odd last slice is dropped.
    pub fn pooled(&self) -> Self {
        let size = self.size.map(|n| n / 2);
        let is_constant = |voxel| {
            let corner = split(voxel, size).map(|i| 2 * i);
            all_of(self.size, corner, 2, |voxel| self.constant[voxel])
        };
        let constant = (0..size.iter().product()).map(is_constant).collect();
        Self { size, constant, reach: self.reach.div_ceil(2) }
    }

    /// For each constant tile, of `tile` voxels along each axis, the first tile of its kind, which may be itself. `None`
    /// for the other tiles.
    pub fn originals(&self, tile: usize) -> Vec<Option<u32>> {
        let tiles = self.size.map(|n| n.div_ceil(tile));
        // All tiles beyond the reach of the borders are of one kind; it is named by the first of them.
        let kind = |axis: usize, i: usize| {
            let inside = i * tile >= self.reach && (i + 1) * tile + self.reach <= self.size[axis];
            if inside { self.reach.div_ceil(tile) } else { i }
        };
        // For each kind, the first constant tile, indexed by the place of the kind's first tile.
        let mut first = vec![None; tiles.iter().product()];
        let original = |number: usize| {
            let place = split(number, tiles);
            let [z, y, x]: [usize; 3] = std::array::from_fn(|axis| kind(axis, place[axis]));
            all_of(self.size, place.map(|i| i * tile), tile, |voxel| self.constant[voxel])
                .then(|| *first[(z * tiles[1] + y) * tiles[2] + x].get_or_insert(number as u32))
        };
        (0..tiles.iter().product()).map(original).collect()
    }
}

/// The position along z, y and x of a flat index in a grid.
fn split(number: usize, [_, height, width]: [usize; 3]) -> [usize; 3] {
    [number / (height * width), number / width % height, number % width]
}

/// Whether a condition holds for all voxels of a cube that lie within the volume.
fn all_of(size: [usize; 3], corner: [usize; 3], length: usize, holds: impl Fn(usize) -> bool) -> bool {
    let [z, y, x] = std::array::from_fn(|axis| corner[axis]..(corner[axis] + length).min(size[axis]));
    z.into_iter().all(|z| y.clone().all(|y| x.clone().all(|x| holds((z * size[1] + y) * size[2] + x))))
}

/// Fills the tiles of `output`, `[z][y][x][channel]`, that are copies of another tile, and adds them to the sums and the
/// sums of squares of the channels.
pub(crate) fn copy_constant_tiles(
    originals: &[Option<u32>],
    tile: usize,
    size: [usize; 3],
    channels: usize,
    output: &mut [f32],
    sums: &mut [[f64; 2]],
) {
    let [_, height, width] = size;
    let tiles = size.map(|n| n.div_ceil(tile));
    // For each tile, the number of its copies.
    let mut counts = vec![0_u32; originals.len()];
    for (number, &original) in originals.iter().enumerate() {
        if let Some(original) = original.filter(|&original| original as usize != number) {
            counts[original as usize] += 1;
        }
    }
    // For each tile that has copies, its position among such tiles.
    let mut places = vec![0_u32; originals.len()];
    let mut num_copied = 0;
    for (place, _) in places.iter_mut().zip(counts.iter()).filter(|(_, count)| **count > 0) {
        *place = num_copied;
        num_copied += 1;
    }
    // The voxels of each tile that has copies. Voxels beyond the border are zero and add nothing.
    let length = tile.pow(3) * channels;
    let mut values = vec![0.0; num_copied as usize * length];
    let copied = counts.iter().enumerate().filter(|(_, count)| **count > 0);
    for ((original, &count), values) in copied.zip(values.chunks_exact_mut(length)) {
        let corner = split(original, tiles).map(|i| i * tile);
        for (number, voxel) in values.chunks_exact_mut(channels).enumerate() {
            let within = split(number, [tile; 3]);
            let [z, y, x]: [usize; 3] = std::array::from_fn(|axis| corner[axis] + within[axis]);
            if z < size[0] && y < height && x < width {
                voxel.copy_from_slice(&output[((z * height + y) * width + x) * channels..][..channels]);
            }
            for (sum, &value) in sums.iter_mut().zip(voxel.iter()) {
                sum[0] += f64::from(value) * f64::from(count);
                sum[1] += f64::from(value).powi(2) * f64::from(count);
            }
        }
    }
    let (places, values) = (&places[..], &values[..]);
    output.par_chunks_mut(width * channels).enumerate().for_each(|(line, output)| {
        let (z, y) = (line / height, line % height);
        let first = (z / tile * tiles[1] + y / tile) * tiles[2];
        for ((number, original), to) in (first..).zip(&originals[first..]).zip(output.chunks_mut(tile * channels)) {
            if let Some(original) = original.filter(|&original| original as usize != number) {
                let values = &values[places[original as usize] as usize * length..];
                let from = &values[(z % tile * tile + y % tile) * tile * channels..];
                to.copy_from_slice(&from[..to.len()]);
            }
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_are_constant_where_no_point_is_near() {
        let constant = ConstantRegion::around([2, 2, 12], [3].into_iter());
        assert_eq!(constant.originals(2)[..], [Some(0), None, Some(0), Some(0), Some(0), Some(0)]);
        let next = constant.convolved();
        assert_eq!(next.originals(2)[..], [Some(0), None, None, Some(3), Some(3), Some(5)]);
        assert_eq!(next.originals(4)[..], [None, None, Some(2)]);
        assert_eq!(next.convolved().originals(2)[..], [None, None, None, Some(3), Some(3), Some(5)]);
        assert_eq!(next.pooled().originals(1)[..], [Some(0), None, None, Some(3), Some(3), Some(5)]);
    }

    #[test]
    fn tiles_inside_are_of_one_kind_and_each_border_is_another() {
        let kinds = |constant: &ConstantRegion| {
            constant.originals(2).iter().copied().collect::<std::collections::HashSet<_>>().len()
        };
        let constant = ConstantRegion::around([10, 10, 10], std::iter::empty()).convolved();
        assert_eq!(constant.originals(2)[2 * 25 + 2 * 5 + 2], Some(25 + 5 + 1));
        assert_eq!(kinds(&constant), 27);
        assert_eq!(kinds(&constant.convolved()), 27);
        assert_eq!(kinds(&constant.convolved().convolved()), 125);
    }
}

//! Transforms of tiles: inputs to V before the products, and products to outputs.
//!
//! The bodies of kernels are loops and functions marked for inlining, because a closure would be compiled without the
//! instructions of the level.

use super::pack::Block;
use super::{Conv3d, FAR, NEAR, Task, TilesOfPlane};
use crate::simd::{LANES, Lanes, load, load_at, store, store_at};

/// The largest M.
pub(super) const MAX_TILE: usize = 4;

/// Transforms LANES input channels of the tiles `[row, x]` of one plane of tiles to V. `to` has `pitch` values per point,
/// of which each tile has the block's width.
///
/// A column of inputs is transformed along z and y once, for all tiles along x that share it.
#[inline(always)]
pub(super) fn transform_inputs<L: Lanes, const N: usize>(
    token: L::Token,
    &TilesOfPlane { conv, plane, tiles }: &TilesOfPlane,
    block: &Block,
    half: usize,
    to: &mut [f32],
    pitch: usize,
) {
    let &Conv3d { size, sources, scale, shift, .. } = conv;
    let source = &sources[block.source];
    let lanes = LANES.min(block.channels - half * LANES);
    let [first, global] = block.first.map(|first| first + half * LANES);
    let norm = [load::<L>(token, &scale[global..], lanes), load::<L>(token, &shift[global..], lanes)];
    let values = &source.values[first..];
    // In an upsampled volume, two neighbouring voxels are one stored voxel.
    let shift = usize::from(source.upsampled);
    let [height, width] = [size[1] >> shift, size[2] >> shift];
    let zero = L::splat(token, 0.0);
    let mut columns = [[[zero; N]; N]; N];
    let mut rows = [[zero; N]; N];
    let mut previous = None;
    for (tile, &[row, x]) in tiles.iter().enumerate() {
        // The start of each line along x; `None` beyond the border.
        let mut lines = [[None; N]; N];
        for (j, lines) in lines.iter_mut().enumerate() {
            for (k, line) in lines.iter_mut().enumerate() {
                let [z, y] = [(N - 2) * plane + k, (N - 2) * row + j];
                if (1..=size[0]).contains(&z) && (1..=size[1]).contains(&y) {
                    *line = Some((((z - 1) >> shift) * height + ((y - 1) >> shift)) * width * source.channels);
                }
            }
        }
        // Neighbours along x share two columns.
        let known = if x > 0 && previous == Some([row, x - 1]) { 2 } else { 0 };
        for i in 0..known {
            columns[i] = columns[N - 2 + i];
        }
        previous = Some([row, x]);
        for i in known..N {
            let column = (N - 2) * x + i;
            if source.upsampled && i > 0 && i % 2 == 0 {
                columns[i] = columns[i - 1];
                continue;
            }
            if !(1..=size[2]).contains(&column) {
                columns[i] = [[zero; N]; N];
                continue;
            }
            let from = ((column - 1) >> shift) * source.channels;
            for (along_z, lines) in rows.iter_mut().zip(&lines) {
                for (value, line) in along_z.iter_mut().zip(lines) {
                    *value = zero;
                    if let Some(line) = line {
                        let values = &values[line + from..];
                        // The first half of the block's channels prefetches for both halves.
                        if half == 0 {
                            let ahead = values.as_ptr().wrapping_add((N >> shift) * source.channels);
                            L::prefetch(ahead);
                            L::prefetch(ahead.wrapping_add(LANES));
                        }
                        *value = load::<L>(token, values, lanes).multiply_add(norm[0], norm[1]);
                    }
                }
                *along_z = inputs_of_axis(*along_z);
            }
            for z in 0..N {
                let mut along_y = [zero; N];
                for (value, row) in along_y.iter_mut().zip(&rows) {
                    *value = row[z];
                }
                columns[i][z] = inputs_of_axis(along_y);
            }
        }
        store_points(&columns, &mut to[tile * block.width()..], 0, pitch);
    }
}

/// Transforms columns of inputs `[x][z][y]`, already transformed along z and y, along x. Stores the points `pitch` apart: those of one
/// tile, or of the eight tiles of an upsampled block, which are `width` apart.
#[inline(always)]
pub(super) fn store_points<L: Lanes, const INPUTS: usize, const POINTS: usize>(
    columns: &[[[L; POINTS]; POINTS]; INPUTS],
    to: &mut [f32],
    width: usize,
    pitch: usize,
) {
    let token = columns[0][0][0].token();
    // Along an axis.
    let [tiles, points] = if POINTS == 5 { [2, 3] } else { [1, POINTS] };
    let last = (tiles * tiles * tiles - 1) * width + (points * points * points - 1) * pitch;
    assert!(to.len() >= last + LANES, "all points of the tiles");
    for z in 0..POINTS {
        for y in 0..POINTS {
            let mut along_x = [L::splat(token, 0.0); INPUTS];
            for (value, column) in along_x.iter_mut().zip(columns) {
                *value = column[z][y];
            }
            let values: [L; POINTS] = inputs_of_axis(along_x);
            for tile in 0..tiles * tiles * tiles {
                let [tile_z, tile_y, tile_x] = [tile / (tiles * tiles), tile / tiles % tiles, tile % tiles];
                // The second tile begins at the middle one of the five points.
                let [point_z, point_y] = [z.wrapping_sub(2 * tile_z), y.wrapping_sub(2 * tile_y)];
                if point_z < points && point_y < points {
                    for x in 0..points {
                        let place = tile * width + ((point_z * points + point_y) * points + x) * pitch;
                        // SAFETY: `place` is at most `last`, after which the assertion finds LANES values.
                        unsafe { store_at(values[2 * tile_x + x], to, place) };
                    }
                }
            }
        }
    }
}

/// Outputs of a tile along an axis, from N products. Upsampled tiles of 2 have three points, because (d0, d1, d1, d2) makes V2 zero.
pub(super) const fn tile_of(n: usize) -> usize {
    if n == 3 { 2 } else { n - 2 }
}

/// Partly transformed outputs of one tile, kept from tile to tile because clearing them takes time.
pub(super) struct Partial<L, const N: usize> {
    /// Transformed along x, at one z.
    rows: [[L; MAX_TILE]; N],
    /// Transformed along x and y.
    pub(super) planes: [[[L; MAX_TILE]; MAX_TILE]; N],
}

impl<L: Lanes, const N: usize> Partial<L, N> {
    #[inline(always)]
    pub(super) fn new(token: L::Token) -> Self {
        let zero = L::splat(token, 0.0);
        Self { rows: [[zero; MAX_TILE]; N], planes: [[[zero; MAX_TILE]; MAX_TILE]; N] }
    }

    /// Transforms the products of a tile, which are `pitch` apart, along x and y.
    #[inline(always)]
    pub(super) fn read(&mut self, products: &[f32], pitch: usize) {
        let token = self.rows[0][0].token();
        let zero = L::splat(token, 0.0);
        assert!(products.len() >= (N * N * N - 1) * pitch + LANES, "all points of the tile");
        for (z, plane) in self.planes.iter_mut().enumerate() {
            for (y, along_x) in self.rows.iter_mut().enumerate() {
                let mut products_of_row = [zero; N];
                for (x, value) in products_of_row.iter_mut().enumerate() {
                    // SAFETY: z, y and x are below N: the index is at most that in the assertion.
                    *value = unsafe { load_at(token, products, ((z * N + y) * N + x) * pitch) };
                }
                *along_x = outputs_of_axis(products_of_row);
            }
            for x in 0..tile_of(N) {
                let mut column = [zero; N];
                for (value, row) in column.iter_mut().zip(&self.rows) {
                    *value = row[x];
                }
                for (row, value) in plane.iter_mut().zip(outputs_of_axis(column)) {
                    row[x] = value;
                }
            }
        }
    }
}

/// Writes the outputs of the tile at `[row, x]` of the task, for the block of channels `out` and after the ReLU, and adds
/// them to the sums. The products are `pitch` apart from point to point.
#[inline(always)]
pub(super) fn transform_outputs<L: Lanes, const N: usize>(
    conv: &Conv3d,
    products: &[f32],
    pitch: usize,
    partial: &mut Partial<L, N>,
    [row, x, out]: [usize; 3],
    task: &mut Task,
    sums: &mut [[f64; 2]],
) {
    let &Conv3d { layer, size, .. } = conv;
    let zero = L::splat(partial.rows[0][0].token(), 0.0);
    partial.read(products, pitch);
    let lanes = LANES.min(layer.outputs - out * LANES);
    let (mut sum, mut squares) = (zero, zero);
    let (first_y, first_x) = ((N - 2) * row, (N - 2) * x);
    for y in 0..N - 2 {
        for x in 0..(N - 2).min(size[2] - first_x) {
            let mut column = [zero; N];
            for (value, plane) in column.iter_mut().zip(&partial.planes) {
                *value = plane[y][x];
            }
            let place = (((first_y + y) * size[2]) + first_x + x) * layer.outputs + out * LANES;
            for (plane, value) in task.planes.iter_mut().zip(outputs_of_axis(column)) {
                if let Some(voxel) = plane.get_mut(place..place + lanes) {
                    let value = value.max(zero);
                    store(value, voxel, lanes);
                    sum = sum.add(value);
                    squares = value.multiply_add(value, squares);
                }
            }
        }
    }
    let totals = sum.to_array().into_iter().zip(squares.to_array());
    for (total, (sum, squares)) in sums[out * LANES..][..lanes].iter_mut().zip(totals) {
        total[0] += f64::from(sum);
        total[1] += f64::from(squares);
    }
}

/// Transforms the inputs along an axis to V: the four or six inputs of one tile, or the four different inputs of two tiles of 2
/// of an upsampled source. These two tiles share the middle one of five values.
#[inline(always)]
pub(super) fn inputs_of_axis<L: Lanes, const INPUTS: usize, const POINTS: usize>(d: [L; INPUTS]) -> [L; POINTS] {
    let token = d[0].token();
    let mut v = [L::splat(token, 0.0); POINTS];
    if POINTS == 4 {
        v[0] = d[0].sub(d[2]);
        v[1] = d[1].add(d[2]);
        v[2] = d[2].sub(d[1]);
        v[3] = d[1].sub(d[3]);
        return v;
    }
    if POINTS == 5 {
        v[0] = d[0].sub(d[1]);
        v[1] = d[1].add(d[1]);
        v[2] = d[1].sub(d[2]);
        v[3] = d[2].add(d[2]);
        v[4] = d[2].sub(d[3]);
        return v;
    }
    let [near, far] = [L::splat(token, NEAR as f32), L::splat(token, FAR as f32)];
    let minus = [L::splat(token, -(NEAR * NEAR) as f32), L::splat(token, -(FAR * FAR) as f32)];
    let [sum, product] =
        [L::splat(token, -(NEAR * NEAR + FAR * FAR) as f32), L::splat(token, (NEAR * NEAR * FAR * FAR) as f32)];
    v[0] = d[0].multiply_add(product, d[2].multiply_add(sum, d[4]));
    v[5] = d[1].multiply_add(product, d[3].multiply_add(sum, d[5]));
    let [even, odd] = [d[2].multiply_add(minus[1], d[4]), d[1].multiply_add(minus[1], d[3])];
    v[1] = odd.multiply_add(near, even);
    v[2] = odd.multiply_add(L::splat(token, -NEAR as f32), even);
    let [even, odd] = [d[2].multiply_add(minus[0], d[4]), d[1].multiply_add(minus[0], d[3])];
    v[3] = odd.multiply_add(far, even);
    v[4] = odd.multiply_add(L::splat(token, -FAR as f32), even);
    v
}

/// Transforms N products along an axis to M outputs.
#[inline(always)]
pub(super) fn outputs_of_axis<L: Lanes, const N: usize>(m: [L; N]) -> [L; MAX_TILE] {
    let token = m[0].token();
    let zero = L::splat(token, 0.0);
    if N == 3 {
        return [m[0].add(m[1]), m[1].sub(m[2]), zero, zero];
    }
    if N == 4 {
        return [m[0].add(m[1]).add(m[2]), m[1].sub(m[2]).sub(m[3]), zero, zero];
    }
    let (near_sum, near_difference) = (m[1].add(m[2]), m[1].sub(m[2]));
    let (far_sum, far_difference) = (m[3].add(m[4]), m[3].sub(m[4]));
    let mut y = [m[0].add(near_sum).add(far_sum), zero, zero, m[5]];
    let [mut near, mut far] = [1.0; 2];
    for (value, [near_part, far_part]) in y[1..].iter_mut().zip([
        [near_difference, far_difference],
        [near_sum, far_sum],
        [near_difference, far_difference],
    ]) {
        (near, far) = (near * NEAR as f32, far * FAR as f32);
        *value = near_part.multiply_add(L::splat(token, near), far_part.multiply_add(L::splat(token, far), *value));
    }
    y
}

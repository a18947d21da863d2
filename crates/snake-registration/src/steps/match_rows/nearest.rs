//! The two nearest rows of descriptors in both directions, by products of matrices.

use ndarray::linalg::general_mat_mul;
use ndarray::{ArrayView2, ArrayViewMut2};
use snake_geometry::try_in_parallel;

use snake_core::{Counter, Result};

/// Number of source rows in one matrix product.
const ROWS_PER_TILE: usize = 64;
/// Number of products that are computed in parallel.
const TILES_PER_ROUND: usize = 32;

/// The nearest row and the squared distances to it and to the second nearest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct NearestRow {
    pub(super) row: usize,
    squared: f32,
    second_squared: f32,
}

impl NearestRow {
    /// Ratio of the two distances, 0 to 1: the smaller, the more distinctive is the match.
    pub(super) fn ratio(&self) -> f32 {
        if self.second_squared > 0.0 { (self.squared / self.second_squared).sqrt().min(1.0) } else { 1.0 }
    }
}

/// The greatest score of a row, the row that has it, and the second greatest score. The score of rows a and
/// b is `a·b - |b|²/2`. It is greatest for the b nearest to a, because `|a - b|² = |a|² - 2 (a·b - |b|²/2)`.
#[derive(Clone, Copy)]
struct BestTwo {
    row: u32,
    best: f32,
    second: f32,
}

impl BestTwo {
    fn nearest(&self, squared_norm: f32) -> NearestRow {
        let squared = |score: f32| (squared_norm - 2.0 * score).max(0.0);
        NearestRow { row: self.row as usize, squared: squared(self.best), second_squared: squared(self.second) }
    }
}

/// Number of scores that are compared at once.
const LANES: usize = 16;

/// The best two scores in each lane. The first of equal scores wins.
#[derive(Clone, Copy)]
struct Lanes {
    rows: [u32; LANES],
    best: [f32; LANES],
    second: [f32; LANES],
}

impl Lanes {
    const NONE: Self = Self { rows: [0; LANES], best: [f32::NEG_INFINITY; LANES], second: [f32::NEG_INFINITY; LANES] };

    /// Inserts a score of `row` into each lane. Without branches, this is a few vector instructions.
    #[inline]
    fn insert(&mut self, row: u32, scores: [f32; LANES]) {
        let Self { rows, best, second } = *self;
        let less = |lane: usize| if scores[lane] > best[lane] { best[lane] } else { scores[lane] };
        *self = Self {
            rows: std::array::from_fn(|lane| if scores[lane] > best[lane] { row } else { rows[lane] }),
            best: std::array::from_fn(|lane| greater(best[lane], scores[lane])),
            second: std::array::from_fn(|lane| greater(second[lane], less(lane))),
        };
    }

    /// Merges lanes whose rows come later.
    fn merge(&mut self, later: &Self) {
        for (lane, (&row, &best)) in later.rows.iter().zip(&later.best).enumerate() {
            let second = greater(self.second[lane], later.second[lane]);
            let less = if best > self.best[lane] { self.best[lane] } else { best };
            self.second[lane] = greater(second, less);
            if best > self.best[lane] {
                (self.rows[lane], self.best[lane]) = (row, best);
            }
        }
    }

    fn at(&self, lane: usize) -> BestTwo {
        BestTwo { row: self.rows[lane], best: self.best[lane], second: self.second[lane] }
    }

    /// The best two of all lanes, where lane i of row j stands for the row `j * LANES + i`.
    fn best_of_all(&self) -> BestTwo {
        let all = (0..LANES).map(|lane| {
            let two = self.at(lane);
            BestTwo { row: two.row * LANES as u32 + lane as u32, ..two }
        });
        let better = |a: BestTwo, b: BestTwo| {
            let is_b = b.best > a.best || (b.best == a.best && b.row < a.row);
            let (first, other) = if is_b { (b, a) } else { (a, b) };
            BestTwo { second: first.second.max(other.best), ..first }
        };
        all.reduce(better).expect("LANES is not 0")
    }
}

/// The greater of two numbers that are not NaN. It is one instruction, unlike `f32::max`.
#[inline]
fn greater(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// Scores of up to LANES products; lanes without a product have the score -∞.
#[inline]
fn scores(products: &[f32], half_norm: impl Fn(usize) -> f32) -> [f32; LANES] {
    match <&[f32; LANES]>::try_from(products) {
        Ok(products) => std::array::from_fn(|lane| products[lane] - half_norm(lane)),
        Err(_) => std::array::from_fn(|lane| products.get(lane).map_or(f32::NEG_INFINITY, |v| v - half_norm(lane))),
    }
}

/// The nearest row of `target` `(M, dimension)` for each row of `source` `(N, dimension)`, and the
/// nearest row of `source` for each row of `target`. Both are empty if one of the arrays is empty.
pub(super) fn nearest_both(
    source: &[f32],
    target: &[f32],
    dimension: usize,
    counter: &Counter,
) -> Result<[Vec<NearestRow>; 2]> {
    if source.is_empty() || target.is_empty() {
        return Ok([Vec::new(), Vec::new()]);
    }
    let [source_norms, target_norms] = [source, target].map(|rows| squared_norms(rows, dimension));
    let count = target_norms.len();
    let half_target_norms: Vec<f32> = target_norms.iter().map(|norm| 0.5 * norm).collect();
    let tile = |(tile, rows): (usize, &[f32])| {
        counter.check()?;
        let in_tile = rows.len() / dimension;
        counter.add(in_tile);
        let mut products = vec![0.0; in_tile * count];
        let mut product = ArrayViewMut2::from_shape((in_tile, count), &mut products).expect("a row has all products");
        general_mat_mul(1.0, &matrix(rows, dimension), &matrix(target, dimension).t(), 0.0, &mut product);
        let mut column_best = vec![Lanes::NONE; count.div_ceil(LANES)];
        let row_best = (tile * ROWS_PER_TILE..).zip(products.chunks_exact(count)).map(|(row, products)| {
            let half_norm = 0.5 * source_norms[row];
            let mut best = Lanes::NONE;
            let blocks = products.chunks(LANES).zip(half_target_norms.chunks(LANES)).zip(&mut column_best);
            for (block, ((products, half_norms), column_best)) in blocks.enumerate() {
                best.insert(block as u32, scores(products, |lane| half_norms[lane]));
                column_best.insert(row as u32, scores(products, |_| half_norm));
            }
            best.best_of_all()
        });
        let row_best: Vec<BestTwo> = row_best.collect();
        Ok((row_best, column_best))
    };
    let (mut source_best, mut target_best) = (Vec::new(), vec![Lanes::NONE; count.div_ceil(LANES)]);
    let tiles: Vec<(usize, &[f32])> = source.chunks(ROWS_PER_TILE * dimension).enumerate().collect();
    // Only the results of one round are held in memory. They do not depend on the number of threads.
    for round in tiles.chunks(TILES_PER_ROUND) {
        for (rows, columns) in try_in_parallel(round.iter(), |&rows| tile(rows))? {
            source_best.extend(rows);
            target_best.iter_mut().zip(&columns).for_each(|(all, later)| all.merge(later));
        }
    }
    let target_best = (0..count).map(|column| target_best[column / LANES].at(column % LANES)).collect();
    let nearest =
        |best: Vec<BestTwo>, norms: &[f32]| best.iter().zip(norms).map(|(best, &norm)| best.nearest(norm)).collect();
    Ok([nearest(source_best, &source_norms), nearest(target_best, &target_norms)])
}

fn matrix(rows: &[f32], dimension: usize) -> ArrayView2<'_, f32> {
    ArrayView2::from_shape((rows.len() / dimension, dimension), rows).expect("the rows are whole")
}

fn squared_norms(rows: &[f32], dimension: usize) -> Vec<f32> {
    rows.chunks_exact(dimension).map(|row| row.iter().map(|v| v * v).sum()).collect()
}

#[cfg(test)]
mod tests {
    use chacha20::ChaCha8Rng;
    use rand::{RngExt, SeedableRng};

    use super::*;

    /// The plain loop: index of the nearest row, and the two least squared distances.
    fn plain(query: &[f32], rows: &[f32], dimension: usize) -> (usize, [f64; 2]) {
        let square = |(a, b): (&f32, &f32)| f64::from(a - b).powi(2);
        let distances = rows.chunks_exact(dimension).map(|row| row.iter().zip(query).map(square).sum::<f64>());
        let mut sorted: Vec<(f64, usize)> = distances.zip(0..).collect();
        sorted.sort_by(|a, b| a.partial_cmp(b).unwrap());
        (sorted[0].1, [sorted[0].0, sorted.get(1).map_or(f64::INFINITY, |second| second.0)])
    }

    #[test]
    fn rows_and_distances_are_those_of_the_plain_loop() {
        let mut rng = ChaCha8Rng::seed_from_u64(0);
        for (n, m, dimension) in [(1, 1, 1), (1, 5, 33), (64, 63, 33), (65, 130, 32), (2100, 3, 7)] {
            let mut rows = |count: usize| (0..count * dimension).map(|_| rng.random::<f32>()).collect::<Vec<f32>>();
            let (source, target) = (rows(n), rows(m));
            let [forth, back] = nearest_both(&source, &target, dimension, &Counter::default()).unwrap();
            assert_eq!((forth.len(), back.len()), (n, m));
            for (nearest, queries, rows) in [(forth, &source, &target), (back, &target, &source)] {
                for (nearest, query) in nearest.iter().zip(queries.chunks_exact(dimension)) {
                    let (row, [squared, second]) = plain(query, rows, dimension);
                    assert_eq!(nearest.row, row);
                    // The difference of products loses digits of distances below 1.
                    assert!((f64::from(nearest.squared) - squared).abs() < 1e-4);
                    assert!(second.is_infinite() || (f64::from(nearest.second_squared) - second).abs() < 1e-4);
                    assert!((0.0..=1.0).contains(&nearest.ratio()));
                }
            }
        }
        assert_eq!(nearest_both(&[], &[1.0], 1, &Counter::default()).unwrap(), [vec![], vec![]]);
    }

    #[test]
    fn the_first_of_equal_rows_counts() {
        // More than a tile of source rows, and lanes that are not all in use.
        let rows = vec![0.5; 3 * (2 * ROWS_PER_TILE + 5)];
        for side in nearest_both(&rows, &rows, 3, &Counter::default()).unwrap() {
            assert!(side.iter().all(|nearest| nearest.row == 0 && nearest.squared == nearest.second_squared));
        }
    }
}

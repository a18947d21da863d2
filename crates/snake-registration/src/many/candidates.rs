//! Pairs of clouds that are worth a registration, by the statistics of their descriptors.

use snake_core::{Control, Result};

use crate::steps::PreparedCloud;
use crate::steps::describe::{Rows, describe_cloud};
use snake_geometry::in_parallel;

/// Number of visual words: groups of similar descriptors. Set by hand.
const WORDS: usize = 64;
/// Number of descriptors of all clouds from which the words are made, at most. Set by hand.
const SAMPLES: usize = 16_000;
/// Number of rounds of k-means. Set by hand.
const WORD_ROUNDS: usize = 10;

/// The pairs `[source, target]` that are worth a registration, sorted, with source > target. Each
/// cloud is paired with the `count` clouds whose descriptors are most similar, and with the next
/// cloud, because scans are often in sequence. If there are few clouds, all pairs are taken.
pub(super) fn pairs(clouds: &[PreparedCloud], count: usize, control: &Control) -> Result<Vec<[usize; 2]>> {
    let all = (1..clouds.len()).flat_map(|source| (0..source).map(move |target| [source, target]));
    if clouds.len().saturating_sub(1) <= count {
        return Ok(all.collect());
    }
    let similarities = similarities(clouds, control)?;
    let mut chosen: Vec<[usize; 2]> = (1..clouds.len()).map(|source| [source, source - 1]).collect();
    for (cloud, row) in similarities.iter().enumerate() {
        let mut others: Vec<usize> = (0..clouds.len()).filter(|other| *other != cloud).collect();
        others.sort_by(|&a, &b| row[b].total_cmp(&row[a]).then(a.cmp(&b)));
        chosen.extend(others[..count].iter().map(|&other| [cloud.max(other), cloud.min(other)]));
    }
    chosen.sort_unstable();
    chosen.dedup();
    Ok(chosen)
}

/// The cosines between the clouds' VLAD vectors of residuals to the words (Jégou et al. 2010).
fn similarities(clouds: &[PreparedCloud], control: &Control) -> Result<Vec<Vec<f32>>> {
    let signed = clouds.iter().all(|cloud| cloud.viewpoint.is_some());
    let described: Vec<Rows> =
        clouds.iter().map(|cloud| describe_cloud(cloud, signed, control)).collect::<Result<_>>()?;
    let dimension = described[0].dimension();
    let rows: Vec<&[f32]> = described.iter().map(Rows::values).collect();
    let words = words(&rows, dimension, control)?;
    let vectors: Vec<Vec<f32>> = in_parallel(rows.iter(), |rows| aggregate(rows, &words, dimension));
    let product = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f32>();
    Ok(vectors.iter().map(|a| vectors.iter().map(|b| product(a, b)).collect()).collect())
}

fn nearest(row: &[f32], words: &[f32], dimension: usize) -> usize {
    let squared = |word: &[f32]| row.iter().zip(word).map(|(a, b)| (a - b) * (a - b)).sum::<f32>();
    let distances = words.chunks_exact(dimension).map(squared).enumerate();
    distances.min_by(|a, b| a.1.total_cmp(&b.1)).map_or(0, |(index, _)| index)
}

/// The cluster means of k-means on a sample of the descriptors, `(words, dimension)`.
fn words(rows: &[&[f32]], dimension: usize, control: &Control) -> Result<Vec<f32>> {
    let total: usize = rows.iter().map(|rows| rows.len() / dimension).sum();
    let all = rows.iter().flat_map(|rows| rows.chunks_exact(dimension));
    let sample: Vec<&[f32]> = all.step_by(total.div_ceil(SAMPLES).max(1)).collect();
    let first = sample.iter().step_by(sample.len().div_ceil(WORDS).max(1));
    let mut words: Vec<f32> = first.flat_map(|row| row.iter().copied()).collect();
    for _ in 0..WORD_ROUNDS {
        control.check()?;
        let members: Vec<usize> = in_parallel(sample.iter(), |row| nearest(row, &words, dimension));
        let mut sums = vec![0.0_f32; words.len()];
        let mut counts = vec![0_u32; words.len() / dimension];
        for (row, word) in sample.iter().zip(members) {
            counts[word] += 1;
            sums[word * dimension..][..dimension].iter_mut().zip(*row).for_each(|(sum, v)| *sum += v);
        }
        for ((word, sum), count) in words.chunks_exact_mut(dimension).zip(sums.chunks_exact(dimension)).zip(counts) {
            // A word without members stays.
            if count > 0 {
                word.iter_mut().zip(sum).for_each(|(word, sum)| *word = sum / count as f32);
            }
        }
    }
    Ok(words)
}

/// The VLAD vector: each word's sum of residuals is scaled to length 1, and then the whole vector.
fn aggregate(rows: &[f32], words: &[f32], dimension: usize) -> Vec<f32> {
    let mut sums = vec![0.0_f32; words.len()];
    for row in rows.chunks_exact(dimension) {
        let word = nearest(row, words, dimension) * dimension..;
        let word = word.start..word.start + dimension;
        let offsets = row.iter().zip(&words[word.clone()]).map(|(v, word)| v - word);
        sums[word].iter_mut().zip(offsets).for_each(|(sum, offset)| *sum += offset);
    }
    let normalize = |values: &mut [f32]| {
        let norm = values.iter().map(|v| v * v).sum::<f32>().sqrt();
        if norm > 0.0 {
            values.iter_mut().for_each(|v| *v /= norm);
        }
    };
    sums.chunks_exact_mut(dimension).for_each(normalize);
    normalize(&mut sums);
    sums
}

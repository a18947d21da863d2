//! The graph of compatible matches as rows of bits.

use std::cmp::Reverse;

use crate::steps::matches::{self, Criteria, Match};
use snake_core::{Counter, Result};
use snake_geometry::{in_parallel, try_in_parallel};

/// Two matches are incompatible if the cosine between their normals, or between a normal and the
/// connecting line, differs by this or more between the clouds. Half and twice change no outcome.
const COSINE_TOLERANCE: f32 = 0.3;
/// Two matches whose points are closer than this are incompatible, because they agree on any
/// transform. Unit: inlier distances. Set by hand.
const MIN_EDGE: f32 = 2.0;

/// The adjacency of the graph, a row of bits for each match.
pub(super) struct Graph {
    words: usize,
    bits: Vec<u64>,
}

type Vector32 = [f32; 3];

/// A match in `f32`: position and normal in the source, then in the target.
struct Match32([Vector32; 4]);

impl Graph {
    pub(super) fn new(matches: &[Match], criteria: &Criteria, counter: &Counter) -> Result<Self> {
        let words = matches.len().div_ceil(64);
        // Positions relative to the first match keep their precision in `f32`.
        let relative = |m: &Match| {
            let (source, target) = (m.source - matches[0].source, m.target - matches[0].target);
            Match32([source, m.source_normal, target, m.target_normal].map(|v| v.map(|v| v as f32).into()))
        };
        let single: Vec<Match32> = matches.iter().map(relative).collect();
        let row = |i: usize| {
            counter.check()?;
            counter.add(1);
            let mut row = vec![0_u64; words];
            for (j, other) in single.iter().enumerate() {
                row[j / 64] |= u64::from(compatible(&single[i], other, criteria)) << (j % 64);
            }
            Ok(row)
        };
        Ok(Self { words, bits: try_in_parallel(0..matches.len(), row)?.concat() })
    }

    fn row(&self, i: usize) -> &[u64] {
        &self.bits[i * self.words..][..self.words]
    }

    /// Neighbours of a match, each with the number of matches that are compatible with both.
    fn neighbors(&self, i: usize) -> impl Iterator<Item = (usize, u32)> {
        let row = self.row(i);
        set_bits(row).map(move |j| (j, row.iter().zip(self.row(j)).map(|(a, b)| (a & b).count_ones()).sum()))
    }

    /// At most `count` matches with the greatest sums of common neighbours, greatest first.
    pub(super) fn seeds(&self, count: usize) -> Vec<usize> {
        let sum = |i| self.neighbors(i).map(|(_, common)| u64::from(common)).sum::<u64>();
        let sums: Vec<u64> = in_parallel(0..self.bits.len() / self.words.max(1), sum);
        let mut seeds: Vec<usize> = (0..sums.len()).filter(|&i| sums[i] > 0).collect();
        seeds.sort_by_key(|&i| (Reverse(sums[i]), i));
        seeds.truncate(count);
        seeds
    }

    /// A match and at most `size` of its neighbours: those that have the most neighbours in common with it.
    pub(super) fn group(&self, seed: usize, size: usize) -> Vec<usize> {
        let mut group: Vec<(usize, u32)> = self.neighbors(seed).collect();
        group.sort_by_key(|&(i, common)| (Reverse(common), i));
        group.truncate(size);
        std::iter::once(seed).chain(group.into_iter().map(|(i, _)| i)).collect()
    }
}

fn set_bits(row: &[u64]) -> impl Iterator<Item = usize> {
    row.iter().enumerate().flat_map(|(word, &bits)| {
        let rest = std::iter::successors(Some(bits), |bits| Some(bits & bits.wrapping_sub(1)));
        rest.take_while(|bits| *bits != 0).map(move |bits| 64 * word + bits.trailing_zeros() as usize)
    })
}

fn subtract(a: &Vector32, b: &Vector32) -> Vector32 {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn dot(a: &Vector32, b: &Vector32) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn compatible(Match32(a): &Match32, Match32(b): &Match32, criteria: &Criteria) -> bool {
    let tolerance = criteria.inlier_distance as f32;
    let edges = [subtract(&b[0], &a[0]), subtract(&b[2], &a[2])];
    let [in_source, in_target] = edges.map(|edge| dot(&edge, &edge).sqrt());
    if (in_source - in_target).abs() >= tolerance || in_source.min(in_target) < MIN_EDGE * tolerance {
        return false;
    }
    if let Some(axis) = criteria.gravity {
        let axis = axis.map(|v| v as f32).into();
        let tilted = matches::MAX_TILT.to_radians().sin() as f32 * in_source;
        if (dot(&edges[0], &axis) - dot(&edges[1], &axis)).abs() >= tolerance + tilted {
            return false;
        }
    }
    let cosines = |a: &Vector32, b: &Vector32, edge: &Vector32, length: f32| {
        let cosines = [dot(a, b), dot(a, edge) / length, dot(b, edge) / length];
        if criteria.signed { cosines } else { cosines.map(f32::abs) }
    };
    let source_cosines = cosines(&a[1], &b[1], &edges[0], in_source);
    let target_cosines = cosines(&a[3], &b[3], &edges[1], in_target);
    source_cosines.iter().zip(target_cosines).all(|(s, t)| (s - t).abs() < COSINE_TOLERANCE)
}

//! A k-d tree that no arrangement of points makes slow.
//!
//! Trees that take the axes in turn waste their splits on axes along which points do not differ, and look at all of a
//! cloud's equal points for each query: on a line, on a plane of a drawing and where scans repeat points, n queries take
//! the square of n. Here each node halves the longest side of its points' box, and equal points are one leaf, however
//! many they are.

use std::num::NonZeroUsize;

use nalgebra::RealField;
use rayon::join;

use crate::{Error, Result};

/// Points that can be asked for their neighbours. Distances are squared.
pub(crate) struct KdTree<T> {
    /// Leaf by leaf.
    entries: Vec<Entry<T>>,
    root: Node<T>,
}

/// A point and its index.
type Entry<T> = ([T; 3], u32);

struct Node<T> {
    /// The box of its points.
    low: [T; 3],
    high: [T; 3],
    /// Its points among the entries.
    start: usize,
    end: usize,
    children: Option<Box<[Node<T>; 2]>>,
}

/// Points of a leaf that are not equal.
const LEAF: usize = 16;
/// Below as many points, threads cost more than they save.
const PARALLEL: usize = 1 << 14;

impl<T: RealField + Copy> KdTree<T> {
    /// Indexes finite points.
    pub(crate) fn new(points: &[[T; 3]]) -> Result<Self> {
        let count = u32::try_from(points.len())
            .map_err(|_| Error::Input { what: "points", reason: "more than 4294967295 cannot be indexed".into() })?;
        let mut entries: Vec<Entry<T>> = points.iter().copied().zip(0..count).collect();
        let root = Node::over(&mut entries, 0);
        Ok(Self { entries, root })
    }

    /// Hands over the index and distance of each point at most so far away, in no particular order.
    pub(crate) fn within(&self, query: &[T; 3], most: T, mut found: impl FnMut(usize, T)) {
        let mut open = vec![&self.root];
        while let Some(node) = open.pop() {
            if node.distance(query) > most {
                continue;
            }
            if let Some(children) = &node.children {
                open.extend(children.iter());
                continue;
            }
            for (point, index) in &self.entries[node.start..node.end] {
                let distance = squared_distance(query, point);
                if distance <= most {
                    found(*index as usize, distance);
                }
            }
        }
    }

    /// The nearest `number` points: indices and distances, nearest first, of equally near ones the lowest index first.
    pub(crate) fn nearest(&self, query: &[T; 3], number: NonZeroUsize) -> Vec<(usize, T)> {
        let number = number.get();
        let mut found: Vec<(usize, T)> = Vec::with_capacity(number.min(self.entries.len()) + 1);
        let mut open = vec![(self.root.distance(query), &self.root)];
        while let Some((distance, node)) = open.pop() {
            if found.len() == number && distance > found[number - 1].1 {
                continue;
            }
            if let Some(children) = &node.children {
                let [left, right] = children.each_ref().map(|child| (child.distance(query), child));
                let (near, far) = if right.0 < left.0 { (right, left) } else { (left, right) };
                open.extend([far, near]);
                continue;
            }
            // Of equal points the first ones are the lowest.
            let of_interest = if node.low == node.high { number } else { usize::MAX };
            for &(point, index) in self.entries[node.start..node.end].iter().take(of_interest) {
                let (index, distance) = (index as usize, squared_distance(query, &point));
                let before = |other: &(usize, T)| other.1 < distance || other.1 == distance && other.0 < index;
                let place = found.partition_point(before);
                if place < number {
                    found.insert(place, (index, distance));
                    found.truncate(number);
                }
            }
        }
        found
    }
}

impl<T: RealField + Copy> Node<T> {
    /// The node of the entries, of which the tree has `start` before them; puts them in the order of the leaves.
    fn over(entries: &mut [Entry<T>], start: usize) -> Self {
        let first = entries.first().map_or([T::zero(); 3], |entry| entry.0);
        let (mut low, mut high) = (first, first);
        for (point, _) in entries.iter() {
            for axis in 0..3 {
                low[axis] = low[axis].min(point[axis]);
                high[axis] = high[axis].max(point[axis]);
            }
        }
        let end = start + entries.len();
        let children = if low == high {
            entries.sort_unstable_by_key(|entry| entry.1);
            None
        } else if entries.len() <= LEAF {
            None
        } else {
            let side = |axis: usize| high[axis] - low[axis];
            let longest = (1..3).fold(0, |longest, axis| if side(axis) > side(longest) { axis } else { longest });
            let middle = entries.len() / 2;
            let order = |a: &Entry<T>, b: &Entry<T>| a.0[longest].partial_cmp(&b.0[longest]);
            entries.select_nth_unstable_by(middle, |a, b| order(a, b).unwrap_or(std::cmp::Ordering::Equal));
            let (left, right) = entries.split_at_mut(middle);
            let (mut left, mut right) = (|| Self::over(left, start), || Self::over(right, start + middle));
            let (left, right) = if end - start < PARALLEL { (left(), right()) } else { join(left, right) };
            Some(Box::new([left, right]))
        };
        Self { low, high, start, end, children }
    }

    /// To the box; never more than to a point in it, rounding included.
    fn distance(&self, query: &[T; 3]) -> T {
        let nearest = std::array::from_fn(|axis| query[axis].max(self.low[axis]).min(self.high[axis]));
        squared_distance(query, &nearest)
    }
}

fn squared_distance<T: RealField + Copy>(a: &[T; 3], b: &[T; 3]) -> T {
    let [x, y, z] = [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
    x * x + y * y + z * z
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Clouds that trees find hard, with ties and duplicates.
    fn clouds() -> Vec<Vec<[f64; 3]>> {
        let lattice = |i: u32, axis: u32| f64::from(i / 7_u32.pow(axis) % 7);
        let scattered = |i: u32, axis: usize| f64::from(i * [7919, 104_729, 1_299_709][axis] % 10_007);
        vec![
            (0..700).map(|i| std::array::from_fn(|axis| lattice(i, axis as u32))).collect(),
            (0..1000).map(|i| std::array::from_fn(|axis| scattered(i, axis))).collect(),
            (0..500).map(|i| [f64::from(i % 100), 0.0, 5.0]).collect(),
            (0..500).map(|i| if i % 3 == 0 { [1.0; 3] } else { [scattered(i, 0), 2.0, scattered(i, 2)] }).collect(),
            vec![[3.0, 4.0, 5.0]; 300],
            vec![[3.0, 4.0, 5.0]],
            vec![],
        ]
    }

    #[test]
    fn answers_equal_the_quadratic_loop() {
        for points in clouds() {
            let tree = KdTree::new(&points).unwrap();
            let queries = points.iter().step_by(37).copied().chain([[0.5, 1.5, 2.5], [-1e4, 0.0, 0.0]]);
            for query in queries {
                let mut sorted: Vec<(usize, f64)> =
                    points.iter().map(|point| squared_distance(&query, point)).enumerate().collect();
                sorted.sort_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)));
                for number in [1, 2, 25, 2000] {
                    let expected = &sorted[..number.min(points.len())];
                    assert_eq!(tree.nearest(&query, NonZeroUsize::new(number).unwrap()), expected);
                }
                for most in [0.0, 1.0, 9.0, 1e6] {
                    let mut found = Vec::new();
                    tree.within(&query, most, |index, distance| found.push((index, distance)));
                    found.sort_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)));
                    assert_eq!(found, &sorted[..sorted.partition_point(|entry| entry.1 <= most)]);
                }
            }
        }
    }

    #[test]
    fn few_leaves_are_opened_whatever_the_cloud() {
        const NUMBER: u32 = 40_000;
        let unit = |i: u32, factor: u32| f64::from(i.wrapping_mul(factor) >> 8) / f64::from(1_u32 << 24);
        let clouds: [fn(f64, f64) -> [f64; 3]; 4] = [
            |_, _| [1.0; 3],
            |u, _| [0.0, u, 0.0],
            |u, v| [u, v, 0.0],
            |u, v| if u < 0.5 { [0.0; 3] } else { [v, u, 1.0] },
        ];
        for cloud in clouds {
            let point = |i| cloud(unit(i, 2_654_435_761), unit(i, 0x9e37_79b1 ^ 0x0f0f_0f0f));
            let points: Vec<[f64; 3]> = (0..NUMBER).map(point).collect();
            let tree = KdTree::new(&points).unwrap();
            for query in points.iter().step_by(997) {
                let nearest = tree.nearest(query, NonZeroUsize::new(2).unwrap())[1].1;
                let mut opened = 0;
                let mut open = vec![&tree.root];
                while let Some(node) = open.pop().filter(|node| node.distance(query) <= nearest) {
                    opened += 1;
                    open.extend(node.children.iter().flat_map(|children| children.iter()));
                }
                assert!(opened < 200, "{opened} nodes");
            }
        }
    }
}

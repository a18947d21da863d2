//! A k-d tree for nearest points, built in parallel. `KdTree` also finds all points within a radius.

use std::ops::{Add, Mul, Sub};

use crate::{Error, Point, Result};

/// Parts of the tree up to this size are searched point by point.
const LEAF: usize = 12;

/// Parts of the tree below this size are built by one thread.
const PART: usize = 1 << 12;

/// A point of the tree. The middle point of a part splits it.
#[derive(Clone, Copy, Default)]
struct Node {
    point: Point,
    index: u32,
    /// The axis along which the part is split.
    axis: u32,
    /// The lowest index in the part.
    lowest: u32,
}

/// Finite points, sorted so that the middle point of each part splits it along its widest axis.
///
/// Searches are exact, and fast for every arrangement of points: equal points, and points on a line or plane.
pub struct PointTree(Vec<Node>);

/// The nearest point of a search: its squared distance and its index.
type Nearest<T> = (T, u32);

/// `f32` or `f64`: the type in which distances are computed.
pub trait Real: Copy + PartialOrd + From<f32> + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> {}
impl Real for f32 {}
impl Real for f64 {}

impl PointTree {
    /// Indexes finite points.
    ///
    /// # Errors
    /// [`Error::Input`] for more points than [`u32::MAX`].
    pub fn new(points: &[Point]) -> Result<Self> {
        let number = u32::try_from(points.len())
            .map_err(|_| Error::Input { what: "points", reason: format!("{} are too many", points.len()) })?;
        let node = |(index, &point): (u32, &Point)| Node { point, index, axis: 0, lowest: index };
        let mut nodes = (0..number).zip(points).map(node).collect::<Vec<_>>();
        split(&mut nodes);
        Ok(Self(nodes))
    }

    /// The squared distance and the index of the point nearest to a query; among equally near points, the lowest
    /// index. The point with the index `but` does not count. The distance is infinite if there is no other point.
    pub fn nearest<T: Real>(&self, query: &Point, but: Option<usize>) -> (T, usize) {
        let mut best = (T::from(f32::INFINITY), u32::MAX);
        search(&self.0, query, but, &mut best);
        (best.0, best.1 as usize)
    }

    /// The squared distance of each point to its nearest other point; infinite for a single point.
    ///
    /// Each search begins in the point's own part and continues beyond the splitting planes that are close enough.
    pub fn nearest_others(&self) -> Vec<f64> {
        let mut by_node = vec![f64::INFINITY; self.0.len()];
        nearest_others(&self.0, None, &mut by_node);
        let mut distances = vec![0.0; self.0.len()];
        self.0.iter().zip(by_node).for_each(|(node, distance)| distances[node.index as usize] = distance);
        distances
    }
}

/// Sorts a part and returns its lowest index.
fn split(nodes: &mut [Node]) -> u32 {
    if nodes.len() <= LEAF {
        return nodes.iter().map(|node| node.index).min().unwrap_or(u32::MAX);
    }
    let along = |axis: usize| nodes.iter().map(move |node| node.point[axis]);
    let extent =
        |axis: usize| along(axis).fold(f32::NEG_INFINITY, f32::max) - along(axis).fold(f32::INFINITY, f32::min);
    let extents = [extent(0), extent(1), extent(2)];
    let axis = (1..3).fold(0, |widest, axis| if extents[axis] > extents[widest] { axis } else { widest });
    let (before, middle, after) =
        nodes.select_nth_unstable_by(nodes.len() / 2, |a, b| a.point[axis].total_cmp(&b.point[axis]));
    let [first, last] = if before.len() < PART {
        [split(before), split(after)]
    } else {
        <[u32; 2]>::from(rayon::join(|| split(before), || split(after)))
    };
    middle.axis = axis as u32;
    middle.lowest = middle.index.min(first).min(last);
    middle.lowest
}

/// A list of the parts beyond the planes around a part, from the innermost plane outwards.
struct Beyond<'a> {
    middle: &'a Node,
    far: &'a [Node],
    further: Option<&'a Beyond<'a>>,
}

/// Writes the squared distance of each point of a part to its nearest other point of the tree.
fn nearest_others(nodes: &[Node], beyond: Option<&Beyond>, distances: &mut [f64]) {
    let nearest = |node: &Node| {
        let (but, mut best) = (Some(node.index as usize), (f64::INFINITY, u32::MAX));
        search(nodes, &node.point, but, &mut best);
        for Beyond { middle, far, .. } in std::iter::successors(beyond, |beyond| beyond.further) {
            let axis = middle.axis as usize;
            let offset = f64::from(node.point[axis]) - f64::from(middle.point[axis]);
            if offset * offset < best.0 {
                look(middle, &node.point, but, &mut best);
                search(far, &node.point, but, &mut best);
            }
        }
        best.0
    };
    if nodes.len() <= LEAF {
        nodes.iter().zip(distances).for_each(|(node, distance)| *distance = nearest(node));
        return;
    }
    let at = nodes.len() / 2;
    let (before, [middle, after @ ..]) = nodes.split_at(at) else { return };
    let (low, [own, high @ ..]) = distances.split_at_mut(at) else { return };
    *own = nearest(middle);
    let go = |part, far, distances| nearest_others(part, Some(&Beyond { middle, far, further: beyond }), distances);
    if nodes.len() < PART {
        go(before, after, low);
        go(after, before, high);
    } else {
        rayon::join(|| go(before, after, low), || go(after, before, high));
    }
}

fn search<T: Real>(nodes: &[Node], query: &Point, but: Option<usize>, best: &mut Nearest<T>) {
    if nodes.len() <= LEAF {
        nodes.iter().for_each(|node| look(node, query, but, best));
        return;
    }
    let (before, [middle, after @ ..]) = nodes.split_at(nodes.len() / 2) else { return };
    look(middle, query, but, best);
    let axis = middle.axis as usize;
    let offset = T::from(query[axis]) - T::from(middle.point[axis]);
    let (near, far) = if offset < T::from(0.0) { (before, after) } else { (after, before) };
    search(near, query, but, best);
    // Rounding is monotone, so no point beyond the plane is nearer than the plane, also after rounding.
    let distance = offset * offset;
    if distance < best.0 || distance == best.0 && lowest(far) < best.1 {
        search(far, query, but, best);
    }
}

/// The lowest index of a part, or 0 for a small part.
fn lowest(nodes: &[Node]) -> u32 {
    if nodes.len() <= LEAF { 0 } else { nodes[nodes.len() / 2].lowest }
}

fn look<T: Real>(node: &Node, query: &Point, but: Option<usize>, best: &mut Nearest<T>) {
    let [x, y, z] = std::array::from_fn(|axis| T::from(query[axis]) - T::from(node.point[axis]));
    let distance = x * x + y * y + z * z;
    if (distance < best.0 || distance == best.0 && node.index < best.1) && but != Some(node.index as usize) {
        *best = (distance, node.index);
    }
}

#[cfg(test)]
mod tests {
    use super::super::hard_clouds::{self, scattered};
    use super::*;

    fn plain<T: Real>(points: &[Point], query: &Point, but: Option<usize>) -> (T, usize) {
        let mut best = (T::from(f32::INFINITY), u32::MAX as usize);
        for (index, point) in points.iter().enumerate().filter(|(index, _)| Some(*index) != but) {
            let [x, y, z] = std::array::from_fn(|axis| T::from(query[axis]) - T::from(point[axis]));
            let distance = x * x + y * y + z * z;
            if distance < best.0 || distance == best.0 && index < best.1 {
                best = (distance, index);
            }
        }
        best
    }

    #[test]
    fn the_nearest_point_is_that_of_the_plain_loop() {
        let flat = (0..12_000).map(|i| [scattered(i, 0), scattered(i, 1) * 1e-3, 7.0]).collect();
        let extreme = [[3e38; 3], [-3e38; 3], [0.0; 3], [1e-40; 3]].repeat(9);
        for points in hard_clouds::small().into_iter().chain([flat, extreme]) {
            let tree = PointTree::new(&points).unwrap();
            let others = [[0.5, 1.5, 2.5], [-1e4, 0.0, 0.0], [3e38, 0.0, -3e38]];
            for query in points.iter().step_by(37).chain(&others) {
                for but in [None, points.iter().position(|point| point == query)] {
                    assert_eq!(tree.nearest::<f32>(query, but), plain::<f32>(&points, query, but), "{query:?}");
                    assert_eq!(tree.nearest::<f64>(query, but), plain::<f64>(&points, query, but), "{query:?}");
                }
            }
            let others = tree.nearest_others();
            assert_eq!(others.len(), points.len());
            for (index, &distance) in others.iter().enumerate().step_by(37) {
                assert_eq!(distance, plain::<f64>(&points, &points[index], Some(index)).0, "{index}");
            }
        }
    }

    // This test would take minutes instead of a second if each query visited all points.
    #[test]
    fn every_point_of_a_hard_cloud_finds_its_neighbour() {
        for points in hard_clouds::large() {
            let tree = PointTree::new(&points).unwrap();
            for (index, query) in points.iter().enumerate() {
                let (distance, nearest) = tree.nearest::<f32>(query, None);
                assert!(points[nearest] == *query && distance == 0.0 && nearest <= index);
                assert_ne!(tree.nearest::<f64>(query, Some(index)).1, index);
            }
        }
    }
}

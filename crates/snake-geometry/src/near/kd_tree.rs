//! A k-d tree whose queries stay fast for every arrangement of points.
//!
//! kiddo's queries take linear time if the points are equal, or lie on a line or plane along the axes, as in drawings
//! and in scans with repeated points. This tree therefore holds only the distinct points, rotated away from the axes.
//! Distances are computed again from the original points, so results are exact, and ties are broken by index.

use std::num::NonZeroUsize;

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use nalgebra::{RealField, Rotation3, Vector3};
use rayon::prelude::*;

use crate::{Error, Result};

/// An index of points for neighbour queries. All distances are squared.
pub struct KdTree<T> {
    /// The tree of the distinct points, rotated. `None` for a cloud without points.
    tree: Option<ImmutableKdTree<f64, 3>>,
    rotation: Rotation3<f64>,
    distinct: Vec<[T; 3]>,
    /// The largest absolute coordinate.
    extent: f64,
    /// For each distinct point, the start of its range in `indices`; the range ends at the next start.
    starts: Vec<u32>,
    /// The indices of equal points, ascending.
    indices: Vec<u32>,
}

impl<T: RealField + Copy + Into<f64>> KdTree<T> {
    /// Indexes finite points.
    pub fn new(points: &[[T; 3]]) -> Result<Self> {
        let failed = |reason: String| Error::Input { what: "points", reason: format!("cannot be indexed: {reason}") };
        let count = u32::try_from(points.len()).map_err(|_| failed("more than 4294967295".into()))?;
        let mut indices: Vec<u32> = (0..count).collect();
        let point = |index: u32| points[index as usize];
        indices.par_sort_unstable_by(|&a, &b| {
            let order = point(a).partial_cmp(&point(b)).unwrap_or(std::cmp::Ordering::Equal);
            order.then(a.cmp(&b))
        });
        let (mut distinct, mut starts): (Vec<[T; 3]>, Vec<u32>) = Default::default();
        for (place, &index) in (0..).zip(&indices) {
            if distinct.last() != Some(&point(index)) {
                distinct.push(point(index));
                starts.push(place);
            }
        }
        starts.push(count);
        let extent = distinct.as_flattened().iter().fold(0.0, |extent: f64, &v| extent.max(v.into().abs()));
        let rotation = Rotation3::from_euler_angles(0.7, 1.1, 0.4);
        let rotated: Vec<[f64; 3]> = distinct.iter().map(|point| rotate(&rotation, point)).collect();
        let tree = match rotated[..] {
            [] => None,
            _ => Some(ImmutableKdTree::new_from_slice(&rotated).map_err(|error| failed(error.to_string()))?),
        };
        Ok(Self { tree, rotation, distinct, extent, starts, indices })
    }

    /// Calls `visit` with the index and squared distance of each point at a squared distance of at most `most`, in no
    /// fixed order.
    pub fn within(&self, query: &[T; 3], most: T, mut visit: impl FnMut(usize, T)) {
        let Some(tree) = &self.tree else { return };
        let radius = self.reach(query, most.into().sqrt());
        let rotated = rotate(&self.rotation, query);
        tree.query(&rotated).within::<SquaredEuclidean<f64>>(radius * radius).unsorted().visit(|entry| {
            let distance = squared_distance(query, &self.distinct[entry.item as usize]);
            if distance <= most {
                self.equal(entry.item as usize).for_each(|index| visit(index, distance));
            }
        });
    }

    /// The nearest `number` points as indices and squared distances, nearest first; ties are ordered by index.
    pub fn nearest(&self, query: &[T; 3], number: NonZeroUsize) -> Vec<(usize, T)> {
        let near = self.near(query, number);
        let mut entries: Vec<(usize, T)> = Vec::with_capacity(number.get().min(self.indices.len()));
        for (distinct, distance) in near {
            entries.extend(self.equal(distinct).take(number.get()).map(|index| (index, distance)));
        }
        let order = |a: &(usize, T), b: &(usize, T)| a.1.partial_cmp(&b.1).unwrap_or(std::cmp::Ordering::Equal);
        entries.sort_unstable_by(|a, b| order(a, b).then(a.0.cmp(&b.0)));
        entries.truncate(number.get());
        entries
    }

    /// The distinct points, in ascending order.
    pub fn distinct(&self) -> &[[T; 3]] {
        &self.distinct
    }

    /// The squared distance to the nearest point that is not equal to the query.
    pub fn nearest_other(&self, query: &[T; 3]) -> Option<T> {
        const TWO: NonZeroUsize = NonZeroUsize::MIN.saturating_add(1);
        let others = self.near(query, TWO).into_iter().filter(|&(distinct, _)| self.distinct[distinct] != *query);
        others.map(|(_, distance)| distance).reduce(|a, b| if b < a { b } else { a })
    }

    /// At least the nearest `number` distinct points, and their squared distances.
    fn near(&self, query: &[T; 3], number: NonZeroUsize) -> Vec<(usize, T)> {
        let Some(tree) = &self.tree else { return Vec::new() };
        let rotated = rotate(&self.rotation, query);
        // The search allocates memory for all points that it is asked for.
        let number = number.min(NonZeroUsize::new(self.distinct.len()).unwrap_or(number));
        let first = tree.query(&rotated).nearest_n::<SquaredEuclidean<f64>>(number).execute();
        // Rotated points are rounded, so nearer points may come after the last of these.
        let radius = self.reach(query, first.iter().fold(0.0, |most: f64, entry| most.max(entry.distance)).sqrt());
        let near = tree.query(&rotated).within::<SquaredEuclidean<f64>>(radius * radius).unsorted().execute();
        let distance = |distinct: usize| (distinct, squared_distance(query, &self.distinct[distinct]));
        near.into_iter().map(|entry| distance(entry.item as usize)).collect()
    }

    /// The indices of the points that equal one distinct point.
    fn equal(&self, distinct: usize) -> impl Iterator<Item = usize> {
        let [start, end] = [0, 1].map(|next| self.starts[distinct + next] as usize);
        self.indices[start..end].iter().map(|&index| index as usize)
    }

    /// Enlarges a radius by the rounding errors of rotated points and of distances in `f32`.
    fn reach(&self, query: &[T; 3], radius: f64) -> f64 {
        let extent = query.iter().fold(self.extent, |extent, &v| extent.max(v.into().abs()));
        radius * (1.0 + 1e-6) + 1e-14 * extent
    }
}

fn rotate<T: Copy + Into<f64>>(rotation: &Rotation3<f64>, point: &[T; 3]) -> [f64; 3] {
    (rotation * Vector3::from(point.map(Into::into))).into()
}

fn squared_distance<T: RealField + Copy>(a: &[T; 3], b: &[T; 3]) -> T {
    let [x, y, z] = [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
    x * x + y * y + z * z
}

#[cfg(test)]
mod tests {
    use super::super::hard_clouds;
    use super::*;

    #[test]
    fn answers_equal_the_quadratic_loop() {
        for points in hard_clouds::small() {
            let points: Vec<[f64; 3]> = points.iter().map(|point| point.map(f64::from)).collect();
            let tree = KdTree::new(&points).unwrap();
            let queries = points.iter().step_by(37).copied().chain([[0.5, 1.5, 2.5], [-1e4, 0.0, 0.0]]);
            for query in queries {
                let mut sorted: Vec<(usize, f64)> =
                    points.iter().map(|point| squared_distance(&query, point)).enumerate().collect();
                sorted.sort_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)));
                for number in [1, 2, 25, 2000, usize::MAX] {
                    let expected = &sorted[..number.min(points.len())];
                    assert_eq!(tree.nearest(&query, NonZeroUsize::new(number).unwrap()), expected);
                }
                for most in [0.0, 1.0, 9.0, 1e6] {
                    let mut entries = Vec::new();
                    tree.within(&query, most, |index, distance| entries.push((index, distance)));
                    entries.sort_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)));
                    assert_eq!(entries, &sorted[..sorted.partition_point(|entry| entry.1 <= most)]);
                }
            }
        }
    }

    // This test would take minutes instead of a second if each query visited all points.
    #[test]
    fn every_point_of_a_hard_cloud_finds_its_neighbours() {
        for points in hard_clouds::large() {
            let points: Vec<[f64; 3]> = points.iter().map(|point| point.map(f64::from)).collect();
            let tree = KdTree::new(&points).unwrap();
            for query in &points {
                let (index, distance) = tree.nearest(query, NonZeroUsize::MIN)[0];
                assert!(points[index] == *query && distance == 0.0);
            }
        }
    }
}

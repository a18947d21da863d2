//! The outer surface: the parts that can be reached from the border of the grid through empty samples.

use super::marching_cubes::{Surface, vertex};
use super::samples::Samples;

impl Surface {
    /// Keeps the parts of the surface whose empty side is connected to the border. Removes cavities and their contents.
    ///
    /// Each part is a closed surface with one connected set of empty samples on one side. If the set is outside, start
    /// at the part's last crossing along x and follow empty samples along x. They end at the border, or at another part
    /// next to the same set that reaches farther along x.
    pub(super) fn retain_outer(&mut self, samples: &Samples) {
        let part = self.parts();
        // The last crossed edge of each part along x. Edges are not ordered by x.
        let mut last: Vec<Option<(usize, u32)>> = vec![None; part.len()];
        for (crossing, &part) in self.crossings.iter().zip(&part) {
            if let (low, 0) = samples.ends(crossing.edge) {
                last[part] = last[part].max(Some((low[0], crossing.edge)));
            }
        }
        let mut parts: Vec<usize> = (0..part.len()).filter(|&part| last[part].is_some()).collect();
        parts.sort_by_key(|&part| std::cmp::Reverse(last[part]));
        let mut outer = vec![false; part.len()];
        for number in parts {
            let Some((_, edge)) = last[number] else { continue };
            let ([x, y, z], _) = samples.ends(edge);
            if samples.occupied([x, y, z]) {
                let next = (x + 1..samples.resolution).find(|&x| samples.occupied([x, y, z]));
                outer[number] = next.is_none_or(|x| {
                    let beside = vertex(&self.crossings, samples.edge([x - 1, y, z], 0));
                    outer[part[beside as usize]]
                });
            }
        }
        self.retain(|vertex| outer[part[vertex as usize]]);
    }

    /// For each vertex, the first vertex of its connected part.
    fn parts(&self) -> Vec<usize> {
        fn first(of: &mut [usize], mut vertex: usize) -> usize {
            while of[vertex] != vertex {
                of[vertex] = of[of[vertex]];
                vertex = of[vertex];
            }
            vertex
        }
        let mut of: Vec<usize> = (0..self.crossings.len()).collect();
        for [a, b, c] in self.triangles.iter().map(|triangle| triangle.map(|vertex| vertex as usize)) {
            for other in [b, c] {
                let (one, other) = (first(&mut of, a), first(&mut of, other));
                of[one.max(other)] = one.min(other);
            }
        }
        (0..of.len()).map(|vertex| first(&mut of, vertex)).collect()
    }

    /// Keeps the triangles of the selected parts.
    fn retain(&mut self, keep: impl Fn(u32) -> bool) {
        let mut number = 0;
        let renumbered: Vec<u32> = (0..self.crossings.len() as u32)
            .map(|vertex| {
                let new = number;
                number += u32::from(keep(vertex));
                new
            })
            .collect();
        self.triangles.retain(|triangle| keep(triangle[0]));
        self.triangles.iter_mut().flatten().for_each(|vertex| *vertex = renumbered[*vertex as usize]);
        let mut vertex = 0..;
        self.crossings.retain(|_| vertex.next().is_some_and(&keep));
    }
}

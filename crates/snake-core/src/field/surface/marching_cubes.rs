//! Marching cubes: converts samples to triangles with shared vertices.

use super::cube;
use super::samples::{Sample, Samples};
use snake_geometry::in_parallel;

/// A vertex: the point where the surface crosses an edge of the grid.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Crossing {
    /// The edge's number, see [`Samples::edge`].
    pub(super) edge: u32,
    /// The position along the edge from its low end, 0 to 1.
    pub(super) fraction: f32,
}

/// Triangles as indices of crossings, counterclockwise seen from the empty side.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Surface {
    /// The crossings, ordered by edge.
    pub(super) crossings: Vec<Crossing>,
    pub(super) triangles: Vec<[u32; 3]>,
}

impl Surface {
    /// The closed surface between occupied and empty samples. Each edge belongs to two triangles.
    pub(super) fn of(samples: &Samples) -> Self {
        let known = samples.known();
        let crossings: Vec<Crossing> = in_parallel(known.iter(), |&block| crossings(samples, block)).concat();
        let case_triangles = cube::triangles();
        let triangles = in_parallel(known.iter(), |&block| {
            let cells = samples.block_samples(block).flat_map(|low| {
                case_triangles[case(samples, low)]
                    .iter()
                    .map(move |triangle| triangle.map(|(corner, axis)| samples.edge(place(low, corner), axis)))
            });
            cells.map(|edges| edges.map(|edge| vertex(&crossings, edge))).collect::<Vec<_>>()
        });
        Self { crossings, triangles: triangles.concat() }
    }
}

/// The index of the crossing on a crossed edge.
pub(super) fn vertex(crossings: &[Crossing], edge: u32) -> u32 {
    crossings.partition_point(|crossing| crossing.edge < edge) as u32
}

/// The crossings of the edges that begin in a block, in the order of the edges.
fn crossings(samples: &Samples, block: usize) -> Vec<Crossing> {
    let mut crossings = Vec::new();
    for low in samples.block_samples(block) {
        let value = samples.value(low);
        for axis in 0..3 {
            let high = samples.value(place(low, 1 << axis));
            if (value > samples.level) != (high > samples.level) {
                let fraction = (samples.level - value) / (high - value);
                crossings.push(Crossing { edge: samples.edge(low, axis), fraction });
            }
        }
    }
    crossings
}

/// The case of the cell whose lowest corner is a sample: the bits of its occupied corners.
fn case(samples: &Samples, low: Sample) -> usize {
    (0..8).map(|corner| usize::from(samples.occupied(place(low, corner))) << corner).sum()
}

/// The sample at a corner of a cell.
fn place(low: Sample, corner: usize) -> Sample {
    std::array::from_fn(|axis| low[axis] + (corner >> axis & 1))
}

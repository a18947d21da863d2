//! The starting queries of a detection, and their refined positions.

use super::cube::VolumeFrame;
use super::query_grid::QueryGrid;
use crate::Result;
use crate::options::DetectOptions;
use snake_geometry::Point;
use snake_geometry::rotations::Rotation;

/// A query after refinement.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Refined {
    /// In the network's frame.
    pub(crate) position: Point,
    /// Saliency. It is 0 unless saliency and occupancy are above their thresholds.
    pub(crate) score: f32,
}

/// Minimum number of queries in a batch of a grid, enough for many threads.
const MIN_BATCH: usize = 16_384;

/// Starting queries in the network's frame.
#[derive(Debug)]
pub(crate) struct Queries(Kind);

#[derive(Debug)]
enum Kind {
    Grid(QueryGrid),
    Cells(Vec<Point>),
}

impl Queries {
    /// The grid over ±0.5 along x and y, and over the volume's bounds along z.
    pub(super) fn grid(
        frame: &VolumeFrame,
        points: impl Iterator<Item = Point>,
        orientation: &Rotation,
        options: &DetectOptions,
    ) -> Self {
        Self(Kind::Grid(QueryGrid::new(frame, points, orientation, options)))
    }

    /// One query per cell.
    pub(crate) fn cells(means: impl ExactSizeIterator<Item = Point>) -> Self {
        Self(Kind::Cells(means.collect()))
    }

    /// The number of queries, including those that are dropped without evaluation.
    pub(crate) fn len(&self) -> usize {
        match &self.0 {
            Kind::Grid(grid) => grid.resolution().pow(3),
            Kind::Cells(cells) => cells.len(),
        }
    }

    /// Calls `batch` with the queries of each batch and with their number before any were dropped. To save memory, a
    /// batch of a grid has only a few of its planes. Queries vary slowest along x and fastest along z.
    pub(crate) fn for_each_batch(&self, mut batch: impl FnMut(&[Point], usize) -> Result<()>) -> Result<()> {
        match &self.0 {
            Kind::Cells(cells) => batch(cells, cells.len()),
            Kind::Grid(grid) => {
                let resolution = grid.resolution();
                let plane = resolution * resolution;
                let mut queries = Vec::with_capacity(MIN_BATCH + plane);
                let mut first = 0;
                for x in 0..resolution {
                    grid.append_plane(x, &mut queries);
                    if queries.len() >= MIN_BATCH || x + 1 == resolution {
                        batch(&queries, (x + 1 - first) * plane)?;
                        queries.clear();
                        first = x + 1;
                    }
                }
                Ok(())
            }
        }
    }
}

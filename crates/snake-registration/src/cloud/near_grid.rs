//! Search for the nearest point within a fixed distance, on a grid of cells.

use snake_geometry::Vector;

/// Maximum number of cells per point; a cloud of greater extent gets larger cells.
const MAX_CELLS_PER_POINT: f64 = 256.0;

/// Points sorted into cells that are at least as wide as the search distance, so that a query reads 27 cells.
pub(crate) struct NearGrid {
    corner: Vector,
    cell: f64,
    distance: f64,
    sides: [usize; 3],
    /// The first position in `order` of each cell, x fastest, and the end.
    starts: Vec<u32>,
    /// The points ordered by cell, each with its index.
    order: Vec<(Vector, u32)>,
}

impl NearGrid {
    /// Sorts finite points, at least one; queries find points closer than `distance`.
    pub(crate) fn new(points: &[Vector], distance: f64) -> Self {
        let corner = points.iter().copied().reduce(|a, b| a.inf(&b)).unwrap_or_default();
        let extent = points.iter().copied().reduce(|a, b| a.sup(&b)).unwrap_or_default() - corner;
        let sides_at = |cell: f64| extent.map(|v| (v / cell).floor() + 1.0);
        let mut cell = distance;
        while sides_at(cell).product() > MAX_CELLS_PER_POINT * points.len() as f64 + 1000.0 {
            cell *= 1.5;
        }
        let sides = <[f64; 3]>::from(sides_at(cell)).map(|side| side as usize);
        let mut grid = Self { corner, cell, distance, sides, starts: Vec::new(), order: Vec::new() };
        grid.sort(points);
        grid
    }

    fn sort(&mut self, points: &[Vector]) {
        let cells: Vec<usize> =
            points.iter().map(|point| self.index(self.cell_of(point).map(|v| v as usize))).collect();
        let mut starts = vec![0_u32; self.sides.iter().product::<usize>() + 1];
        cells.iter().for_each(|&cell| starts[cell + 1] += 1);
        (1..starts.len()).for_each(|i| starts[i] += starts[i - 1]);
        let mut next = starts.clone();
        self.order = vec![(Vector::zeros(), 0); points.len()];
        for (index, (point, &cell)) in points.iter().zip(&cells).enumerate() {
            self.order[next[cell] as usize] = (*point, index as u32);
            next[cell] += 1;
        }
        self.starts = starts;
    }

    fn cell_of(&self, point: &Vector) -> [f64; 3] {
        ((point - self.corner) / self.cell).map(f64::floor).into()
    }

    fn index(&self, [x, y, z]: [usize; 3]) -> usize {
        (z * self.sides[1] + y) * self.sides[0] + x
    }

    /// The search distance.
    pub(crate) fn distance(&self) -> f64 {
        self.distance
    }

    /// Visits the points in the query's cell and the cells around it, row by row: all points closer
    /// than the grid's distance, and some others.
    fn for_rows_near<'a>(&'a self, query: &Vector, mut visit: impl FnMut(&'a [(Vector, u32)])) {
        let [x, y, z] = self.cell_of(query);
        let [xs, ys, zs] = [(x, 0), (y, 1), (z, 2)].map(|(v, axis)| {
            let (first, end) = ((v - 1.0).max(0.0), (v + 2.0).min(self.sides[axis] as f64));
            // Casts saturate: the range is empty for a query before the first cell.
            first as usize..end as usize
        });
        if xs.is_empty() {
            return;
        }
        for z in zs {
            for y in ys.clone() {
                let row = self.index([0, y, z]);
                visit(&self.order[self.starts[row + xs.start] as usize..self.starts[row + xs.end] as usize]);
            }
        }
    }

    /// Index and squared distance of the nearest point closer than the grid's distance. If several
    /// are equally near, the lowest index wins.
    pub(crate) fn nearest(&self, query: &Vector) -> Option<(usize, f64)> {
        let limit = self.distance * self.distance;
        let mut best = (u32::MAX, limit);
        self.for_rows_near(query, |row| {
            for (point, index) in row {
                let squared = (point - query).norm_squared();
                if squared < best.1 || squared == best.1 && *index < best.0 && squared < limit {
                    best = (*index, squared);
                }
            }
        });
        (best.1 < limit).then_some((best.0 as usize, best.1))
    }

    /// Calls `visit` with the index, offset and squared distance of each point closer than the grid's distance.
    pub(crate) fn within(&self, query: &Vector, mut visit: impl FnMut(usize, Vector, f64)) {
        self.for_rows_near(query, |row| {
            for (point, index) in row {
                let offset = point - query;
                let squared = offset.norm_squared();
                if squared < self.distance * self.distance {
                    visit(*index as usize, offset, squared);
                }
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use chacha20::ChaCha8Rng;
    use rand::SeedableRng;
    use snake_geometry::{Neighbors, vector};

    use super::*;
    use crate::rigid::tests::random_points;

    #[test]
    fn answers_are_those_of_the_tree() {
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let mut points: Vec<Vector> = random_points(&mut rng, 500).into_iter().map(vector).collect();
        points.extend_from_within(..20);
        points.push(Vector::new(1e5, -3e4, 0.0)); // an outlier makes the cells larger
        let queries: Vec<Vector> = random_points(&mut rng, 300).into_iter().map(|p| 1.3 * vector(p)).collect();
        let tree = Neighbors::new(points.clone()).unwrap();
        for (points, tree) in [(&points[..520], Neighbors::new(points[..520].to_vec()).unwrap()), (&points[..], tree)] {
            let grid = NearGrid::new(points, 0.3);
            for query in queries.iter().chain(points).chain([&Vector::repeat(-1e9), &Vector::repeat(1e9)]) {
                let (index, distance) = tree.nearest(query, std::num::NonZeroUsize::MIN)[0];
                let nearest = grid.nearest(query);
                assert_eq!(nearest.map(|(index, _)| index), (distance < 0.3).then_some(index), "{query}");
                let mut within = Vec::new();
                grid.within(query, |index, offset, squared| {
                    assert!(offset == points[index] - query && squared == offset.norm_squared());
                    within.push(index);
                });
                within.sort_unstable();
                assert_eq!(within, tree.within(query, 0.3));
            }
        }
    }
}

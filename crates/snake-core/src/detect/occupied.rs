//! The first step of Algorithm 1: the starting queries that lie on the surface.

use crate::Result;
use crate::control::{Control, Counter};
use crate::field::{Field, Quantity};
use crate::lattice::Queries;
use crate::network::layers::TILE;
use snake_geometry::{Point, try_chunks_in_parallel};

/// Queries in the network's frame, with their occupancy.
#[derive(Debug, Default, PartialEq)]
pub(crate) struct Occupied {
    pub(crate) positions: Vec<Point>,
    /// Empty if the threshold is 0: occupancy is then not evaluated.
    pub(crate) occupancy: Vec<f32>,
}

#[cfg(test)]
impl Occupied {
    /// Queries of unknown occupancy.
    pub(crate) fn of(positions: &[Point]) -> Self {
        Self { positions: positions.to_vec(), occupancy: Vec::new() }
    }
}

/// The queries whose occupancy is above the threshold, in their order.
pub(crate) fn above_occupancy(field: &Field, queries: &Queries, threshold: f32, control: &Control) -> Result<Occupied> {
    let counter = control.begin("occupancy", queries.len());
    let mut occupied = Occupied::default();
    queries.for_each_batch(|batch, number| {
        counter.add(number - batch.len());
        append_occupied(field, batch, threshold, &counter, &mut occupied)
    })?;
    Ok(occupied)
}

/// Appends the queries whose occupancy is above the threshold.
fn append_occupied(
    field: &Field,
    queries: &[Point],
    threshold: f32,
    counter: &Counter,
    occupied: &mut Occupied,
) -> Result<()> {
    if threshold <= 0.0 {
        counter.add(queries.len());
        occupied.positions.extend_from_slice(queries);
        return counter.check();
    }
    let mut occupancy = vec![0.0; queries.len()];
    try_chunks_in_parallel(&mut occupancy, TILE, &|tile, occupancy| {
        let tile = &queries[tile * TILE..][..occupancy.len()];
        counter.check()?;
        occupancy.copy_from_slice(&field.tile_values(Quantity::Occupancy, tile));
        counter.add(tile.len());
        Result::Ok(())
    })?;
    let pairs = queries.iter().zip(occupancy.iter());
    occupied.positions.extend(pairs.filter(|(_, value)| **value > threshold).map(|(query, _)| *query));
    occupied.occupancy.extend(occupancy.iter().copied().filter(|value| *value > threshold));
    Ok(())
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::DetectOptions;
    use crate::detect::tests::cylinder;

    pub(crate) fn occupied_queries(field: &Field, options: &DetectOptions) -> Vec<Point> {
        above_occupancy(field, &field.queries(options), options.occupancy_threshold, &Control::default())
            .unwrap()
            .positions
    }

    #[test]
    fn the_band_drops_only_queries_far_from_all_points() {
        let (points, field) = cylinder();
        let all = occupied_queries(&field, &DetectOptions::default());
        let frame = field.volume().frame().unwrap();
        let voxel = |point: Point| {
            let flat = frame.voxel(point);
            [flat % 32, flat / 32 % 32, flat / 1024]
        };
        let occupied: Vec<_> = points.iter().map(|&p| voxel(field.normalization().to_network(p))).collect();
        for reach in [1, 2] {
            let near = |query: &&Point| {
                let place = voxel(**query);
                occupied.iter().any(|other| (0..3).all(|axis| place[axis].abs_diff(other[axis]) <= reach))
            };
            let expected: Vec<Point> = all.iter().filter(near).copied().collect();
            let options = DetectOptions { query_band: reach, ..Default::default() };
            assert_eq!(occupied_queries(&field, &options), expected);
        }
        assert!(!all.is_empty());
    }
}

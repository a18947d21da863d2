//! The starting queries: the occupied part of a regular grid over the network's cube.

use rayon::prelude::*;

use crate::Result;
use crate::call::control::{Control, Counter};
use crate::call::span::span;
use crate::detect::options::DetectOptions;
use crate::field::{Field, Quantity};
use crate::network::layers::TILE;
use crate::network::volume::VolumeFrame;
use snake_geometry::{
    Point,
    rotations::{Rotation, rotate, rotate_inverse},
};
use snake_kernels::Scratch;

/// The query grid of a detection, in the orientation of the field's volume. A few planes at a time are
/// generated, to save memory.
pub(crate) struct QueryGrid {
    /// The coordinates of the queries along each axis, each with its part of the flat voxel index.
    axes: [Scratch<(f32, usize)>; 3],
    /// Whether the queries of each voxel are evaluated; `None`: all are.
    band: Option<Scratch<bool>>,
    orientation: Rotation,
}

impl QueryGrid {
    /// The grid over the cube ±0.5, or over the volume's bounds along z.
    pub(crate) fn new(field: &Field, frame: &VolumeFrame, options: &DetectOptions) -> Self {
        let resolution = options.query_resolution;
        let [z_min, z_max] = frame.z_bounds;
        let axes = std::array::from_fn(|axis| {
            let [low, high] = if axis < 2 { [-0.5, 0.5] } else { [z_min, z_max] };
            let coordinates = (0..resolution).map(|i| coordinate(low, high, resolution, i));
            let voxels = coordinates.map(|coordinate| (coordinate, frame.voxel_along(axis, coordinate)));
            Scratch::collect(resolution, voxels)
        });
        let band = (options.query_band > 0).then(|| voxels_near_points(field, frame, options.query_band));
        Self { axes, band, orientation: *field.orientation() }
    }

    fn resolution(&self) -> usize {
        self.axes[0].len()
    }

    /// Appends the queries of one plane of the grid across x, z fastest, in the network's frame.
    fn append_plane(&self, x: usize, queries: &mut Scratch<Point>) {
        let (x, voxel_x) = self.axes[0][x];
        for &(y, voxel_y) in &self.axes[1][..] {
            let is_near = |voxel_z: usize| self.band.as_ref().is_none_or(|band| band[voxel_x + voxel_y + voxel_z]);
            let near = self.axes[2].iter().filter(|(_, voxel_z)| is_near(*voxel_z));
            queries.extend(near.map(|&(z, _)| rotate_inverse(&self.orientation, [x, y, z])));
        }
    }
}

/// Coordinate `i` of `resolution` coordinates from `low` to `high`. It is computed from the nearer end, as in
/// torch.linspace, so the grid is exactly symmetric.
fn coordinate(low: f32, high: f32, resolution: usize, i: usize) -> f32 {
    let step = (high - low) / resolution.saturating_sub(1).max(1) as f32;
    if i < resolution / 2 || resolution == 1 {
        low + step * i as f32
    } else {
        high - step * (resolution - 1 - i) as f32
    }
}

/// Queries that are evaluated at a time, at least: enough for many threads.
const BATCH: usize = 16_384;

/// Queries in the network's frame, with the occupancy that they were chosen by.
#[derive(Debug, Default, PartialEq)]
pub(crate) struct Occupied {
    pub(crate) positions: Scratch<Point>,
    /// Empty without a threshold: it is then evaluated nowhere.
    pub(crate) occupancy: Scratch<f32>,
}

#[cfg(test)]
impl Occupied {
    /// Queries of unknown occupancy.
    pub(crate) fn of(positions: &[Point]) -> Self {
        Self { positions: Scratch::copy_of(positions), occupancy: Scratch::default() }
    }
}

/// The queries whose occupancy is above the threshold, x slowest and z fastest.
pub(crate) fn above_occupancy(
    field: &Field,
    queries: &QueryGrid,
    threshold: f32,
    control: &Control,
) -> Result<Occupied> {
    span!("occupancy");
    let resolution = queries.resolution();
    let counter = control.begin("occupancy", resolution.pow(3));
    let mut occupied = Occupied { positions: Scratch::empty(BATCH), occupancy: Scratch::empty(BATCH) };
    let mut batch = Scratch::empty(BATCH + resolution * resolution);
    let mut first = 0;
    for x in 0..resolution {
        queries.append_plane(x, &mut batch);
        if batch.len() < BATCH && x + 1 < resolution {
            continue;
        }
        counter.add((x + 1 - first) * resolution * resolution - batch.len());
        append_occupied(field, &batch, threshold, &counter, &mut occupied)?;
        batch.clear();
        first = x + 1;
    }
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
    let mut occupancy = Scratch::zeros(queries.len());
    occupancy.par_chunks_mut(TILE).zip(queries.par_chunks(TILE)).try_for_each(|(occupancy, tile)| {
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

/// The queries of a list whose occupancy is above the threshold.
pub(crate) fn above_occupancy_of(
    field: &Field,
    queries: &[Point],
    threshold: f32,
    control: &Control,
) -> Result<Occupied> {
    span!("occupancy");
    let counter = control.begin("occupancy", queries.len());
    let mut occupied = Occupied { positions: Scratch::empty(queries.len()), occupancy: Scratch::empty(queries.len()) };
    append_occupied(field, queries, threshold, &counter, &mut occupied)?;
    Ok(occupied)
}

/// Whether each voxel has a voxel with input points within `reach` voxels along every axis.
fn voxels_near_points(field: &Field, frame: &VolumeFrame, reach: usize) -> Scratch<bool> {
    let mut near = Scratch::zeros(frame.resolution.iter().product());
    for &point in field.points() {
        near[frame.voxel(rotate(field.orientation(), field.normalization().to_network(point)))] = true;
    }
    let (mut before, mut stride) = (near.clone(), 1);
    for length in frame.resolution {
        before.copy_from_slice(&near);
        for (voxel, near) in near.iter_mut().enumerate() {
            let place = voxel / stride % length;
            let line = voxel - place * stride;
            *near = (place.saturating_sub(reach)..=(place + reach).min(length - 1)).any(|i| before[line + i * stride]);
        }
        stride *= length;
    }
    near
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::detect::tests::cylinder;

    pub(crate) fn occupied_queries(field: &Field, options: &DetectOptions) -> Vec<Point> {
        let queries = QueryGrid::new(field, &field.volume().frame().unwrap(), options);
        above_occupancy(field, &queries, options.occupancy_threshold, &Control::default()).unwrap().positions.to_vec()
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

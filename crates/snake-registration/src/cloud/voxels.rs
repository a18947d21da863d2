//! Clouds downsampled to one point per voxel.

use std::collections::HashMap;

use snake_core::{Control, Counter, Result};
use snake_geometry::{Neighbors, Point, Vector, vector};

/// Downsamples finite points to the means of voxels, and indexes these for neighbour queries.
pub(crate) fn downsample(points: &[Point], voxel_size: f64, control: &Control) -> Result<Neighbors> {
    let counter = control.begin("voxels", points.len());
    Neighbors::new(voxel_means(points, voxel_size, &counter)?)
}

/// The mean of the points in each voxel of side `voxel_size`, in the order of the voxels' first
/// points.
pub(crate) fn voxel_means(points: &[Point], voxel_size: f64, counter: &Counter) -> Result<Vec<Vector>> {
    let mut cells: HashMap<[i64; 3], usize> = HashMap::new();
    let mut sums: Vec<(Vector, usize)> = Vec::new();
    for points in points.chunks(4096) {
        counter.check()?;
        for point in points.iter().copied().map(vector) {
            let cell = [point.x, point.y, point.z].map(|v| (v / voxel_size).floor() as i64);
            let index = *cells.entry(cell).or_insert(sums.len());
            if index == sums.len() {
                sums.push((Vector::zeros(), 0));
            }
            sums[index].0 += point;
            sums[index].1 += 1;
        }
        counter.add(points.len());
    }
    Ok(sums.into_iter().map(|(sum, count)| sum / count as f64).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_voxel_gives_the_mean_of_its_points() {
        let points = [[0.9, 0.1, 0.1], [-0.1, 0.2, 0.3], [0.1, 0.5, 0.1], [-0.3, 0.4, 0.5]];
        let means = voxel_means(&points, 1.0, &Counter::default()).unwrap();
        assert_eq!(means.len(), 2);
        assert!((means[0] - Vector::new(0.5, 0.3, 0.1)).norm() < 1e-7, "{means:?}");
        assert!((means[1] - Vector::new(-0.2, 0.3, 0.4)).norm() < 1e-7, "{means:?}");
        // Voxel indices beyond i64 do not panic.
        assert_eq!(voxel_means(&[[3e38; 3], [-3e38; 3]], 1e-30, &Counter::default()).unwrap().len(), 2);
    }
}

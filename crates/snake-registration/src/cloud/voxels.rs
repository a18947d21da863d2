//! Clouds downsampled to one point per voxel.

use snake_core::{Control, Counter, Result};
use snake_geometry::{CellGroups, Neighbors, Point, Vector, floor, vector};

/// Downsamples finite points to the means of voxels, and indexes these for neighbour queries.
pub(crate) fn downsample(points: &[Point], voxel_size: f64, control: &Control) -> Result<Neighbors> {
    let counter = control.begin("voxels", points.len());
    Neighbors::new(voxel_means(points, voxel_size, &counter)?)
}

/// The mean of the points in each voxel of side `voxel_size`, in the order of the voxels' first points.
pub(crate) fn voxel_means(points: &[Point], voxel_size: f64, counter: &Counter) -> Result<Vec<Vector>> {
    counter.check()?;
    let cell = |point: &Point| point.map(|v| floor(f64::from(v) / voxel_size));
    let cells = CellGroups::new(points.iter().map(cell))?;
    let mean = |members: &[u32]| {
        let points = members.iter().map(|&index| vector(points[index as usize]));
        points.sum::<Vector>() / members.len() as f64
    };
    counter.add(points.len());
    Ok(cells.iter().map(|(_, members)| mean(members)).collect())
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

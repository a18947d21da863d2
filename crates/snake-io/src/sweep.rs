//! Sweeps of laser scanners as plain little-endian float32 values, as the data sets KITTI and nuScenes store them.

use super::shape::{Position, Shape};

/// Reads x, y and z of points of `num_values` values each. The files have no header, so only their length is checked.
pub(super) fn read(bytes: &[u8], num_values: usize) -> Result<Shape, String> {
    let size = 4 * num_values;
    if !bytes.len().is_multiple_of(size) {
        return Err(format!("{} bytes are not a whole number of points of {num_values} float32 values", bytes.len()));
    }
    let value = |point: &[u8], axis: usize| {
        let (values, _) = point.as_chunks::<4>();
        f64::from(f32::from_le_bytes(values[axis]))
    };
    let position = |point: &[u8]| -> Position { std::array::from_fn(|axis| value(point, axis)) };
    Ok(bytes.chunks_exact(size).map(position).collect::<Vec<_>>().into())
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::super::tests::points;
    use crate::PointFormat;

    #[test]
    fn the_folder_of_a_data_set_selects_the_layout() {
        let format = |path: &str| PointFormat::from_path(Path::new(path));
        for path in ["sequences/00/velodyne/000000.bin", "drive/velodyne_points/data/000.BIN", "velodyne/000000.bin"] {
            assert_eq!(format(path).unwrap(), PointFormat::Kitti, "{path}");
        }
        for path in ["samples/LIDAR_TOP/n015.pcd.bin", "any.pcd.bin", "sweeps/LIDAR_TOP/n015.bin"] {
            assert_eq!(format(path).unwrap(), PointFormat::Nuscenes, "{path}");
        }
        let error = format("scans/000000.bin").unwrap_err().to_string();
        assert!(error.contains("--input-format kitti") && error.contains("nuscenes"), "{error}");
    }

    #[test]
    fn values_beyond_x_y_z_are_skipped_and_lengths_are_checked() {
        let bytes: Vec<u8> = (0..20).flat_map(|i| (i as f32).to_le_bytes()).collect();
        assert_eq!(points(super::read(&bytes, 5)).unwrap()[1], [5.0, 6.0, 7.0]);
        assert_eq!(points(super::read(&bytes, 4)).unwrap().len(), 5);
        assert!(points(super::read(&bytes[..79], 4)).unwrap_err().contains("79 bytes"));
    }
}

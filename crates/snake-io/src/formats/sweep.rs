//! Laser scanner sweeps of plain little-endian float32 values, as in the data sets KITTI and nuScenes.

use crate::table::Table;
use crate::table::scalar::Scalar;
use crate::table::shape::Shape;

/// The values of a point in both data sets; further values have no name.
const NAMES: [&str; 4] = ["x", "y", "z", "intensity"];

/// Numbers of values per point for which files are checked.
const STRIDES: std::ops::RangeInclusive<usize> = 3..=12;

/// Number of values that are enough to find the number of values per point.
const MAX_CHECKED: usize = 1 << 18;

/// Reads x, y and z of points of `num_values` values each.
pub(crate) fn read(bytes: &[u8], num_values: usize) -> Result<Shape, String> {
    Ok(table(bytes, num_values)?.read([0, 1, 2])?.into())
}

/// The values of points of `num_values` values each. The files have no header, so only their length is checked.
pub(crate) fn table(bytes: &[u8], num_values: usize) -> Result<Table<'_>, String> {
    let size = 4 * num_values;
    if !bytes.len().is_multiple_of(size) {
        let fitting = STRIDES.filter(|values| bytes.len().is_multiple_of(4 * values));
        let fitting: Vec<String> = fitting.map(|values| format!("`format` kitti:{values}")).collect();
        let advice =
            if fitting.is_empty() { "cut short?".into() } else { format!("what fits is {}", fitting.join(", ")) };
        let length = bytes.len();
        return Err(format!(
            "{length} bytes are not a whole number of points of {num_values} float32 values; {advice}"
        ));
    }
    let names = (0..num_values).map(|value| NAMES.get(value).copied().unwrap_or_default().into()).collect();
    Ok(Table::rows_of(names, bytes, bytes.len() / size, std::iter::repeat_n(Scalar::FLOAT, num_values)))
}

/// [`read`] if the content can have `num_values` values per point, a number that only the file's name suggests.
pub(crate) fn read_checked(bytes: &[u8], num_values: usize) -> Result<Shape, String> {
    let (values, _) = bytes.as_chunks::<4>();
    let values: Vec<f64> = values.iter().take(MAX_CHECKED).map(|value| f32::from_le_bytes(*value).into()).collect();
    // One of four values can be a time, which may be this large.
    let is_wild = |value: &&f64| value.abs() > 1e6 || (**value != 0.0 && value.abs() < 1e-20);
    if values.iter().filter(is_wild).count() * 4 > values.len() {
        return Err(format!(
            "the content is no float32 coordinates (float64, integers, or another format?); \
             `format` kitti:{num_values} reads it nevertheless"
        ));
    }
    if let Some(stride) = other_stride(&values, num_values) {
        return Err(format!(
            "the content repeats every {stride} values and not every {num_values}: `format` kitti:{stride} reads \
             points of {stride} float32 values (numpy.fromfile(FILE, \"<f4\").reshape(-1, {stride}) in Python), \
             kitti:{num_values} reads these {num_values} nevertheless"
        ));
    }
    read(bytes, num_values)
}

/// The number of values per point that the content shows, if it is not `num_values`.
///
/// x, y, z and intensity differ in magnitude, so their number explains a share of the variance of the logarithms. A
/// number that is coprime to the true one explains nothing.
fn other_stride(values: &[f64], num_values: usize) -> Option<usize> {
    let logs: Vec<f64> =
        values.iter().map(|v| (v.abs() + 1e-3).ln()).map(|v| if v.is_finite() { v } else { 0.0 }).collect();
    let own = explained(&logs, num_values);
    let shares: Vec<(usize, f64)> = STRIDES.map(|stride| (stride, explained(&logs, stride))).collect();
    let most = shares.iter().fold(0.0_f64, |most, &(_, share)| most.max(share));
    let &(stride, share) = shares.iter().find(|(_, share)| *share >= 0.9 * most)?;
    let is_other = if stride.is_multiple_of(num_values) {
        // The points of a scanner can alternate, but not so much that a coordinate is constant in every second point.
        stride != num_values && share > own + 0.05 && has_constant(values, num_values, stride)
    } else {
        share > 0.03 && share > 4.0 * own
    };
    (is_other && values.len() >= 64 * stride).then_some(stride)
}

/// The share of the variance that lies between the `stride` columns of a table.
fn explained(values: &[f64], stride: usize) -> f64 {
    let all = spread(values.iter());
    let within: f64 = (0..stride).map(|column| spread(values.iter().skip(column).step_by(stride))).sum();
    if all > 0.0 { 1.0 - within / all } else { 0.0 }
}

/// Whether a coordinate hardly varies in one of the points that `stride` values consist of. A point that is always
/// zero, like missing returns, does not count.
fn has_constant(values: &[f64], num_values: usize, stride: usize) -> bool {
    let deviation = |column: usize| spread(values.iter().skip(column).step_by(stride)).sqrt();
    let is_zero =
        |start: usize| values.chunks(stride).all(|row| row.iter().skip(start).take(num_values).all(|v| *v == 0.0));
    (0..3).any(|axis| {
        let starts = || (0..stride).step_by(num_values);
        let most = starts().map(|start| deviation(start + axis)).fold(0.0, f64::max);
        starts().any(|start| deviation(start + axis) < 0.02 * most && !is_zero(start))
    })
}

/// The sum of the squared deviations from the mean.
fn spread<'a>(values: impl Iterator<Item = &'a f64> + Clone) -> f64 {
    let count = values.clone().count().max(1) as f64;
    let mean = values.clone().sum::<f64>() / count;
    values.map(|value| (value - mean).powi(2)).sum()
}

#[cfg(test)]
mod tests {
    use std::path::Path;

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
        assert!(error.contains("`format` kitti") && error.contains("nuscenes"), "{error}");
    }
}

//! Attributes of points, which move with them: colours, intensity, normals.

use std::path::Path;

use crate::clouds::{is_pipe, read_file};
use crate::formats::PointFormat;
use crate::formats::{e57, pcd, ply, sweep};
use crate::las;
use crate::table::Table;
use crate::{Error, Result, text};
use snake_geometry::RigidTransform;

/// Colours, intensity and normals of a cloud's points. Each exists for all points or for none.
#[derive(Debug, Clone, PartialEq, Default)]
#[non_exhaustive]
pub struct Attributes {
    /// Red, green and blue `(N, 3)`.
    pub colors: Option<Vec<[u8; 3]>>,
    /// Intensity `(N,)`, in the file's unit.
    pub intensity: Option<Vec<f32>>,
    /// Normals `(N, 3)`, in the cloud's frame.
    pub normals: Option<Vec<[f32; 3]>>,
    /// The position of the sensor (3,), in the frame of the points: the `VIEWPOINT` of a PCD file.
    pub viewpoint: Option<[f64; 3]>,
}

const COLORS: [[&str; 3]; 3] =
    [["red", "green", "blue"], ["diffuse_red", "diffuse_green", "diffuse_blue"], ["r", "g", "b"]];
const NORMALS: [[&str; 3]; 3] =
    [["nx", "ny", "nz"], ["normal_x", "normal_y", "normal_z"], ["normalx", "normaly", "normalz"]];
const INTENSITIES: [[&str; 1]; 4] = [["intensity"], ["scalar_intensity"], ["reflectance"], ["reflectivity"]];
/// PCD columns that hold a colour in the bits of a number.
const PACKED: [[&str; 1]; 2] = [["rgb"], ["rgba"]];

/// Reads the attributes of a file's points, in the order of the points. Pipes and formats without attributes give none.
/// Attributes that are damaged, or whose number of values is not the number of points, are left out.
///
/// PLY, PCD, text with a header, LAS, LAZ, E57 and the sweeps of KITTI and nuScenes are read.
///
/// # Errors
/// [`Error::Io`] when the file cannot be read; [`Error::Format`] when the extension is not known.
pub fn read_attributes(path: &Path, format: Option<PointFormat>, num_points: usize) -> Result<Attributes> {
    if is_pipe(path) {
        return Ok(Attributes::default());
    }
    let (format, bytes) = match format {
        Some(format) => (format, std::fs::read(path).map_err(|source| Error::Io { path: path.into(), source })?),
        None => read_file(path)?,
    };
    let named = |table: std::result::Result<Table, String>| table.map(Attributes::named).unwrap_or_default();
    let attributes = match format {
        PointFormat::Ply => named(ply::table(&bytes)),
        PointFormat::Pcd => {
            let packed = pcd::table(&bytes).map(|(table, _)| Attributes::packed(table)).unwrap_or_default();
            Attributes { viewpoint: pcd::viewpoint(&bytes), ..packed }
        }
        PointFormat::Text => named(text::table(&bytes)),
        PointFormat::Kitti => named(sweep::table(&bytes, 4)),
        PointFormat::Nuscenes => named(sweep::table(&bytes, 5)),
        PointFormat::Sweep(num_values) => named(sweep::table(&bytes, num_values.into())),
        PointFormat::E57 => {
            let (colors, intensity) = e57::colors_and_intensities(&bytes).unwrap_or_default();
            Attributes { colors, intensity, ..Attributes::default() }
        }
        PointFormat::Las => scanned(las::intensities_and_colors(&bytes).unwrap_or_default()),
        _ => Attributes::default(),
    };
    Ok(attributes.for_points(num_points))
}

/// The columns of the first of these sets that a table has.
fn any<const N: usize>(table: &Table, sets: &[[&str; N]]) -> Option<Vec<[f64; N]>> {
    sets.iter().find_map(|names| table.named(*names))
}

/// The intensities and colours of a laser scan. Writers without a sensor for one of them write zeros.
fn scanned((intensity, colors): (Vec<f32>, Vec<[f64; 3]>)) -> Attributes {
    let intensity = Some(intensity).filter(|values| values.iter().any(|value| *value > 0.0));
    let colors = Some(to_bytes(&colors)).filter(|values| values.as_flattened().iter().any(|value| *value > 0));
    Attributes { colors, intensity, ..Attributes::default() }
}

impl Attributes {
    /// The attributes in the columns of a file.
    fn named(table: Table) -> Self {
        let floats = |row: &[f64; 3]| row.map(|value| value as f32);
        Self {
            colors: any(&table, &COLORS).map(|rows| to_bytes(&rows)),
            intensity: any(&table, &INTENSITIES).map(|rows| rows.iter().map(|[value]| *value as f32).collect()),
            normals: any(&table, &NORMALS).map(|rows| rows.iter().map(floats).collect()),
            viewpoint: None,
        }
    }

    /// [`Attributes::named`] with PCL's colours, which are the bits of one number.
    fn packed(table: Table) -> Self {
        let unpacked = |[bits]: &[f64; 1]| [16, 8, 0].map(|shift| (*bits as u32 >> shift) as u8);
        let packed: Option<Vec<[u8; 3]>> = any(&table, &PACKED).map(|rows| rows.iter().map(unpacked).collect());
        let named = Self::named(table);
        Self { colors: named.colors.or(packed), ..named }
    }

    /// Keeps only attributes with this number of values.
    fn for_points(self, num_points: usize) -> Self {
        Self {
            colors: self.colors.filter(|values| values.len() == num_points),
            intensity: self.intensity.filter(|values| values.len() == num_points),
            normals: self.normals.filter(|values| values.len() == num_points),
            viewpoint: self.viewpoint,
        }
    }

    /// The number of values of each attribute that exists.
    pub(crate) fn numbers(&self) -> impl Iterator<Item = usize> {
        let Self { colors, intensity, normals, .. } = self;
        let numbers = [colors.as_ref().map(Vec::len), intensity.as_ref().map(Vec::len), normals.as_ref().map(Vec::len)];
        numbers.into_iter().flatten()
    }

    /// The attributes of the points under a transform. It rotates the normals and moves the sensor.
    #[must_use]
    pub fn transformed(mut self, transform: &RigidTransform) -> Self {
        let rows = transform.to_matrix();
        let rotated = |normal: [f32; 3]| -> [f32; 3] {
            std::array::from_fn(|row| (0..3).map(|axis| rows[row][axis] * f64::from(normal[axis])).sum::<f64>() as f32)
        };
        self.normals.iter_mut().flatten().for_each(|normal| *normal = rotated(*normal));
        let moved = |[x, y, z]: [f64; 3]| rows.map(|[a, b, c, t]| a * x + b * y + c * z + t);
        self.viewpoint = self.viewpoint.map(|at| {
            let [x, y, z, _] = moved(at);
            [x, y, z]
        });
        self
    }

    /// The attributes that all of several clouds have, concatenated. The sensor is kept only if there is a single cloud.
    pub fn joined(parts: &[Self]) -> Self {
        fn all<T: Clone>(parts: &[Attributes], of: impl Fn(&Attributes) -> Option<&Vec<T>>) -> Option<Vec<T>> {
            parts
                .iter()
                .map(of)
                .collect::<Option<Vec<_>>>()
                .map(|values| values.into_iter().flatten().cloned().collect())
        }
        Self {
            colors: all(parts, |part| part.colors.as_ref()),
            intensity: all(parts, |part| part.intensity.as_ref()),
            normals: all(parts, |part| part.normals.as_ref()),
            viewpoint: if let [part] = parts { part.viewpoint } else { None },
        }
    }
}

/// Colours as bytes. Numbers of 16 bits keep their upper byte; fractions up to 1 are scaled to 255.
fn to_bytes(rows: &[[f64; 3]]) -> Vec<[u8; 3]> {
    let most = rows.as_flattened().iter().fold(0.0, |most: f64, value| most.max(*value));
    let is_share = most <= 1.0 && rows.as_flattened().iter().any(|value| value.fract() != 0.0);
    let factor = if is_share {
        255.0
    } else if most > 255.0 {
        1.0 / 256.0
    } else {
        1.0
    };
    rows.iter().map(|row| row.map(|value| (value * factor).clamp(0.0, 255.0) as u8)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{read_cloud, write_cloud};

    fn attributes(number: usize) -> Attributes {
        Attributes {
            colors: Some((0..number).map(|i| [i as u8, 255, 7]).collect()),
            intensity: Some((0..number).map(|i| i as f32 * 0.5).collect()),
            normals: Some((0..number).map(|i| if i % 2 == 0 { [1.0, 0.0, 0.0] } else { [0.0, 0.6, 0.8] }).collect()),
            viewpoint: None,
        }
    }

    #[test]
    fn every_format_that_can_hold_attributes_gives_them_back() {
        let folder = tempfile::tempdir().unwrap();
        let points: Vec<[f32; 3]> = (0..20).map(|i| [i as f32, 0.25, -1.5]).collect();
        for (name, origin) in
            [("a.ply", [0.0; 3]), ("b.ply", [5e6, 0.0, 0.0]), ("c.pcd", [0.0; 3]), ("d.csv", [0.0; 3])]
        {
            let path = folder.path().join(name);
            write_cloud(&path, &points, &attributes(20), origin).unwrap();
            assert_eq!(read_attributes(&path, None, 20).unwrap(), attributes(20), "{name}");
            assert_eq!(read_cloud(&path, &Default::default()).unwrap().points.len(), 20);
            assert_eq!(read_attributes(&path, None, 19).unwrap(), Attributes::default());
        }
        for name in ["e.npy", "f.xyz"] {
            let path = folder.path().join(name);
            write_cloud(&path, &points, &attributes(20), [0.0; 3]).unwrap();
            assert_eq!(read_cloud(&path, &Default::default()).unwrap().points, points);
            assert_eq!(read_attributes(&path, None, 20).unwrap(), Attributes::default());
        }
    }

    #[test]
    fn sweeps_have_an_intensity_and_colours_of_16_bits_or_shares_become_bytes() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("velodyne").join("0.bin");
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(&path, [1.0_f32, 2.0, 3.0, 0.5, 4.0, 5.0, 6.0, 0.25].map(f32::to_le_bytes).as_flattened())
            .unwrap();
        assert_eq!(read_attributes(&path, None, 2).unwrap().intensity, Some(vec![0.5, 0.25]));
        assert_eq!(to_bytes(&[[65280.0, 256.0, 0.0]]), [[255, 1, 0]]);
        assert_eq!(to_bytes(&[[1.0, 0.5, 0.0]]), [[255, 127, 0]]);
        assert_eq!(to_bytes(&[[255.0, 1.0, 0.0]]), [[255, 1, 0]]);
    }

    #[test]
    fn normals_rotate_and_clouds_are_joined_by_what_all_have() {
        let rows = [[0.0, -1.0, 0.0, 3.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];
        let moved = attributes(2).transformed(&RigidTransform::from_matrix(rows).unwrap());
        assert_eq!(moved.normals, Some(vec![[0.0, 1.0, 0.0], [-0.6, 0.0, 0.8]]));
        let joined = Attributes::joined(&[moved, Attributes { colors: None, ..attributes(1) }]);
        assert_eq!((joined.colors, joined.intensity.map(|values| values.len())), (None, Some(3)));
        assert_eq!(Attributes::joined(&[]).intensity, Some(vec![]));
    }

    #[test]
    fn the_sensor_of_a_pcd_file_moves_with_its_points() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.pcd");
        let seen = Attributes { viewpoint: Some([1.0, 2.0, 3.0]), ..Attributes::default() };
        let rows = [[0.0, -1.0, 0.0, 3.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];
        let moved = seen.transformed(&RigidTransform::from_matrix(rows).unwrap());
        for origin in [[0.0; 3], [5e6, 0.0, -2.0]] {
            write_cloud(&path, &[[0.0, 1.0, 2.0]; 3], &moved, origin).unwrap();
            let expected = [1.0 + origin[0], 1.0, 3.0 + origin[2]];
            assert_eq!(read_attributes(&path, None, 3).unwrap().viewpoint, Some(expected));
        }
        assert_eq!(Attributes::joined(&[moved.clone(), moved]).viewpoint, None);
    }
}

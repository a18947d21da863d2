//! Reads E57 laser scans with the crate `e57`.
//!
//! The crate allocates the sizes in the header. This module therefore checks the header and the number of points first.

use std::io::Cursor;

use e57::{CartesianCoordinate, E57Reader, Point, PointCloud, RecordName, Transform};
use snake_geometry::excerpt;

use crate::MAX_EXPANSION;
use crate::formats::quaternion::rotation;
use crate::table::shape::{Position, Shape};

/// Reads the points of all scans in the file's frame, with the pose of each scan applied. Points that a scanner marks as
/// invalid are not finite.
pub(crate) fn read(bytes: &[u8]) -> Result<Shape, String> {
    let mut points: Vec<Position> = Vec::new();
    for_each_point(bytes, &mut |position, _, _| points.push(position))?;
    Ok(points.into())
}

type ColorsAndIntensities = (Option<Vec<[u8; 3]>>, Option<Vec<f32>>);

/// The colours, as bytes, and the intensities of the points that [`read`] reads, if a scan has any. A colour that a scan lacks
/// or that a scanner marks as invalid is black, and such an intensity is 0.
pub(crate) fn colors_and_intensities(bytes: &[u8]) -> Result<ColorsAndIntensities, String> {
    let (mut colors, mut intensity, mut are_there) = (Vec::new(), Vec::new(), [false; 2]);
    for_each_point(bytes, &mut |_, scan, point| {
        let shares = point.color.as_ref().map_or([0.0; 3], |color| [color.red, color.green, color.blue]);
        colors.push(shares.map(|share| (255.0 * share).round() as u8));
        intensity.push(point.intensity.unwrap_or_default());
        are_there = [are_there[0] | scan.has_color(), are_there[1] | scan.has_intensity()];
    })?;
    let [has_colors, has_intensity] = are_there;
    Ok((has_colors.then_some(colors), has_intensity.then_some(intensity)))
}

/// Calls `found` with each position, its scan and the rest of the point's data.
fn for_each_point(bytes: &[u8], found: &mut dyn FnMut(Position, &PointCloud, &Point)) -> Result<(), String> {
    check_header(bytes)?;
    let failed = |error: e57::Error| {
        let advice = "it is damaged or cut short; copy or export it again";
        format!("{}; {advice}", excerpt(&error.to_string(), 200))
    };
    let mut reader = E57Reader::new(Cursor::new(bytes)).map_err(failed)?;
    let (most, mut num_points) = (bytes.len().saturating_mul(MAX_EXPANSION) as u64, 0_u64);
    for (number, scan) in (1..).zip(reader.pointclouds()) {
        num_points = num_points.saturating_add(scan.records);
        if num_points > most {
            return Err(format!("{} points in a file of {} bytes", scan.records, bytes.len()));
        }
        check_fields(&scan).map_err(|reason| format!("scan {number}: {reason}"))?;
        let place = pose(scan.transform.as_ref()).map_err(|reason| format!("the pose of scan {number}: {reason}"))?;
        let mut points = reader.pointcloud_simple(&scan).map_err(failed)?;
        // The crate's own pose also scales by the square of the quaternion's length.
        points.apply_pose(false);
        points.intensity_to_color(false);
        points.normalize_intensity(false);
        for point in points {
            let point = point.map_err(failed)?;
            let position = match point.cartesian {
                CartesianCoordinate::Valid { x, y, z } => place([x, y, z]),
                _ => [f64::NAN; 3],
            };
            found(position, &scan, &point);
        }
    }
    Ok(())
}

/// Refuses scans without positions.
fn check_fields(scan: &PointCloud) -> Result<(), String> {
    use RecordName::{CartesianX, CartesianY, CartesianZ, SphericalAzimuth, SphericalElevation, SphericalRange};
    let names: Vec<&RecordName> = scan.prototype.iter().map(|record| &record.name).collect();
    let has = |needed: [RecordName; 3]| needed.iter().all(|name| names.contains(&name));
    if has([CartesianX, CartesianY, CartesianZ]) || has([SphericalRange, SphericalAzimuth, SphericalElevation]) {
        return Ok(());
    }
    let fields = excerpt(&format!("{names:?}"), 200);
    Err(format!("no positions (x, y, z, or range, azimuth, elevation); its fields are {fields}"))
}

/// The map from a scan's frame to the file's frame. A pose may have only a translation or only a rotation.
fn pose(pose: Option<&Transform>) -> Result<impl Fn(Position) -> Position + use<>, String> {
    let Transform { rotation: turn, translation } = pose.cloned().unwrap_or_default();
    let translation = [translation.x, translation.y, translation.z];
    if !translation.iter().all(|v| v.is_finite()) {
        return Err(format!("a translation by {translation:?}, which is not finite"));
    }
    let rows = rotation([turn.w, turn.x, turn.y, turn.z])?;
    Ok(move |p: Position| {
        std::array::from_fn(|axis| {
            let [a, b, c] = rows[axis];
            a * p[0] + b * p[1] + c * p[2] + translation[axis]
        })
    })
}

/// Refuses sizes in the header that exceed the file.
fn check_header(bytes: &[u8]) -> Result<(), String> {
    if !bytes.starts_with(b"ASTM-E57") {
        return Err("not an E57 file: it does not begin with `ASTM-E57`".into());
    }
    let number = |at: usize| bytes.get(at..at + 8)?.try_into().ok().map(u64::from_le_bytes);
    let [xml_length, page_size] = [32, 40].map(number);
    match (xml_length, page_size) {
        (Some(length), _) if length > bytes.len() as u64 => Err("header: the XML section exceeds the file".into()),
        (Some(_), Some(1024)) => Ok(()),
        (_, None) | (None, _) => Err("cut short within the header".into()),
        (_, Some(size)) => Err(format!("header: pages of {size} bytes; allowed is 1024")),
    }
}

#[cfg(test)]
mod tests {
    use e57::{Quaternion, Record, RecordDataType, RecordValue, Translation};

    use super::*;

    #[test]
    fn headers_that_ask_for_much_memory_are_refused() {
        let good = std::fs::read(concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/data/io/good/scan.e57")).unwrap();
        let with = |at: usize| {
            let mut bytes = good.clone();
            bytes[at..at + 8].copy_from_slice(&(1_u64 << 40).to_le_bytes());
            super::read(&bytes).map(drop).unwrap_err()
        };
        assert!(with(32).contains("XML") && with(40).contains("1024"));
        assert!(super::read(&good[..20]).map(drop).unwrap_err().contains("header"));
    }

    /// A file with one scan per pose, each with the points 1 2 3 and 4 5 6.
    fn scans(poses: &[Option<Transform>], names: &[RecordName]) -> Vec<u8> {
        let mut file = Cursor::new(Vec::new());
        let mut writer = e57::E57Writer::new(&mut file, "file").unwrap();
        for pose in poses {
            let fields = names.iter().map(|name| Record { name: name.clone(), data_type: RecordDataType::F64 });
            let mut scan = writer.add_pointcloud("scan", fields.collect()).unwrap();
            scan.set_transform(pose.clone());
            for first in [1, 4] {
                let values = (first..).take(names.len()).map(|value| RecordValue::Double(f64::from(value)));
                scan.add_point(values.collect()).unwrap();
            }
            scan.finalize().unwrap();
        }
        writer.finalize().unwrap();
        drop(writer);
        file.into_inner()
    }

    fn pose(w: f64, z: f64, x: f64) -> Option<Transform> {
        let rotation = Quaternion { w, x: 0.0, y: 0.0, z };
        Some(Transform { rotation, translation: Translation { x, y: 0.0, z: 0.0 } })
    }

    const XYZ: [RecordName; 3] = [RecordName::CartesianX, RecordName::CartesianY, RecordName::CartesianZ];

    #[test]
    fn colours_and_intensity_are_those_of_the_points() {
        use RecordName::{ColorBlue, ColorGreen, ColorRed, Intensity};
        let names = [&XYZ[..], &[ColorRed, ColorGreen, ColorBlue, Intensity]].concat();
        let mut file = Cursor::new(Vec::new());
        let mut writer = e57::E57Writer::new(&mut file, "file").unwrap();
        let byte = RecordDataType::Integer { min: 0, max: 255 };
        let fields = names.iter().enumerate().map(|(index, name)| Record {
            name: name.clone(),
            data_type: if (3..6).contains(&index) { byte.clone() } else { RecordDataType::F32 },
        });
        let mut scan = writer.add_pointcloud("scan", fields.collect()).unwrap();
        for number in [1.0_f32, 2.0] {
            let color = [10, 128, 255].map(RecordValue::Integer);
            let values = [[number; 3].map(RecordValue::Single), color].concat();
            scan.add_point([values, vec![RecordValue::Single(300.0 * number)]].concat()).unwrap();
        }
        scan.finalize().unwrap();
        let fields = XYZ.map(|name| Record { name, data_type: RecordDataType::F32 });
        let mut plain = writer.add_pointcloud("plain", fields.into()).unwrap();
        plain.add_point([3.0; 3].map(RecordValue::Single).into()).unwrap();
        plain.finalize().unwrap();
        writer.finalize().unwrap();
        drop(writer);
        assert_eq!(
            colors_and_intensities(&file.into_inner()).unwrap(),
            (Some(vec![[10, 128, 255], [10, 128, 255], [0; 3]]), Some(vec![300.0, 600.0, 0.0]))
        );
        assert_eq!(colors_and_intensities(&scans(&[None], &XYZ)).unwrap(), (None, None));
    }

    #[test]
    fn poses_turn_and_move_and_never_scale() {
        let read = |pose| super::read(&scans(&[None, pose], &XYZ)).unwrap().points;
        for (w, z) in [(1.0, 1.0), (0.707, 0.707), (2.0, 2.0), (-0.1, -0.1), (1e200, 1e200)] {
            let points = read(pose(w, z, 10.0));
            assert_eq!(points[..2], [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]);
            for (found, expected) in points[2..].as_flattened().iter().zip([8.0, 1.0, 3.0, 5.0, 4.0, 6.0]) {
                assert!((found - expected).abs() < 1e-12, "{w} {z}: {points:?}");
            }
        }
        // No rotation: a quaternion of zeros, or with only the scalar part.
        for w in [0.0, 1.0, -3.0] {
            assert_eq!(read(pose(w, 0.0, 10.0))[2..], [[11.0, 2.0, 3.0], [14.0, 5.0, 6.0]]);
        }
    }

    #[test]
    fn poses_that_are_not_finite_and_scans_without_positions_are_refused() {
        for pose in [pose(f64::NAN, 0.0, 0.0), pose(1.0, f64::INFINITY, 0.0), pose(1.0, 0.0, f64::NAN)] {
            let error = super::read(&scans(&[None, pose], &XYZ)).map(drop).unwrap_err();
            assert!(error.contains("scan 2") && error.contains("not finite"), "{error}");
        }
        let mut flat = PointCloud::default();
        let record = |name: &RecordName| Record { name: name.clone(), data_type: RecordDataType::F64 };
        flat.prototype = XYZ[..2].iter().map(record).collect();
        let error = super::check_fields(&flat).unwrap_err();
        assert!(error.contains("no positions") && error.contains("CartesianY"), "{error}");
    }
}

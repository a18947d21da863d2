//! Reads keypoints from the files that this crate writes.

use std::path::Path;

use serde::Deserialize;
use snake_geometry::{Cloud, Covariance, Keypoint, Point};

use crate::arrays::npy;
use crate::formats::{KeypointFormat, unknown_extension};
use crate::formats::{pcd, ply};
use crate::table::{Table, find};
use crate::{Error, Result, text};

/// The columns of a file of keypoints; others, such as colours, are ignored. Old files lack the last ones. A confidence that is
/// not known is not a number. The covariance does not follow from the largest deviation, so that column is not used.
const COLUMNS: [&str; 8] = ["x", "y", "z", "saliency", "occupancy", "nearest_index", "confidence", "deviation"];
const EXTENSIONS: &[&str] = &["ply", "pcd", "npy", "csv", "json"];

type Row = [f64; 7];

/// Reads keypoints as [`write_keypoints`](crate::write_keypoints) writes them in PLY, PCD, NPY, CSV and JSON: the keypoints in
/// the file's order, relative to an origin, and that origin, which is zero near zero.
///
/// ```
/// use snake_geometry::{Covariance, Keypoint};
/// # let folder = tempfile::tempdir()?;
/// # let path = folder.path().join("keypoints.csv");
/// let keypoint = Keypoint { position: [1.0, 0.5, 2.0], saliency: 0.9, occupancy: 0.8, nearest_index: 7, confidence: Some(0.5), covariance: Covariance::UNKNOWN };
/// snake_io::write_keypoints(&path, &[keypoint], &Default::default())?;
/// assert_eq!(snake_io::read_keypoints(&path)?, (vec![keypoint], [0.0; 3]));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`Error::Io`] when the file cannot be read; [`Error::Format`] for other extensions, and for content that is not keypoints.
pub fn read_keypoints(path: &Path) -> Result<(Vec<Keypoint>, [f64; 3])> {
    let format = KeypointFormat::from_path(path)?;
    let bytes = std::fs::read(path).map_err(|source| Error::Io { path: path.into(), source })?;
    let format_error = |reason| Error::Format { path: path.into(), reason };
    if format == KeypointFormat::Json {
        let (rows, covariances): (Vec<Row>, Vec<Covariance>) = json(&bytes).map_err(format_error)?.into_iter().unzip();
        let (mut keypoints, origin) = keypoints(&rows, [0.0; 3]);
        keypoints.iter_mut().zip(covariances).for_each(|(keypoint, covariance)| keypoint.covariance = covariance);
        return Ok((keypoints, origin));
    }
    let (rows, origin) = match format {
        KeypointFormat::Ply => (ply::table(&bytes).and_then(rows), [0.0; 3]),
        KeypointFormat::Pcd => {
            let (table, origin) = pcd::table(&bytes).map_err(format_error)?;
            (rows(table), origin)
        }
        KeypointFormat::Npy => (npy_table(&bytes).and_then(rows), [0.0; 3]),
        KeypointFormat::Csv => (text::table(&bytes).and_then(rows), [0.0; 3]),
        _ => return Err(unknown_extension(path, "read as keypoints", EXTENSIONS)),
    };
    Ok(keypoints(&rows.map_err(format_error)?, origin))
}

fn keypoints(rows: &[Row], origin: [f64; 3]) -> (Vec<Keypoint>, [f64; 3]) {
    let positions = rows.iter().map(|&[x, y, z, ..]| std::array::from_fn(|axis| [x, y, z][axis] + origin[axis]));
    let cloud = Cloud::from_positions(positions);
    let keypoint = |(&[.., saliency, occupancy, index, confidence], position): (&Row, Point)| Keypoint {
        position,
        saliency: saliency as f32,
        occupancy: occupancy as f32,
        nearest_index: index as usize,
        confidence: (!confidence.is_nan()).then_some(confidence as f32),
        covariance: Covariance::UNKNOWN,
    };
    (rows.iter().zip(cloud.points).map(keypoint).collect(), cloud.origin)
}

/// The first columns of [`COLUMNS`].
fn first_columns<const NUMBER: usize>() -> [&'static str; NUMBER] {
    std::array::from_fn(|column| COLUMNS[column])
}

/// The rows of a table with these columns, of which the confidence can be missing.
fn rows(table: Table) -> std::result::Result<Vec<Row>, String> {
    if let Ok(columns) = find(&table.names, first_columns()) {
        return table.read(columns);
    }
    let columns = find(&table.names, first_columns::<6>()).map_err(|(missing, _)| {
        format!("no column `{missing}`, so these are not keypoints; the columns are {}", table.names.join(", "))
    })?;
    let with_confidence =
        |[x, y, z, saliency, occupancy, index]: [f64; 6]| [x, y, z, saliency, occupancy, index, f64::NAN];
    Ok(table.read(columns)?.into_iter().map(with_confidence).collect())
}

/// An array has no names: all columns, or the first seven or six.
fn npy_table(bytes: &[u8]) -> std::result::Result<Table<'_>, String> {
    npy::table(bytes, COLUMNS)
        .or_else(|_| npy::table(bytes, first_columns::<7>()))
        .or_else(|_| npy::table(bytes, first_columns::<6>()))
}

/// The rows and covariances of `{"keypoints": [..]}`; null is not a number.
fn json(bytes: &[u8]) -> std::result::Result<Vec<(Row, Covariance)>, String> {
    #[derive(Deserialize)]
    struct File {
        keypoints: Vec<Entry>,
    }
    #[derive(Deserialize)]
    struct Entry {
        x: Option<f64>,
        y: Option<f64>,
        z: Option<f64>,
        saliency: Option<f64>,
        occupancy: Option<f64>,
        nearest_index: u64,
        confidence: Option<f64>,
        covariance: Option<Covariance>,
    }
    let File { keypoints } = serde_json::from_slice(bytes).map_err(|error| error.to_string())?;
    let row = |Entry { x, y, z, saliency, occupancy, nearest_index, confidence, covariance }: Entry| {
        let [x, y, z, saliency, occupancy, confidence] =
            [x, y, z, saliency, occupancy, confidence].map(|value| value.unwrap_or(f64::NAN));
        let row = [x, y, z, saliency, occupancy, nearest_index as f64, confidence];
        (row, covariance.unwrap_or(Covariance::UNKNOWN))
    };
    Ok(keypoints.into_iter().map(row).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::KEYPOINTS;
    use crate::{KeypointSource, write_keypoints};
    use snake_geometry::add_origin;

    #[test]
    fn keypoints_of_every_format_read_back_as_they_were() {
        let folder = tempfile::tempdir().unwrap();
        for extension in EXTENSIONS {
            let path = folder.path().join(format!("keypoints.{extension}"));
            for keypoints in [&KEYPOINTS[..], &[]] {
                write_keypoints(&path, keypoints, &KeypointSource::default()).unwrap();
                assert_eq!(read_keypoints(&path).unwrap(), (keypoints.to_vec(), [0.0; 3]), "{extension}");
            }
            let far = [524_288.0, 5_400_000.0, 128.0];
            let near = KEYPOINTS.map(|keypoint| Keypoint { position: keypoint.position.map(|v| v % 8.0), ..keypoint });
            write_keypoints(&path, &near, &KeypointSource { origin: far, ..Default::default() }).unwrap();
            let (found, origin) = read_keypoints(&path).unwrap();
            for (found, expected) in found.iter().zip(&near) {
                let [found, expected] = [add_origin(found.position, origin), add_origin(expected.position, far)];
                assert!(
                    (0..3).all(|axis| (found[axis] - expected[axis]).abs() < 1e-6),
                    "{extension} {found:?} {expected:?}"
                );
            }
        }
    }

    #[test]
    fn columns_are_found_by_their_names_in_every_encoding() {
        let folder = tempfile::tempdir().unwrap();
        let columns = ["z", "y", "x", "hue", "occupancy", "saliency", "nearest_index"];
        let properties: String = columns.iter().map(|name| format!("property float {name}\n")).collect();
        let sizes = columns.map(|_| "4").join(" ");
        let types = columns.map(|_| "F").join(" ");
        for (name, text) in [
            ("a.ply", format!("ply\nformat ascii 1.0\nelement vertex 1\n{properties}end_header\n3 2 1 9 0.5 0.75 7\n")),
            (
                "a.pcd",
                format!(
                    "FIELDS {}\nSIZE {sizes}\nTYPE {types}\nPOINTS 1\nDATA ascii\n3 2 1 9 0.5 0.75 7\n",
                    columns.join(" ")
                ),
            ),
            ("a.csv", format!("{}\n3,2,1,9,0.5,0.75,7\n", columns.join(","))),
        ] {
            let path = folder.path().join(name);
            std::fs::write(&path, text).unwrap();
            let expected = Keypoint { position: [1.0, 2.0, 3.0], confidence: None, ..KEYPOINTS[0] };
            assert_eq!(read_keypoints(&path).unwrap(), (vec![expected], [0.0; 3]), "{name}");
        }
    }

    #[test]
    fn other_content_is_refused_with_a_reason() {
        let folder = tempfile::tempdir().unwrap();
        let refused = |name: &str, content: &[u8]| {
            let path = folder.path().join(name);
            std::fs::write(&path, content).unwrap();
            read_keypoints(&path).unwrap_err().to_string()
        };
        assert!(refused("a.csv", b"x,y,z\n1,2,3\n").contains("no column `saliency`"));
        assert!(refused("a.csv", b"x,y,z,saliency,occupancy,nearest_index\n1,2,3\n").contains("line 2"));
        assert!(refused("a.csv", b"").contains("no column `x`"));
        assert!(refused("a.json", b"{}").contains("keypoints"));
        let xyz = "property float x\nproperty float y\nproperty float z\n";
        let ply = format!("ply\nformat ascii 1.0\nelement vertex 0\n{xyz}end_header\n");
        assert!(refused("a.ply", ply.as_bytes()).contains("no column `saliency`"));
        assert!(refused("a.pcd", b"# .PCD").contains("no line DATA"));
        assert!(refused("a.txt", b"").contains("ply"));
        let path = folder.path().join("cut.ply");
        write_keypoints(&path, &KEYPOINTS, &KeypointSource::default()).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        assert!(
            refused("cut.ply", &bytes[..bytes.len() - 1])
                .contains("2 times element `vertex` takes at least 31 bytes each, 61 bytes follow")
        );
    }
}

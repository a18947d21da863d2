//! Reads keypoints from the files that this crate writes.

use std::path::Path;

use serde::Deserialize;
use snake_geometry::{Cloud, Keypoint, Point};

use crate::arrays::npy;
use crate::format::{KeypointFormat, unknown_extension};
use crate::formats::pcd;
use crate::text::columns::{Column, Columns};
use crate::write::table::Kind;
use crate::{Error, Result};

/// The columns of a file of keypoints; others, such as colours, are ignored.
const COLUMNS: [&str; 6] = ["x", "y", "z", "saliency", "occupancy", "nearest_index"];
/// The column that files of 2025 lack; a confidence that is not a number is none.
const CONFIDENCE: &str = "confidence";
const EXTENSIONS: &[&str] = &["ply", "pcd", "npy", "csv", "json"];

type Row = [f64; 7];

/// Reads keypoints as [`write_keypoints`](crate::write_keypoints) writes them in PLY, PCD, NPY, CSV and JSON: the keypoints in
/// the file's order, relative to an origin, and that origin, which is zero near zero.
///
/// ```
/// use snake_geometry::Keypoint;
/// # let folder = tempfile::tempdir()?;
/// # let path = folder.path().join("keypoints.csv");
/// let keypoint = Keypoint { position: [1.0, 0.5, 2.0], saliency: 0.9, occupancy: 0.8, nearest_index: 7, confidence: Some(0.5) };
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
    let (rows, origin) = match format {
        KeypointFormat::Ply => (ply(&bytes), [0.0; 3]),
        KeypointFormat::Pcd => (pcd_rows(&bytes), pcd::origin(&bytes)),
        KeypointFormat::Npy => (npy_rows(&bytes), [0.0; 3]),
        KeypointFormat::Csv => (csv(&bytes), [0.0; 3]),
        KeypointFormat::Json => (json(&bytes), [0.0; 3]),
        _ => return Err(unknown_extension(path, "read as keypoints", EXTENSIONS)),
    };
    let rows = rows.map_err(|reason| Error::Format { path: path.into(), reason })?;
    Ok(keypoints(&rows, origin))
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
    };
    (rows.iter().zip(cloud.points).map(keypoint).collect(), cloud.origin)
}

/// The places of the columns among the names of a file; that of the confidence can be missing.
fn places(names: &[&str]) -> std::result::Result<[Option<usize>; 7], String> {
    let place = |column: &&str| names.iter().position(|name| name == column);
    if let Some(missing) = COLUMNS.iter().find(|column| place(column).is_none()) {
        return Err(format!("no column `{missing}`, so these are not keypoints; the columns are {}", names.join(", ")));
    }
    let [x, y, z, saliency, occupancy, index] = COLUMNS.map(|column| place(&column));
    Ok([x, y, z, saliency, occupancy, index, place(&CONFIDENCE)])
}

fn csv(bytes: &[u8]) -> std::result::Result<Vec<Row>, String> {
    let text = str::from_utf8(bytes).map_err(|error| error.to_string())?;
    let mut lines = text.lines().enumerate();
    let header = lines.next().map(|(_, line)| line.split(',').collect::<Vec<_>>()).unwrap_or_default();
    let places = places(&header)?;
    let row = |(number, line): (usize, &str)| {
        let fields: Vec<&str> = line.split(',').collect();
        let value = |place: Option<usize>| match place {
            Some(place) => fields.get(place).and_then(|field| field.parse().ok()),
            None => Some(f64::NAN),
        };
        let row: Option<Vec<f64>> = places.iter().map(|&place| value(place)).collect();
        row.and_then(|row| row.try_into().ok())
            .ok_or_else(|| format!("line {}: not a number in each column", number + 1))
    };
    lines.map(row).collect()
}

/// The rows of `{"keypoints": [..]}`; null is not a number.
fn json(bytes: &[u8]) -> std::result::Result<Vec<Row>, String> {
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
    }
    let File { keypoints } = serde_json::from_slice(bytes).map_err(|error| error.to_string())?;
    let row = |Entry { x, y, z, saliency, occupancy, nearest_index, confidence }: Entry| {
        let [x, y, z, saliency, occupancy, confidence] =
            [x, y, z, saliency, occupancy, confidence].map(|value| value.unwrap_or(f64::NAN));
        [x, y, z, saliency, occupancy, nearest_index as f64, confidence]
    };
    Ok(keypoints.into_iter().map(row).collect())
}

fn npy_rows(bytes: &[u8]) -> std::result::Result<Vec<Row>, String> {
    let columns = |columns: [usize; 3]| Columns(columns.map(Column::Index));
    let (first, second) = (columns([0, 1, 2]), columns([3, 4, 5]));
    let (positions, scores) = (npy::positions(bytes, Some(&first))?, npy::positions(bytes, Some(&second))?);
    let confidences: Option<Vec<f64>> = npy::positions(bytes, Some(&columns([4, 5, 6])))
        .ok()
        .map(|rows| rows.map(|[.., confidence]| confidence).collect());
    let confidence = |row: usize| confidences.as_ref().map_or(f64::NAN, |all| all[row]);
    let row = |(row, ([x, y, z], [saliency, occupancy, index])): (usize, ([f64; 3], [f64; 3]))| {
        [x, y, z, saliency, occupancy, index, confidence(row)]
    };
    Ok(positions.zip(scores).enumerate().map(row).collect())
}

fn ply(bytes: &[u8]) -> std::result::Result<Vec<Row>, String> {
    let (header, data) = split(bytes, "end_header\n")?;
    if !header.contains("format binary_little_endian") {
        return Err("not a binary file of keypoints, as `save` writes it".into());
    }
    let words = header.lines().map(|line| line.split_whitespace().collect::<Vec<_>>());
    let (mut columns, mut num_rows) = (Vec::new(), 0);
    for words in words {
        match words[..] {
            ["element", "vertex", number] => num_rows = number.parse().map_err(|_| "the number of vertices")?,
            ["property", kind, name] => {
                columns.push((name, Kind::from_ply_type(kind).ok_or(format!("type `{kind}`"))?))
            }
            _ => {}
        }
    }
    binary(&columns, num_rows, data)
}

fn pcd_rows(bytes: &[u8]) -> std::result::Result<Vec<Row>, String> {
    let (header, data) = split(bytes, "DATA binary\n")?;
    let values = |key: &str| -> Vec<&str> {
        let line = header.lines().find_map(|line| line.strip_prefix(key));
        line.map(|line| line.split_whitespace().collect()).unwrap_or_default()
    };
    let kinds = values("SIZE").into_iter().zip(values("TYPE")).map(|kind| match kind {
        ("4", "F") => Ok(Kind::Float),
        ("8", "F") => Ok(Kind::Double),
        ("4", "I") => Ok(Kind::Int),
        (size, kind) => Err(format!("a field of type {kind} and size {size}")),
    });
    let columns = values("FIELDS").into_iter().zip(kinds).map(|(name, kind)| Ok((name, kind?)));
    let columns: Vec<(&str, Kind)> = columns.collect::<std::result::Result<_, String>>()?;
    let num_rows = values("POINTS").first().and_then(|number| number.parse().ok()).ok_or("the number of points")?;
    binary(&columns, num_rows, data)
}

/// The text before and up to a line, and the bytes after it.
fn split<'a>(bytes: &'a [u8], line: &str) -> std::result::Result<(&'a str, &'a [u8]), String> {
    let end = bytes.windows(line.len()).position(|window| window == line.as_bytes());
    let end = end
        .ok_or_else(|| format!("no line `{}`: not a binary file of keypoints, as `save` writes it", line.trim_end()))?;
    let header = str::from_utf8(&bytes[..end]).map_err(|error| error.to_string())?;
    Ok((header, &bytes[end + line.len()..]))
}

/// The rows of little-endian numbers.
fn binary(columns: &[(&str, Kind)], num_rows: usize, data: &[u8]) -> std::result::Result<Vec<Row>, String> {
    let names: Vec<&str> = columns.iter().map(|(name, _)| *name).collect();
    let places = places(&names)?;
    let size: usize = columns.iter().map(|(_, kind)| kind.size()).sum();
    if num_rows.checked_mul(size) != Some(data.len()) {
        return Err(format!("{} bytes for {num_rows} keypoints of {size} bytes", data.len()));
    }
    let row = |mut bytes: &[u8]| {
        let values: Vec<f64> = columns.iter().map(|(_, kind)| kind.read(&mut bytes)).collect();
        places.map(|place| place.map_or(f64::NAN, |place| values[place]))
    };
    Ok(data.chunks_exact(size).map(row).collect())
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
        assert!(
            refused("a.ply", b"ply\nformat ascii 1.0\nelement vertex 0\nend_header\n").contains("as `save` writes it")
        );
        assert!(refused("a.pcd", b"# .PCD").contains("DATA binary"));
        assert!(refused("a.txt", b"").contains("ply"));
        let path = folder.path().join("cut.ply");
        write_keypoints(&path, &KEYPOINTS, &KeypointSource::default()).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        assert!(refused("cut.ply", &bytes[..bytes.len() - 1]).contains("2 keypoints of 31 bytes"));
    }
}

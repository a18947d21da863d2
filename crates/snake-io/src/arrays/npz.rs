//! NumPy's `.npz`: a zip archive of `.npy` arrays.

use std::io::{Cursor, Read};

use zip::ZipArchive;

use crate::MAX_EXPANSION;
use crate::arrays::npy;
use crate::table::shape::Shape;
use crate::text::columns::Columns;
use snake_geometry::excerpt;

/// Names of the array with the cloud, the likeliest first. NumPy gives the last one to an array without a name.
const NAMES: [&str; 5] = ["points", "xyz", "pc", "pos", "arr_0"];

/// Number of bytes that are enough to read an array's shape.
const MAX_HEADER_BYTES: usize = 1 << 12;

type Archive<'a> = ZipArchive<Cursor<&'a [u8]>>;

/// Reads the array with one of [`NAMES`], or the only array of shape `(N, C)`, `C >= 3`.
pub(crate) fn read(bytes: &[u8], columns: Option<&Columns>) -> Result<Shape, String> {
    let mut archive = open(bytes)?;
    let named = NAMES.iter().find_map(|name| archive.index_for_name(&format!("{name}.npy")));
    let index = match named {
        Some(index) => index,
        None => only_cloud(&mut archive)?,
    };
    let most = bytes.len().saturating_mul(MAX_EXPANSION);
    let array = unpack(&mut archive, index, most)?;
    if array.len() == most {
        return Err(format!(
            "an array has over {MAX_EXPANSION} times the size of the file; save it without compression"
        ));
    }
    npy::read(&array, columns).map_err(|reason| format!("array `{}`: {reason}", name(&archive, index)))
}

fn open(bytes: &[u8]) -> Result<Archive<'_>, String> {
    ZipArchive::new(Cursor::new(bytes)).map_err(|e| format!("not a .npz file: {e}"))
}

/// The index of the only array with the shape of a cloud.
fn only_cloud(archive: &mut Archive) -> Result<usize, String> {
    let mut clouds = Vec::new();
    for index in 0..archive.len() {
        if unpack(archive, index, MAX_HEADER_BYTES).is_ok_and(|head| npy::is_cloud(&head)) {
            clouds.push(index);
        }
    }
    if let [index] = clouds[..] {
        return Ok(index);
    }
    let names: Vec<String> = (0..archive.len()).map(|index| name(archive, index)).collect();
    let (found, listed) = (clouds.len(), excerpt(&names.join(", "), 200));
    Err(format!(
        "{found} arrays of shape (N, 3) or more columns; call the cloud one of {}. It has: {listed}",
        NAMES.join(", ")
    ))
}

/// The name of an array.
fn name(archive: &Archive, index: usize) -> String {
    let name = archive.name_for_index(index).and_then(Result::ok).unwrap_or("?".into());
    excerpt(name.strip_suffix(".npy").unwrap_or(&name), 40)
}

/// Unpacks the first `most` bytes of an entry.
fn unpack(archive: &mut Archive, index: usize, most: usize) -> Result<Vec<u8>, String> {
    let damaged = |e: &dyn std::fmt::Display| format!("entry {index}: {}", excerpt(&e.to_string(), 100));
    let entry = archive.by_index(index).map_err(|e| damaged(&e))?;
    let mut unpacked = Vec::new();
    entry.take(most as u64).read_to_end(&mut unpacked).map_err(|e| damaged(&e))?;
    Ok(unpacked)
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use zip::ZipWriter;
    use zip::write::SimpleFileOptions;

    use super::*;

    /// An array of `<f8` zeros; only its shape matters.
    fn npy([rows, columns]: [usize; 2]) -> Vec<u8> {
        let mut bytes = Vec::new();
        npy::write_header(&mut bytes, "<f8", &format!("{rows}, {columns}")).unwrap();
        bytes.resize(bytes.len() + 8 * rows * columns, 0);
        bytes
    }

    fn npz(arrays: &[(&str, Vec<u8>)]) -> Vec<u8> {
        let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
        for (name, array) in arrays {
            archive.start_file(*name, SimpleFileOptions::default()).unwrap();
            archive.write_all(array).unwrap();
        }
        archive.finish().unwrap().into_inner()
    }

    #[test]
    fn the_cloud_is_found_by_name_or_shape() {
        let number = |arrays: &[(&str, Vec<u8>)]| read(&npz(arrays), None).map(|shape| shape.points.len());
        let (flat, other) = (("labels.npy", npy([9, 1])), ("normals.npy", npy([2, 3])));
        assert_eq!(number(&[flat.clone(), other.clone(), ("points.npy", npy([5, 3]))]), Ok(5));
        assert_eq!(number(&[("pc.npy", npy([4, 3])), ("xyz.npy", npy([5, 4]))]), Ok(5));
        assert_eq!(number(&[flat.clone(), other.clone()]), Ok(2));
        let reason = number(&[flat.clone(), other.clone(), ("scan.npy", npy([7, 3]))]).unwrap_err();
        assert!(reason.starts_with("2 arrays") && reason.ends_with("It has: labels, normals, scan"), "{reason}");
        assert!(number(&[flat.clone(), ("readme.txt", b"hello".to_vec())]).unwrap_err().starts_with("0 arrays"));
        assert!(number(&[("arr_0.npy", npy([3, 2]))]).unwrap_err().starts_with("array `arr_0`: shape"));
        assert!(number(&[]).unwrap_err().contains("0 arrays"));
    }

    #[test]
    fn damaged_archives_and_bombs_are_refused() {
        let whole = npz(&[("points.npy", npy([5, 3]))]);
        for length in 0..whole.len() {
            read(&whole[..length], None).unwrap_err();
        }
        assert!(read(b"\x93NUMPY", None).unwrap_err().contains("not a .npz file"));
        // 24 MB of zeros take about 24 kB.
        let bomb = npz(&[("points.npy", npy([1_000_000, 3]))]);
        let reason = read(&bomb, None).unwrap_err();
        assert!(bomb.len() < 200_000 && reason.contains("without compression"), "{reason}");
    }
}

//! Reads E57 laser scans with the crate `e57`.
//!
//! The crate allocates what the header asks for. This module therefore checks the header and the number of points first.

use std::io::Cursor;

use e57::{CartesianCoordinate, E57Reader};
use snake_core::excerpt;

use super::MAX_EXPANSION;
use super::shape::{Position, Shape};

/// Reads the points of all scans in the file's frame: the pose of each scan is applied. Points that a scanner marks as
/// invalid are not finite.
pub(super) fn read(bytes: &[u8]) -> Result<Shape, String> {
    check_header(bytes)?;
    let failed = |error: e57::Error| excerpt(&error.to_string(), 200);
    let mut reader = E57Reader::new(Cursor::new(bytes)).map_err(failed)?;
    let mut points: Vec<Position> = Vec::new();
    let most = bytes.len().saturating_mul(MAX_EXPANSION) as u64;
    for scan in reader.pointclouds() {
        if scan.records.saturating_add(points.len() as u64) > most {
            return Err(format!("{} points in a file of {} bytes", scan.records, bytes.len()));
        }
        for point in reader.pointcloud_simple(&scan).map_err(failed)? {
            points.push(match point.map_err(failed)?.cartesian {
                CartesianCoordinate::Valid { x, y, z } => [x, y, z],
                _ => [f64::NAN; 3],
            });
        }
    }
    Ok(points.into())
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
}

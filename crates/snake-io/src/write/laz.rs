//! Writes keypoints as LAZ 1.4 of point format 0. The extra dimensions are saliency, occupancy, nearest_index and confidence; PDAL
//! does not look for extra dimensions in earlier versions.

use std::io::{self, Cursor, Write};

use laz::{LasZipCompressor, LazVlr, LazVlrBuilder};
use snake_geometry::{Bounds, Keypoint, add_origin};

use crate::write::keypoint_source::KeypointSource;

/// Bytes of the public header of LAS 1.4.
const HEADER: u16 = 375;

/// Bytes of the header of a variable length record.
const RECORD_HEADER: u16 = 54;

/// Bytes of the extra dimensions of a point.
const EXTRA: u16 = 20;

/// The extra dimensions with their types: 9 is `f32`, 7 is `u64`.
const DIMENSIONS: [(&str, u8); 4] = [("saliency", 9), ("occupancy", 9), ("nearest_index", 7), ("confidence", 9)];

/// Writes keypoints. Coordinates are rounded to a power of ten that divides the extent into at least 200 million parts. The
/// intensity is the saliency, and the EPSG code gives the coordinate reference system.
pub(crate) fn write(out: &mut dyn Write, keypoints: &[Keypoint], source: &KeypointSource) -> io::Result<()> {
    let mut bounds = Bounds::default();
    keypoints.iter().for_each(|keypoint| bounds.add(add_origin(keypoint.position, source.origin)));
    if keypoints.is_empty() {
        bounds.add(source.origin);
    }
    let number = u32::try_from(keypoints.len()).map_err(|_| io::Error::other("more than 4294967295 keypoints"))?;
    let Bounds { low, high } = bounds;
    let extent = (0..3).map(|axis| high[axis] - low[axis]).fold(0.0, f64::max);
    let scale = 10_f64.powf((extent.max(1e-100) / 2e9).log10().ceil());
    let compression = LazVlrBuilder::default().with_point_format(0, EXTRA).map_err(io::Error::other)?.build();
    let records = records(&compression, source)?;
    let data_offset = u32::from(HEADER) + records.iter().map(|record| record.len() as u32).sum::<u32>();

    let mut header = b"LASF".to_vec();
    header.resize(24, 0);
    header.extend([1, 4]);
    header.resize(58, 0);
    header.extend(b"snake-rs");
    header.resize(94, 0);
    header.extend(HEADER.to_le_bytes());
    header.extend(data_offset.to_le_bytes());
    header.extend((records.len() as u32).to_le_bytes());
    // The upper bit marks compression.
    header.push(0x80);
    header.extend((20 + EXTRA).to_le_bytes());
    header.extend(number.to_le_bytes());
    // All points are first returns.
    header.extend(number.to_le_bytes());
    header.resize(131, 0);
    header.extend([scale; 3].iter().chain(&low).flat_map(|v| v.to_le_bytes()));
    header.extend((0..3).flat_map(|axis| [high[axis], low[axis]]).flat_map(f64::to_le_bytes));
    // Neither waveforms nor extended records.
    header.resize(247, 0);
    header.extend([u64::from(number); 2].iter().flat_map(|v| v.to_le_bytes()));
    header.resize(HEADER.into(), 0);
    header.extend(records.concat());

    let mut file = Cursor::new(header);
    file.set_position(data_offset.into());
    let mut compressor = LasZipCompressor::new(&mut file, compression).map_err(io::Error::other)?;
    for keypoint in keypoints {
        let position = add_origin(keypoint.position, source.origin);
        let mut record = Vec::with_capacity(usize::from(20 + EXTRA));
        let units = |axis: usize| ((position[axis] - low[axis]) / scale).round() as i32;
        (0..3).for_each(|axis| record.extend(units(axis).to_le_bytes()));
        record.extend(((keypoint.saliency.clamp(0.0, 1.0) * 65535.0) as u16).to_le_bytes());
        // Return 1 of 1.
        record.push(1 | 1 << 3);
        record.resize(20, 0);
        record.extend([keypoint.saliency, keypoint.occupancy].iter().flat_map(|v| v.to_le_bytes()));
        record.extend((keypoint.nearest_index as u64).to_le_bytes());
        record.extend(keypoint.confidence.unwrap_or(f32::NAN).to_le_bytes());
        compressor.compress_one(&record)?;
    }
    compressor.done()?;
    drop(compressor);
    out.write_all(file.get_ref())
}

/// The variable length records: compression, extra dimensions and, if it is known, the coordinate reference system.
fn records(compression: &LazVlr, source: &KeypointSource) -> io::Result<Vec<Vec<u8>>> {
    let mut laszip = Vec::new();
    compression.write_to(&mut laszip).map_err(io::Error::other)?;
    let mut dimensions = Vec::new();
    for (name, kind) in DIMENSIONS {
        let mut dimension = vec![0, 0, kind, 0];
        dimension.extend(name.as_bytes());
        dimension.resize(192, 0);
        dimensions.extend(dimension);
    }
    let mut records = vec![record(LazVlr::USER_ID, LazVlr::RECORD_ID, &laszip), record("LASF_Spec", 4, &dimensions)];
    let epsg = source.crs.as_ref().filter(|crs| !crs.is_geographic).and_then(|crs| crs.epsg);
    if let Some(code) = epsg.and_then(|code| u16::try_from(code).ok()) {
        let keys: [u16; 12] = [1, 1, 0, 2, 1024, 0, 1, 1, 3072, 0, 1, code];
        records.push(record("LASF_Projection", 34735, &keys.map(u16::to_le_bytes).concat()));
    }
    Ok(records)
}

fn record(user: &str, number: u16, content: &[u8]) -> Vec<u8> {
    let mut record = vec![0; 2];
    record.extend(user.as_bytes());
    record.resize(18, 0);
    record.extend(number.to_le_bytes());
    record.extend((content.len() as u16).to_le_bytes());
    record.resize(RECORD_HEADER.into(), 0);
    record.extend(content);
    record
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::crs::Crs;
    use crate::las::for_each_position;
    use crate::tests::KEYPOINTS;

    #[test]
    fn positions_and_the_reference_system_read_back() {
        let crs = Crs { epsg: Some(25832), ..Crs::default() };
        let near = KEYPOINTS.map(|keypoint| Keypoint { position: keypoint.position.map(|v| v.min(100.0)), ..keypoint });
        for keypoints in [&near[..], &near[..1], &[]] {
            let origin = [691_000.0, 5_336_000.0, 0.0];
            let source = KeypointSource { origin, crs: Some(crs.clone()), ..KeypointSource::default() };
            let mut bytes = Vec::new();
            write(&mut bytes, keypoints, &source).unwrap();
            let mut positions = Vec::new();
            let known =
                for_each_position(Cursor::new(&bytes), false, &mut |position| positions.push(position)).unwrap();
            assert_eq!((known, positions.len()), (Some(crs.clone()), keypoints.len()));
            for (position, keypoint) in positions.iter().zip(keypoints) {
                let expected = add_origin(keypoint.position, origin);
                assert!((0..3).all(|axis| (position[axis] - expected[axis]).abs() < 1e-6), "{position:?} {expected:?}");
            }
        }
    }
}

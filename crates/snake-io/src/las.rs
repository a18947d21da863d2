//! Reads ASPRS LAS laser scans, and their compressed form LAZ with the decoder of `laz`.
//!
//! The decoder trusts the file and allocates any size that it claims. This module therefore finds the chunks, checks
//! their sizes, and gives the decoder one chunk at a time.

use std::io::Cursor;

use laz::laszip::CompressorType;
use laz::record::{LayeredPointRecordDecompressor, RecordDecompressor, SequentialPointRecordDecompressor};
use laz::{DecompressionSelection, LazItem, LazItemType, LazVlr};

use super::MAX_EXPANSION;
use super::gps_time::GpsTimes;
use super::shape::{Position, Shape};

/// Reads the coordinates: integers times a scale plus an offset. All other fields of a point are ignored.
pub(super) fn read(bytes: &[u8]) -> Result<Shape, String> {
    let header = Header::parse(bytes)?;
    let data = bytes.get(header.data_offset..).ok_or("cut short before the points")?;
    let points = if header.is_compressed { header.compressed(bytes, data)? } else { header.plain(data)? };
    Ok(points.into())
}

struct Header {
    num_points: usize,
    /// Bytes per point.
    record_length: usize,
    is_compressed: bool,
    data_offset: usize,
    /// The offset of the variable length records, and their number.
    records_offset: usize,
    num_records: u32,
    scale: [f64; 3],
    offset: [f64; 3],
}

impl Header {
    /// Parses the public header block of LAS 1.0 to 1.4.
    fn parse(bytes: &[u8]) -> Result<Self, String> {
        if !bytes.starts_with(b"LASF") {
            return Err("not a LAS file: it does not begin with `LASF`".into());
        }
        let parsed = || {
            let [minor, point_format] = [*bytes.get(25)?, *bytes.get(104)?];
            // LAS 1.4 has a wider field for the number of points; the older field may then be 0.
            let wide = if minor >= 4 { u64::from_le_bytes(field(bytes, 247)?) } else { 0 };
            let num_points = if wide > 0 { wide } else { u32::from_le_bytes(field(bytes, 107)?).into() };
            let triple = |at: usize| -> Option<[f64; 3]> {
                let number = |axis: usize| Some(f64::from_le_bytes(field(bytes, at + 8 * axis)?));
                Some([number(0)?, number(1)?, number(2)?])
            };
            Some(Self {
                num_points: num_points.try_into().ok()?,
                record_length: u16::from_le_bytes(field(bytes, 105)?).into(),
                // The upper bits of the point format mark compression.
                is_compressed: point_format & 0xc0 != 0,
                data_offset: u32::from_le_bytes(field(bytes, 96)?) as usize,
                records_offset: u16::from_le_bytes(field(bytes, 94)?).into(),
                num_records: u32::from_le_bytes(field(bytes, 100)?),
                scale: triple(131)?,
                offset: triple(155)?,
            })
        };
        let header = parsed().ok_or("cut short within the header")?;
        if header.record_length < 12 {
            return Err(format!("points of {} bytes hold no coordinates", header.record_length));
        }
        if !header.scale.iter().chain(&header.offset).all(|v| v.is_finite()) {
            return Err("header: a scale or an offset is not finite".into());
        }
        Ok(header)
    }

    fn plain(&self, data: &[u8]) -> Result<Vec<Position>, String> {
        let Self { num_points, record_length, .. } = self;
        // This check comes before any allocation, because a header can claim any number.
        if *num_points > data.len() / record_length {
            return Err(format!("{num_points} points of {record_length} bytes each, but {} bytes follow", data.len()));
        }
        Ok(data.chunks_exact(*record_length).take(*num_points).map(|record| self.position(record)).collect())
    }

    /// The position in a point record. LAS records and decoded LAZ records begin with the coordinates.
    fn position(&self, record: &[u8]) -> Position {
        let (axes, _) = record.as_chunks::<4>();
        std::array::from_fn(|axis| f64::from(i32::from_le_bytes(axes[axis])) * self.scale[axis] + self.offset[axis])
    }

    fn compressed(&self, bytes: &[u8], data: &[u8]) -> Result<Vec<Position>, String> {
        let Self { num_points, record_length, .. } = self;
        if num_points.checked_mul(*record_length).is_none_or(|size| size / MAX_EXPANSION > data.len()) {
            return Err(format!("{num_points} points of {record_length} bytes each in {} bytes", data.len()));
        }
        let record = self.laszip_record(bytes).ok_or("no record says how the points are compressed")?;
        let vlr = LazVlr::from_buffer(record).map_err(|e| format!("compression: {e}"))?;
        let items = vlr.items();
        check_items(items, *record_length)?;
        let mut compressor = [0; 2];
        compressor.copy_from_slice(&record[..2]);
        let layered = items[0].version() >= 3;
        // Chunked data begins with eight bytes: the offset of the chunk table.
        let chunks = data.get(8..).ok_or("cut short before the points");
        match (u16::from_le_bytes(compressor), layered) {
            (kind, false) if kind == CompressorType::PointWise as u16 => self.sequential(items, data, usize::MAX),
            (kind, false) if kind == CompressorType::PointWiseChunked as u16 => {
                if vlr.uses_variable_size_chunks() {
                    return Err("chunks of different numbers of points cannot be read".into());
                }
                self.sequential(items, chunks?, vlr.chunk_size() as usize)
            }
            (kind, true) if kind == CompressorType::LayeredChunked as u16 => self.layered(items, chunks?),
            (kind, _) => Err(format!("compression of kind {kind} cannot be read")),
        }
    }

    /// The variable length record of LASzip.
    fn laszip_record<'a>(&self, bytes: &'a [u8]) -> Option<&'a [u8]> {
        let mut rest = bytes.get(self.records_offset..)?;
        for _ in 0..self.num_records {
            let (head, tail) = rest.split_at_checked(54)?;
            let (record, tail) = tail.split_at_checked(u16::from_le_bytes(field(head, 20)?).into())?;
            let is_laszip = head[2..].starts_with(LazVlr::USER_ID.as_bytes())
                && u16::from_le_bytes(field(head, 18)?) == LazVlr::RECORD_ID;
            if is_laszip {
                return (record.len() >= 2).then_some(record);
            }
            rest = tail;
        }
        None
    }

    /// Decodes points one after another, with a new decoder every `chunk_size` points.
    fn sequential(&self, items: &Vec<LazItem>, data: &[u8], chunk_size: usize) -> Result<Vec<Position>, String> {
        let mut source = Cursor::new(data);
        let (mut points, mut record) = (Vec::new(), vec![0; self.record_length]);
        while points.len() < self.num_points {
            if is_beyond_interval(data.get(source.position() as usize + self.record_length..)) {
                return Err(self.cut_short(points.len()));
            }
            let mut decoder = SequentialPointRecordDecompressor::new(&mut source);
            for item in items {
                match (item.item_type(), item.version()) {
                    (LazItemType::GpsTime, 2) => decoder.add_field_decompressor(GpsTimes::default()),
                    _ => decoder.set_fields_from(&vec![*item]).map_err(|e| format!("compression: {e}"))?,
                }
            }
            for _ in 0..chunk_size.min(self.num_points - points.len()) {
                decoder.decompress_next(&mut record).map_err(|_| self.cut_short(points.len()))?;
                points.push(self.position(&record));
            }
        }
        Ok(points)
    }

    /// Decodes chunks; each holds an uncompressed first point, the number of points, the sizes of the layers, and the
    /// layers.
    fn layered(&self, items: &Vec<LazItem>, mut data: &[u8]) -> Result<Vec<Position>, String> {
        let num_layers: usize = items.iter().map(num_layers).sum();
        let sizes_at = self.record_length + 4;
        let (mut points, mut record) = (Vec::new(), vec![0; self.record_length]);
        while points.len() < self.num_points {
            let cut_short = || self.cut_short(points.len());
            let count: [u8; 4] = field(data, self.record_length).ok_or_else(cut_short)?;
            let sizes = data.get(sizes_at..sizes_at + 4 * num_layers).ok_or_else(cut_short)?;
            let mut end = sizes_at + 4 * num_layers;
            let mut is_damaged = false;
            for size in sizes.as_chunks().0 {
                is_damaged |= is_beyond_interval(data.get(end..));
                end = end.saturating_add(u32::from_le_bytes(*size) as usize);
            }
            let (chunk, rest) = data.split_at_checked(end).ok_or_else(cut_short)?;
            let count = (u32::from_le_bytes(count) as usize).min(self.num_points - points.len());
            if count == 0 || is_damaged {
                return Err(cut_short());
            }
            let mut decoder = LayeredPointRecordDecompressor::new(Cursor::new(chunk));
            decoder.set_fields_from(items).map_err(|e| format!("compression: {e}"))?;
            decoder.set_selection(DecompressionSelection::xy_returns_channel().decompress_z());
            for _ in 0..count {
                decoder.decompress_next(&mut record).map_err(|_| self.cut_short(points.len()))?;
                points.push(self.position(&record));
            }
            data = rest;
        }
        Ok(points)
    }

    fn cut_short(&self, num_read: usize) -> String {
        format!("damaged or cut short: {num_read} of {} points could be read", self.num_points)
    }
}

/// `N` bytes at an offset.
fn field<const N: usize>(bytes: &[u8], at: usize) -> Option<[u8; N]> {
    bytes.get(at..)?.first_chunk().copied()
}

/// Whether compressed data begins with bytes that no encoder writes. The decoder's first value must be below the length
/// of its first interval; a larger value would make it read beyond its tables.
fn is_beyond_interval(data: Option<&[u8]>) -> bool {
    data.is_some_and(|data| data.starts_with(&[0xff; 4]))
}

/// Refuses a part of a point whose size differs from its type's size, and parts that do not add up to the point's size.
fn check_items(items: &[LazItem], record_length: usize) -> Result<(), String> {
    let is_known = |item: &LazItem| {
        let size = match item.item_type() {
            LazItemType::Point10 => 20,
            LazItemType::GpsTime => 8,
            LazItemType::RGB12 | LazItemType::RGB14 => 6,
            LazItemType::WavePacket13 | LazItemType::WavePacket14 => 29,
            LazItemType::Point14 => 30,
            LazItemType::RGBNIR14 => 8,
            LazItemType::Byte(size) | LazItemType::Byte14(size) => size,
        };
        size == item.size() && size > 0
    };
    let begins_with_a_point =
        items.first().is_some_and(|item| matches!(item.item_type(), LazItemType::Point10 | LazItemType::Point14));
    let length: usize = items.iter().map(|item| usize::from(item.size())).sum();
    match begins_with_a_point && items.iter().all(is_known) && length == record_length {
        true => Ok(()),
        false => Err("compression: its parts do not make up a point".into()),
    }
}

/// The number of layers of one part of a point.
fn num_layers(item: &LazItem) -> usize {
    match item.item_type() {
        LazItemType::Point14 => 9,
        LazItemType::RGBNIR14 => 2,
        LazItemType::Byte14(count) => count.into(),
        _ => 1,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(name: &str) -> Vec<u8> {
        std::fs::read(format!("{}/../../tests/data/io/good/{name}", env!("CARGO_MANIFEST_DIR"))).unwrap()
    }

    /// A file with some bytes replaced.
    fn with(mut bytes: Vec<u8>, at: usize, replacement: &[u8]) -> Vec<u8> {
        bytes[at..at + replacement.len()].copy_from_slice(replacement);
        bytes
    }

    #[test]
    fn scale_and_offset_are_applied_in_f64() {
        let bytes = with(sample("format_2.las"), 131, &0.5_f64.to_le_bytes());
        let bytes = with(bytes, 163, &5_000_000.25_f64.to_le_bytes());
        let points = read(&bytes).unwrap().points;
        assert_eq!(points[1], [500.0, 4_999_998.25, 0.5]);
    }

    #[test]
    fn files_cut_short_are_refused() {
        for name in ["format_2.las", "format_7.las", "format_3.laz", "format_6.laz"] {
            let bytes = sample(name);
            let data_offset = u32::from_le_bytes(bytes[96..100].try_into().unwrap()) as usize;
            for length in 0..data_offset + 50 {
                read(&bytes[..length]).unwrap_err();
            }
        }
    }

    #[test]
    fn lying_headers_are_refused() {
        let many = u32::MAX.to_le_bytes();
        for (bytes, expected) in [
            (b"ply\n".to_vec(), "does not begin with `LASF`"),
            (with(sample("format_2.las"), 107, &many), "4294967295 points of 26 bytes each, but"),
            (with(sample("format_3.laz"), 107, &many), "4294967295 points of 34 bytes each in"),
            (with(sample("format_3.laz"), 107, &[50]), "damaged or cut short: "),
            (with(sample("format_6.laz"), 247, &[50]), "damaged or cut short: "),
            (with(sample("format_7.las"), 247, &u64::MAX.to_le_bytes()), "18446744073709551615 points"),
            (with(sample("format_2.las"), 105, &[11, 0]), "points of 11 bytes hold no coordinates"),
            (with(sample("format_2.las"), 131, &f64::NAN.to_le_bytes()), "not finite"),
            (with(sample("format_2.las"), 96, &many), "cut short before the points"),
            (with(sample("format_3.laz"), 105, &[35, 0]), "do not make up a point"),
            (with(sample("format_3.laz"), 100, &[0; 4]), "no record says how"),
        ] {
            let reason = read(&bytes).unwrap_err();
            assert!(reason.contains(expected), "{expected}: {reason}");
        }
        // These are the sizes of the layers, which the decoder would allocate.
        let bytes = sample("format_6.laz");
        let data_offset = u32::from_le_bytes(bytes[96..100].try_into().unwrap()) as usize;
        let reason = read(&with(bytes, data_offset + 8 + 30 + 4, &many)).unwrap_err();
        assert!(reason.contains("damaged or cut short: 0 of 4 points"), "{reason}");
    }
}

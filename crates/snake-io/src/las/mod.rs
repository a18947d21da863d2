//! Reads ASPRS LAS laser scans, and their compressed form LAZ with the decoder of `laz`.
//!
//! The decoder trusts the file and allocates any size that it claims. This module therefore finds the chunks, checks
//! their sizes, and gives the decoder one chunk at a time.

pub(crate) mod copc;
pub(crate) mod gps_time;
mod records;

use std::io::{BufRead, Cursor, ErrorKind, Read, Seek, SeekFrom};
use std::ops::Range;

use laz::laszip::CompressorType;
use laz::record::{LayeredPointRecordDecompressor, RecordDecompressor, SequentialPointRecordDecompressor};
use laz::{DecompressionSelection, LazItem, LazItemType, LazVlr};

use crate::MAX_EXPANSION;
use crate::crs::Crs;
use crate::las::gps_time::GpsTimes;
use crate::table::shape::{Position, Shape};

/// The size of the public header block of LAS 1.4, the longest.
pub(crate) const HEADER_SIZE: u64 = 375;

/// The classes of noise: low and high points.
const NOISE: [u8; 2] = [7, 18];

/// Reads the coordinates: integers times a scale plus an offset. Unless they are kept, points that are withheld or noise
/// are not finite.
pub(crate) fn read(bytes: &[u8], keep_withheld: bool) -> Result<Shape, String> {
    let (mut points, mut num_withheld): (Vec<Position>, usize) = (Vec::new(), 0);
    for_each_position(Cursor::new(bytes), keep_withheld, &mut |position| {
        num_withheld += usize::from(position[0].is_nan());
        points.push(position);
    })?;
    let mut shape = Shape::from(points);
    let all = shape.points.len();
    if num_withheld == all && all > 0 {
        return Err(format!(
            "all {all} points are marked as withheld or as noise; reading with `keep_withheld` keeps them"
        ));
    }
    if num_withheld > 0 {
        shape.notes.push(format!(
            "{num_withheld} of {all} points are left out, because the file marks them as withheld or as noise; \
             reading with `keep_withheld` keeps them"
        ));
    }
    Ok(shape)
}

/// Calls `found` with each position of a file; memory does not grow with the number of points. Unless they are kept,
/// points that are withheld or noise are NaN. Returns the coordinate reference system.
pub(crate) fn for_each_position(
    mut source: impl BufRead + Seek,
    keep_withheld: bool,
    found: &mut dyn FnMut(Position),
) -> Result<Option<Crs>, String> {
    let length = source.seek(SeekFrom::End(0)).map_err(|e| e.to_string())?;
    let header = Header::parse(&start(&mut source, HEADER_SIZE)?)?;
    let head = header.for_each_record(&mut source, length, &mut |record| {
        let is_used = keep_withheld || !header.is_withheld(record);
        found(if is_used { header.position(record) } else { [f64::NAN; 3] });
    })?;
    Ok(header.crs(&head, &mut |range| {
        let mut bytes = vec![0; (range.end - range.start) as usize];
        source.seek(SeekFrom::Start(range.start)).and_then(|_| source.read_exact(&mut bytes)).ok()?;
        Some(bytes)
    }))
}

/// Intensities and 16-bit colours of the points that [`read`] reads.
pub(crate) fn intensities_and_colors(bytes: &[u8]) -> Result<(Vec<f32>, Vec<[f64; 3]>), String> {
    let header = Header { with_attributes: true, ..Header::parse(bytes)? };
    let (mut intensity, mut colors) = (Vec::new(), Vec::new());
    header.for_each_record(&mut Cursor::new(bytes), bytes.len() as u64, &mut |record| {
        let word = |at: usize| field(record, at).map(u16::from_le_bytes);
        intensity.extend(word(12).map(f32::from));
        let color = header.colors_at().and_then(|at| Some([word(at)?, word(at + 2)?, word(at + 4)?]));
        colors.extend(color.map(|color| color.map(f64::from)));
    })?;
    Ok((intensity, colors))
}

/// The coordinate reference system of a file that [`read`] reads.
pub(crate) fn crs(bytes: &[u8]) -> Option<Crs> {
    let header = Header::parse(bytes).ok()?;
    let read = &mut |range: Range<u64>| bytes.get(range.start as usize..range.end as usize).map(<[u8]>::to_vec);
    header.crs(bytes.get(..header.data_offset)?, read)
}

/// The first bytes of a file, at most `number`. The source is then positioned after them.
fn start(source: &mut (impl Read + Seek), number: u64) -> Result<Vec<u8>, String> {
    let mut bytes = Vec::new();
    let read = source.rewind().and_then(|()| source.take(number).read_to_end(&mut bytes));
    read.map(|_| bytes).map_err(|e| e.to_string())
}

#[derive(Debug)]
pub(crate) struct Header {
    pub(crate) num_points: usize,
    /// Bytes per point.
    pub(crate) record_length: usize,
    pub(crate) is_compressed: bool,
    point_format: u8,
    /// Whether intensity and colours are also decoded, which takes time.
    with_attributes: bool,
    /// Whether other data, such as waveforms or extended records, follow the points.
    has_other_data: bool,
    pub(crate) data_offset: usize,
    /// The offset of the variable length records, and their number.
    records_offset: usize,
    num_records: u32,
    /// Offset and number of the extended records after the points.
    extended: (u64, u32),
    pub(crate) scale: [f64; 3],
    offset: [f64; 3],
}

impl Header {
    /// Parses the public header block of LAS 1.0 to 1.4.
    pub(crate) fn parse(bytes: &[u8]) -> Result<Self, String> {
        if !bytes.starts_with(b"LASF") {
            return Err("not a LAS file: it does not begin with `LASF`".into());
        }
        let parsed = || {
            let [minor, point_format] = [*bytes.get(25)?, *bytes.get(104)?];
            // LAS 1.4 has a wider field for the number of points; the older field may then be 0.
            let wide = if minor >= 4 { u64::from_le_bytes(field(bytes, 247)?) } else { 0 };
            let num_points = if wide > 0 { wide } else { u32::from_le_bytes(field(bytes, 107)?).into() };
            let begins = |at: usize| Some(u64::from_le_bytes(field(bytes, at)?) > 0);
            let triple = |at: usize| -> Option<[f64; 3]> {
                let number = |axis: usize| Some(f64::from_le_bytes(field(bytes, at + 8 * axis)?));
                Some([number(0)?, number(1)?, number(2)?])
            };
            Some(Self {
                num_points: num_points.try_into().ok()?,
                record_length: u16::from_le_bytes(field(bytes, 105)?).into(),
                // The upper bits of the point format mark compression.
                is_compressed: point_format & 0xc0 != 0,
                point_format: point_format & 0x3f,
                with_attributes: false,
                has_other_data: (minor >= 3 && begins(227)?) || (minor >= 4 && begins(235)?),
                data_offset: u32::from_le_bytes(field(bytes, 96)?) as usize,
                records_offset: u16::from_le_bytes(field(bytes, 94)?).into(),
                num_records: u32::from_le_bytes(field(bytes, 100)?),
                extended: if minor >= 4 {
                    (u64::from_le_bytes(field(bytes, 235)?), u32::from_le_bytes(field(bytes, 243)?))
                } else {
                    (0, 0)
                },
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
        if let Some(axis) = header.scale.iter().position(|&scale| scale == 0.0) {
            return Err(format!(
                "header: the scale of {} is 0, which would put all points in one plane",
                ["x", "y", "z"][axis]
            ));
        }
        Ok(header)
    }

    /// Calls `found` with each point record. Returns the bytes before the points.
    fn for_each_record(
        &self,
        source: &mut (impl BufRead + Seek),
        length: u64,
        found: &mut dyn FnMut(&[u8]),
    ) -> Result<Vec<u8>, String> {
        let data_offset = self.data_offset as u64;
        let data_length = length.checked_sub(data_offset).ok_or("cut short before the points")? as usize;
        let head = start(source, data_offset)?;
        if self.is_compressed {
            self.compressed(&head, data_length, source, found)?;
        } else {
            self.plain(data_length, source, found)?;
        }
        Ok(head)
    }

    /// The offset of red in a point record; green and blue follow.
    fn colors_at(&self) -> Option<usize> {
        match self.point_format {
            2 => Some(20),
            3 | 5 => Some(28),
            7 | 8 | 10 => Some(30),
            _ => None,
        }
    }

    /// Whether a point is marked as withheld (deleted) or classified as noise.
    pub(crate) fn is_withheld(&self, record: &[u8]) -> bool {
        let byte = |at: usize| record.get(at).copied().unwrap_or_default();
        let (flag, class) = match self.point_format {
            0..=5 => (byte(15) & 0x80, byte(15) & 0x1f),
            _ => (byte(15) & 0x04, byte(16)),
        };
        flag != 0 || NOISE.contains(&class)
    }

    fn plain(&self, data_length: usize, source: &mut impl Read, found: &mut dyn FnMut(&[u8])) -> Result<(), String> {
        let Self { num_points, record_length, .. } = self;
        // This check comes before any allocation, because a header can claim any number.
        if *num_points > data_length / record_length {
            return Err(format!("{num_points} points of {record_length} bytes each, but {data_length} bytes follow"));
        }
        // An interrupted writer leaves the initial number of points in the header.
        let (fitting, rest) = (data_length / record_length, data_length % record_length);
        if *num_points < fitting && rest == 0 && !self.has_other_data {
            return Err(format!(
                "the header says {num_points} points, but {fitting} follow; repair it: lasinfo -i FILE -repair_counters"
            ));
        }
        let mut record = vec![0; *record_length];
        for num_read in 0..*num_points {
            source.read_exact(&mut record).map_err(|e| self.cut_short(num_read, &e))?;
            found(&record);
        }
        Ok(())
    }

    /// The position in a point record. LAS records and decoded LAZ records begin with the coordinates.
    pub(crate) fn position(&self, record: &[u8]) -> Position {
        let (axes, _) = record.as_chunks::<4>();
        std::array::from_fn(|axis| f64::from(i32::from_le_bytes(axes[axis])) * self.scale[axis] + self.offset[axis])
    }

    fn compressed(
        &self,
        head: &[u8],
        data_length: usize,
        source: &mut (impl BufRead + Seek),
        found: &mut dyn FnMut(&[u8]),
    ) -> Result<(), String> {
        let Self { num_points, record_length, .. } = self;
        if num_points.checked_mul(*record_length).is_none_or(|size| size / MAX_EXPANSION > data_length) {
            return Err(format!("{num_points} points of {record_length} bytes each in {data_length} bytes"));
        }
        let record = self.laszip_record(head).ok_or("no record says how the points are compressed")?;
        let vlr = LazVlr::from_buffer(record).map_err(|e| format!("compression: {e}"))?;
        let items = vlr.items();
        check_items(items, *record_length)?;
        let mut compressor = [0; 2];
        compressor.copy_from_slice(&record[..2]);
        let layered = items[0].version() >= 3;
        // Chunked data begins with eight bytes: the offset of the chunk table.
        let mut to_chunks = || {
            if data_length >= 8 {
                source.seek_relative(8).map_err(|e| e.to_string())
            } else {
                Err("cut short before the points".into())
            }
        };
        match (u16::from_le_bytes(compressor), layered) {
            (kind, false) if kind == CompressorType::PointWise as u16 => {
                self.sequential(items, usize::MAX, source, found)
            }
            (kind, false) if kind == CompressorType::PointWiseChunked as u16 => {
                if vlr.uses_variable_size_chunks() {
                    return Err("chunks of different numbers of points cannot be read".into());
                }
                to_chunks()?;
                self.sequential(items, vlr.chunk_size() as usize, source, found)
            }
            (kind, true) if kind == CompressorType::LayeredChunked as u16 => {
                to_chunks()?;
                self.layered(items, data_length - 8, source, found)
            }
            (kind, _) => Err(format!("compression of kind {kind} cannot be read")),
        }
    }

    /// Decodes points one after another, with a new decoder every `chunk_size` points.
    fn sequential(
        &self,
        items: &Vec<LazItem>,
        chunk_size: usize,
        source: &mut (impl BufRead + Seek),
        found: &mut dyn FnMut(&[u8]),
    ) -> Result<(), String> {
        let (mut num_read, mut record) = (0, vec![0; self.record_length]);
        while num_read < self.num_points {
            if self.begins_beyond_interval(source).map_err(|e| self.cut_short(num_read, &e))? {
                return Err(self.damaged(num_read));
            }
            let mut decoder = SequentialPointRecordDecompressor::new(&mut *source);
            for item in items {
                match (item.item_type(), item.version()) {
                    (LazItemType::GpsTime, 2) => decoder.add_field_decompressor(GpsTimes::default()),
                    _ => decoder.set_fields_from(&vec![*item]).map_err(|e| format!("compression: {e}"))?,
                }
            }
            for _ in 0..chunk_size.min(self.num_points - num_read) {
                decoder.decompress_next(&mut record).map_err(|e| self.cut_short(num_read, &e))?;
                found(&record);
                num_read += 1;
            }
        }
        Ok(())
    }

    /// Whether the compressed data after a chunk's first point is damaged, see [`is_beyond_interval`].
    fn begins_beyond_interval(&self, source: &mut (impl BufRead + Seek)) -> std::io::Result<bool> {
        let (skipped, mut first) = (self.record_length as i64, Vec::new());
        source.seek_relative(skipped)?;
        source.take(4).read_to_end(&mut first)?;
        source.seek_relative(-skipped - first.len() as i64)?;
        Ok(is_beyond_interval(Some(&first)))
    }

    /// Decodes chunks; each holds an uncompressed first point, the number of points, the sizes of the layers, and the
    /// layers. `length` is the number of bytes that follow.
    fn layered(
        &self,
        items: &Vec<LazItem>,
        mut length: usize,
        source: &mut impl Read,
        found: &mut dyn FnMut(&[u8]),
    ) -> Result<(), String> {
        let mut num_read = 0;
        while num_read < self.num_points {
            let (count, size) = self.chunk(items, num_read, length, source, found)?;
            num_read += count;
            length -= size;
        }
        Ok(())
    }

    /// Decodes one chunk of layers, with at most `length` bytes and at most the points that remain after `num_read`.
    /// Returns the number of its points and its size in bytes.
    pub(crate) fn chunk(
        &self,
        items: &Vec<LazItem>,
        num_read: usize,
        length: usize,
        source: &mut impl Read,
        found: &mut dyn FnMut(&[u8]),
    ) -> Result<(usize, usize), String> {
        let num_layers: usize = items.iter().map(num_layers).sum();
        let sizes_at = self.record_length + 4;
        let mut record = vec![0; self.record_length];
        let mut chunk = vec![0; sizes_at + 4 * num_layers];
        source.read_exact(&mut chunk).map_err(|e| self.cut_short(num_read, &e))?;
        let sizes = chunk[sizes_at..].as_chunks().0.iter().map(|size| u32::from_le_bytes(*size) as usize);
        let ends: Vec<usize> = sizes
            .scan(chunk.len(), |end, size| {
                *end = end.saturating_add(size);
                Some(*end)
            })
            .collect();
        let (head, end) = (chunk.len(), ends.last().copied().unwrap_or(chunk.len()));
        if end > length {
            return Err(self.damaged(num_read));
        }
        let count: [u8; 4] = field(&chunk, self.record_length).unwrap_or_default();
        chunk.resize(end, 0);
        source.read_exact(&mut chunk[head..]).map_err(|e| self.cut_short(num_read, &e))?;
        let is_damaged = [head].iter().chain(&ends).any(|&begin| is_beyond_interval(chunk.get(begin..)));
        let count = (u32::from_le_bytes(count) as usize).min(self.num_points - num_read);
        if count == 0 || is_damaged {
            return Err(self.damaged(num_read));
        }
        let mut decoder = LayeredPointRecordDecompressor::new(Cursor::new(&chunk[..]));
        decoder.set_fields_from(items).map_err(|e| format!("compression: {e}"))?;
        if !self.with_attributes {
            let selection = DecompressionSelection::xy_returns_channel().decompress_z();
            decoder.set_selection(selection.decompress_classification().decompress_flags());
        }
        for index in 0..count {
            decoder.decompress_next(&mut record).map_err(|e| self.cut_short(num_read + index, &e))?;
            found(&record);
        }
        Ok((count, end))
    }

    /// The error for a point that cannot be read.
    fn cut_short(&self, num_read: usize, error: &std::io::Error) -> String {
        match error.kind() {
            // The decoder returns other kinds for damaged data.
            ErrorKind::UnexpectedEof | ErrorKind::Other | ErrorKind::InvalidData => self.damaged(num_read),
            _ => format!("{error}, after {num_read} points"),
        }
    }

    pub(crate) fn damaged(&self, num_read: usize) -> String {
        format!("damaged or cut short: {num_read} of {} points could be read", self.num_points)
    }
}

/// `N` bytes at an offset.
pub(crate) fn field<const N: usize>(bytes: &[u8], at: usize) -> Option<[u8; N]> {
    bytes.get(at..)?.first_chunk().copied()
}

/// Whether compressed data begins with bytes that no encoder writes. The decoder's first value must be below the length
/// of its first interval; a larger value would make it read beyond its tables.
fn is_beyond_interval(data: Option<&[u8]>) -> bool {
    data.is_some_and(|data| data.starts_with(&[0xff; 4]))
}

/// Refuses a part of a point whose size differs from its type's size, and parts that do not add up to the point's size.
pub(crate) fn check_items(items: &[LazItem], record_length: usize) -> Result<(), String> {
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
    if begins_with_a_point && items.iter().all(is_known) && length == record_length {
        Ok(())
    } else {
        Err("compression: its parts do not make up a point".into())
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
        let points = read(&bytes, false).unwrap().points;
        assert_eq!(points[1], [500.0, 4_999_998.25, 0.5]);
    }

    #[test]
    fn withheld_points_and_noise_are_left_out_and_counted() {
        for (name, at, flag, class) in [("format_2.las", 15, 0x80, 15), ("format_7.las", 15, 0x04, 16)] {
            let data_offset = u32::from_le_bytes(sample(name)[96..100].try_into().unwrap()) as usize;
            for (at, byte, is_left_out) in [(at, flag, true), (class, 7, true), (class, 18, true), (class, 2, false)] {
                let bytes = with(sample(name), data_offset + at, &[byte]);
                let Shape { points, notes, .. } = read(&bytes, false).unwrap();
                assert_eq!(
                    points.iter().map(|p| p[0].is_nan()).collect::<Vec<_>>(),
                    [is_left_out, false, false, false]
                );
                assert_eq!(notes.len(), usize::from(is_left_out), "{name} {byte}");
                assert!(notes.iter().all(|note| note.starts_with("1 of 4 points are left out")), "{notes:?}");
                let Shape { points, notes, .. } = read(&bytes, true).unwrap();
                assert!(points.iter().flatten().all(|v| v.is_finite()) && notes.is_empty());
            }
        }
        let (bytes, noise) = (sample("format_2.las"), [0, 1, 2, 3].map(|point| 227 + 26 * point + 15));
        let all = noise.into_iter().fold(bytes, |bytes, at| with(bytes, at, &[7]));
        assert!(read(&all, false).err().unwrap().starts_with("all 4 points are marked as withheld"));
    }

    #[test]
    fn files_cut_short_are_refused() {
        for name in ["format_2.las", "format_7.las", "format_3.laz", "format_6.laz"] {
            let bytes = sample(name);
            let data_offset = u32::from_le_bytes(bytes[96..100].try_into().unwrap()) as usize;
            for length in 0..data_offset + 50 {
                read(&bytes[..length], false).unwrap_err();
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
            (with(sample("format_2.las"), 139, &0_f64.to_le_bytes()), "the scale of y is 0"),
            (with(sample("format_2.las"), 107, &[0]), "the header says 0 points, but 4 follow; repair it: lasinfo"),
            (with(sample("format_2.las"), 107, &[3]), "the header says 3 points, but 4 follow"),
            (with(sample("format_2.las"), 96, &many), "cut short before the points"),
            (with(sample("format_3.laz"), 105, &[35, 0]), "do not make up a point"),
            (with(sample("format_3.laz"), 100, &[0; 4]), "no record says how"),
        ] {
            let reason = read(&bytes, false).unwrap_err();
            assert!(reason.contains(expected), "{expected}: {reason}");
        }
        // These are the sizes of the layers, which the decoder would allocate.
        let bytes = sample("format_6.laz");
        let data_offset = u32::from_le_bytes(bytes[96..100].try_into().unwrap()) as usize;
        let reason = read(&with(bytes, data_offset + 8 + 30 + 4, &many), false).unwrap_err();
        assert!(reason.contains("damaged or cut short: 0 of 4 points"), "{reason}");
    }
}

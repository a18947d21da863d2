//! Decodes `PointCloud2` messages of ROS 2 and ROS 1.

use snake_geometry::{Cloud, PointCloud2Layout, PointCloud2View, PointField, PointSource};

/// Decodes a message: its frame and its points.
pub(crate) fn decode(encoding: &str, data: &[u8]) -> std::result::Result<(String, Cloud), String> {
    let reader = MessageReader::new(encoding, data)?;
    match reader.version {
        Version::One => cloud(reader, false),
        // Version 2 of CDR writes the size of a list of structures before it. Some writers omit this size.
        Version::Two => cloud(reader.clone(), true).or_else(|_| cloud(reader, false)),
    }
}

/// The frame and the points of a message. `has_list_size`: a size precedes the list of fields.
fn cloud(mut reader: MessageReader, has_list_size: bool) -> std::result::Result<(String, Cloud), String> {
    reader.skip_time()?;
    let frame_id = reader.text()?;
    let [height, width] = [reader.number()?, reader.number()?];
    if has_list_size {
        reader.number()?;
    }
    let num_fields = reader.number()?;
    let mut fields: Vec<(String, usize, u8, usize)> = Vec::new();
    for _ in 0..num_fields {
        fields.push((reader.text()?, reader.number()?, reader.byte()?, reader.number()?));
    }
    let is_bigendian = reader.byte()? != 0;
    let [point_step, row_step, length] = [reader.number()?, reader.number()?, reader.number()?];
    let layout = PointCloud2Layout { height, width, point_step, row_step, is_bigendian };
    let fields: Vec<PointField> = fields
        .iter()
        .map(|(name, offset, datatype, count)| PointField { name, offset: *offset, datatype: *datatype, count: *count })
        .collect();
    let view = PointCloud2View::new(layout, &fields, reader.bytes(length)?).map_err(|error| error.to_string())?;
    // Otherwise, points of zero bytes could have any number.
    if view.num_points() > length {
        return Err(format!("{} points in {length} bytes", view.num_points()));
    }
    Ok((frame_id, view.to_cloud()))
}

/// The versions of CDR; the ROS 1 encoding counts as the first.
#[derive(Clone, Copy)]
enum Version {
    One,
    Two,
}

/// A reader of messages in CDR, the encoding of ROS 2, or in the encoding of ROS 1. In CDR, numbers
/// are aligned to their size, counted from the end of the header; ROS 1 has no alignment.
#[derive(Clone)]
struct MessageReader<'a> {
    data: &'a [u8],
    place: usize,
    version: Version,
    is_little_endian: bool,
    is_aligned: bool,
}

impl<'a> MessageReader<'a> {
    /// A reader that is positioned at the time in the header of a message.
    fn new(encoding: &str, data: &'a [u8]) -> std::result::Result<Self, String> {
        let at_start = |data, version, is_little_endian, is_aligned| {
            Ok(Self { data, place: 0, version, is_little_endian, is_aligned })
        };
        match (encoding, data) {
            // The sequence number of the message precedes its time.
            ("ros1", [_, _, _, _, data @ ..]) => at_start(data, Version::One, true, false),
            ("cdr", [0, kind @ (0 | 1), _, _, data @ ..]) => at_start(data, Version::One, *kind == 1, true),
            // The middlewares use different numbers for version 2. All its numbers here have at most four bytes, which are
            // aligned as in version 1.
            ("cdr", [0, kind @ (6 | 7 | 16 | 17), _, _, data @ ..]) => {
                at_start(data, Version::Two, kind % 2 == 1, true)
            }
            ("cdr", [a, b, _, _, ..]) => Err(format!(
                "encoded as CDR of the kind {a:02x} {b:02x}; plain CDR is read (00 00, 00 01, 00 06, 00 07)"
            )),
            ("cdr" | "ros1", _) => Err("cut short".into()),
            _ => Err(format!("{} bytes that are not encoded as `cdr` or `ros1`, but as `{encoding}`", data.len())),
        }
    }

    fn bytes(&mut self, length: usize) -> std::result::Result<&'a [u8], String> {
        let end = self.place.checked_add(length);
        let bytes = end.and_then(|end| self.data.get(self.place..end)).ok_or("cut short")?;
        self.place += length;
        Ok(bytes)
    }

    fn byte(&mut self) -> std::result::Result<u8, String> {
        Ok(self.bytes(1)?[0])
    }

    fn number(&mut self) -> std::result::Result<usize, String> {
        if self.is_aligned {
            self.place = self.place.next_multiple_of(4);
        }
        let mut bytes = [0; 4];
        bytes.copy_from_slice(self.bytes(4)?);
        Ok(if self.is_little_endian { u32::from_le_bytes(bytes) } else { u32::from_be_bytes(bytes) } as usize)
    }

    /// A text that follows its length; in ROS 2 it ends with a zero.
    fn text(&mut self) -> std::result::Result<String, String> {
        let length = self.number()?;
        let bytes = self.bytes(length)?;
        Ok(String::from_utf8_lossy(bytes.strip_suffix(&[0]).unwrap_or(bytes)).into_owned())
    }

    fn skip_time(&mut self) -> std::result::Result<(), String> {
        self.bytes(8).map(drop)
    }
}

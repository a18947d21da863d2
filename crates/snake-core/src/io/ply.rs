//! PLY: reads the vertices with `ply-rs`, writes keypoints and clouds as vertices.
//!
//! `ply-rs` believes a header: it would loop over any number of elements that take no bytes, keep the last of two
//! properties with one name and thereby shift the others, and refuse the property names of some programs. So the header
//! is tidied and checked here, and the crate is given one element after another.

use std::io::{self, Write};

use ply_rs::parser::{Parser, Reader};
use ply_rs::ply::{ElementDef, Encoding, Header, Property, PropertyAccess, PropertyAccessResult, PropertyDef};
use ply_rs::ply::{PropertyType, ScalarType};

use super::excerpt;
use crate::detect::Keypoint;
use crate::points::Point;

const AXES: [&str; 3] = ["x", "y", "z"];

/// Far above any real header; it bounds the work on a hostile one, which grows with the square of the length.
const MAX_HEADER_BYTES: usize = 1 << 16;

/// Reads x, y, z of the element `vertex`, from ascii or binary of either byte order and from any scalar type.
///
/// Other properties do not count, nor does any element after the vertices.
pub(super) fn read(bytes: &[u8]) -> Result<Vec<Point>, String> {
    let (header_text, data) = split_header(bytes)?;
    let header = Parser::<Vertex>::new()
        .read_header(&mut Reader::new(header_text.as_bytes()))
        .map_err(|e| format!("header: {}", excerpt(&e.to_string(), 160)))?;
    check_header(&header_text, &header, data.len())?;
    let mut payload = Payload { data, encoding: header.encoding, line: header_text.lines().count() };
    // Elements without properties take no bytes, so that their count can be anything.
    for element in header.elements.values().filter(|element| !element.properties.is_empty()) {
        if element.name == "vertex" {
            return (0..element.count).map(|_| payload.next(element).map(|Vertex(point)| point)).collect();
        }
        for _ in 0..element.count {
            payload.next::<Skipped>(element)?;
        }
    }
    Err("no element `vertex`".into())
}

/// Writes vertices in binary little endian: `float x y z saliency occupancy`, `int nearest_index`.
pub(super) fn write(out: &mut dyn Write, keypoints: &[Keypoint]) -> io::Result<()> {
    write!(out, "ply\nformat binary_little_endian 1.0\nelement vertex {}\n", keypoints.len())?;
    for name in ["x", "y", "z", "saliency", "occupancy"] {
        writeln!(out, "property float {name}")?;
    }
    write!(out, "property int nearest_index\nend_header\n")?;
    for Keypoint { position: [x, y, z], saliency, occupancy, nearest_index } in keypoints {
        for value in [x, y, z, saliency, occupancy] {
            out.write_all(&value.to_le_bytes())?;
        }
        let index = i32::try_from(*nearest_index)
            .map_err(|_| io::Error::other(format!("nearest_index {nearest_index} exceeds a PLY int")))?;
        out.write_all(&index.to_le_bytes())?;
    }
    Ok(())
}

/// Writes vertices in binary little endian: `float x y z`.
pub(super) fn write_points(out: &mut dyn Write, points: &[Point]) -> io::Result<()> {
    write!(out, "ply\nformat binary_little_endian 1.0\nelement vertex {}\n", points.len())?;
    write!(out, "property float x\nproperty float y\nproperty float z\nend_header\n")?;
    points.as_flattened().iter().try_for_each(|value| out.write_all(&value.to_le_bytes()))
}

/// The header as text that `ply-rs` takes, line for line, and the data after it.
fn split_header(bytes: &[u8]) -> Result<(String, &[u8]), String> {
    if !bytes.starts_with(b"ply") {
        return Err("not a PLY file: it does not begin with `ply`".into());
    }
    let (mut header, mut length) = (String::new(), 0);
    for (number, line) in bytes[..bytes.len().min(MAX_HEADER_BYTES)].split_inclusive(|&byte| byte == b'\n').enumerate()
    {
        length += line.len();
        let line = String::from_utf8_lossy(line);
        header += plain_property(&line, number).as_deref().unwrap_or(&line);
        if line.trim_end() == "end_header" {
            return Ok((header, &bytes[length..]));
        }
    }
    Err(format!("no line `end_header` within the first {length} bytes"))
}

/// A property line with a plain and unique name, unless it names an axis.
///
/// Other names do not matter, and the crate takes letters and digits only: CloudCompare has `scalar_Roughness_(0.1)`.
fn plain_property(line: &str, number: usize) -> Option<String> {
    let mut words = line.split_whitespace();
    if words.next() != Some("property") {
        return None;
    }
    let data_type = match words.next()? {
        "list" => format!("list {} {}", words.next()?, words.next()?),
        scalar => scalar.into(),
    };
    let name = words.next()?;
    (!AXES.contains(&name)).then(|| format!("property {data_type} ignored_{number}\n"))
}

/// Refuses what would be misread, and counts that the data cannot hold.
fn check_header(text: &str, header: &Header, data_length: usize) -> Result<(), String> {
    let is_declaration = |line: &&str| matches!(line.split_whitespace().next(), Some("element" | "property"));
    let kept: usize = header.elements.values().map(|element| 1 + element.properties.len()).sum();
    if text.lines().filter(is_declaration).count() != kept {
        return Err("header: two elements or two properties have the same name".into());
    }
    if let Some(vertex) = header.elements.get("vertex") {
        let is_scalar = |axis: &&str| {
            vertex.properties.get(*axis).is_some_and(|axis| matches!(axis.data_type, PropertyType::Scalar(_)))
        };
        if let Some(axis) = AXES.iter().find(|axis| !is_scalar(axis)) {
            return Err(format!("header: element `vertex` has no scalar property `{axis}`"));
        }
    }
    for element in header.elements.values() {
        let least: usize = element.properties.values().map(|property| least_size(property, header.encoding)).sum();
        // The last line of an ascii file may lack its line feed.
        let missing_line_feed = usize::from(header.encoding == Encoding::Ascii);
        if element.count.saturating_mul(least) > data_length.saturating_add(missing_line_feed) {
            let ElementDef { name, count, .. } = element;
            let reason = format!("header: {count} times element `{name}` takes at least {least} bytes each");
            return Err(format!("{}, {data_length} bytes follow", excerpt(&reason, 160)));
        }
    }
    Ok(())
}

/// The fewest bytes that a property takes: a digit and a separator, or the value, or the length of an empty list.
fn least_size(property: &PropertyDef, encoding: Encoding) -> usize {
    let (PropertyType::Scalar(scalar) | PropertyType::List(scalar, _)) = &property.data_type;
    match (encoding, scalar) {
        (Encoding::Ascii, _) => 2,
        (_, ScalarType::Char | ScalarType::UChar) => 1,
        (_, ScalarType::Short | ScalarType::UShort) => 2,
        (_, ScalarType::Int | ScalarType::UInt | ScalarType::Float) => 4,
        (_, ScalarType::Double) => 8,
    }
}

/// The data not yet read.
struct Payload<'a> {
    data: &'a [u8],
    encoding: Encoding,
    /// Number of the last line read; for ascii only.
    line: usize,
}

impl Payload<'_> {
    fn next<E: PropertyAccess>(&mut self, element: &ElementDef) -> Result<E, String> {
        let parser = Parser::new();
        let parsed = match self.encoding {
            Encoding::Ascii => return self.next_ascii(&parser, element),
            Encoding::BinaryLittleEndian => parser.read_little_endian_element(&mut self.data, element),
            Encoding::BinaryBigEndian => parser.read_big_endian_element(&mut self.data, element),
        };
        parsed.map_err(|e| format!("element `{}`: {}", excerpt(&element.name, 40), excerpt(&e.to_string(), 100)))
    }

    fn next_ascii<E: PropertyAccess>(&mut self, parser: &Parser<E>, element: &ElementDef) -> Result<E, String> {
        let name = excerpt(&element.name, 40);
        while !self.data.is_empty() {
            let end = self.data.iter().position(|&byte| byte == b'\n').map_or(self.data.len(), |index| index + 1);
            let (line, rest) = self.data.split_at(end);
            (self.data, self.line) = (rest, self.line + 1);
            let line = String::from_utf8_lossy(line.trim_ascii());
            if line.is_empty() {
                continue;
            }
            return parser.read_ascii_element(&line, element).map_err(|_| {
                let hint =
                    if has_non_finite(&line) { " (`nan` and `inf` are read from binary files only)" } else { "" };
                format!("line {}: `{}` does not fit the properties of `{name}`{hint}", self.line, excerpt(&line, 60))
            });
        }
        Err(format!("the file ends before the last `{name}`"))
    }
}

fn has_non_finite(line: &str) -> bool {
    line.split_whitespace().any(|word| word.parse::<f64>().is_ok_and(|value| !value.is_finite()))
}

/// A vertex in 12 bytes; the crate's own element takes some hundreds.
struct Vertex(Point);

impl PropertyAccess for Vertex {
    fn new() -> Self {
        Self([0.0; 3])
    }

    fn set_property(&mut self, name: &str, value: Property) -> PropertyAccessResult {
        match (AXES.iter().position(|axis| *axis == name), value.to_f32_lossy()) {
            (Some(axis), Some(value)) => {
                self.0[axis] = value;
                PropertyAccessResult::Set
            }
            _ => PropertyAccessResult::Ignored,
        }
    }
}

/// An element that comes before the vertices.
struct Skipped;

impl PropertyAccess for Skipped {
    fn new() -> Self {
        Self
    }
}

#[cfg(test)]
mod tests {
    use ply_rs::ply::DefaultElement;

    use super::super::tests::KEYPOINTS;
    use super::*;

    const POINTS: [Point; 2] = [[1.0, 2.0, 3.0], [4.0, 50.0, 6.0]];

    /// A file with a list before and after the coordinates, an element before and an element after the vertices.
    fn ply(encoding: Encoding, scalar: &str) -> Vec<u8> {
        let integer_size = |name: &str| match name {
            "char" | "uchar" | "int8" | "uint8" => 1,
            "short" | "ushort" | "int16" | "uint16" => 2,
            _ => 4,
        };
        let mut bytes = format!(
            "ply\r\nformat {encoding} 1.0\ncomment \u{e9}\nelement camera 1\nproperty list uchar int views\n\
             element empty 1000000000000\nelement vertex 2\nproperty {scalar} x\n\
             property list uchar short scalar (0.1)\nproperty {scalar} y\nproperty {scalar} z\n\
             property uchar red\nelement face 1\nproperty list uchar uint vertex_indices\nend_header\n"
        )
        .into_bytes();
        if encoding == Encoding::Ascii {
            bytes.extend(b"2 -5 6\n1 2 7 8 2 3 255\r\n\n  4 0\t50 6 255 \n3 0 1 1");
            return bytes;
        }
        let camera = [(2.0, "uchar"), (-5.0, "int"), (6.0, "int")];
        let first = [(1.0, scalar), (2.0, "uchar"), (7.0, "short"), (8.0, "short"), (2.0, scalar), (3.0, scalar)];
        let second = [(255.0, "uchar"), (4.0, scalar), (0.0, "uchar"), (50.0, scalar), (6.0, scalar), (255.0, "uchar")];
        let face = [(3.0, "uchar"), (0.0, "uint"), (1.0, "uint"), (1.0, "uint")];
        for (value, scalar) in [&camera[..], &first, &second, &face].concat() {
            let value: f64 = value;
            let mut value = match scalar {
                "float" | "float32" => (value as f32).to_le_bytes().to_vec(),
                "double" | "float64" => value.to_le_bytes().to_vec(),
                _ => (value as i64).to_le_bytes()[..integer_size(scalar)].to_vec(),
            };
            if encoding == Encoding::BinaryBigEndian {
                value.reverse();
            }
            bytes.extend(value);
        }
        bytes
    }

    #[test]
    fn every_encoding_and_scalar_type() {
        let scalars = ["char", "uchar", "short", "ushort", "int", "uint", "float", "double", "int8", "uint8", "int16"];
        for encoding in [Encoding::Ascii, Encoding::BinaryLittleEndian, Encoding::BinaryBigEndian] {
            for scalar in scalars.into_iter().chain(["uint16", "int32", "uint32", "float32", "float64"]) {
                assert_eq!(read(&ply(encoding, scalar)).unwrap(), POINTS, "{encoding} {scalar}");
            }
        }
    }

    #[test]
    fn truncated_files_are_refused() {
        for (encoding, after_vertices) in
            [(Encoding::Ascii, 14), (Encoding::BinaryLittleEndian, 13), (Encoding::BinaryBigEndian, 13)]
        {
            let bytes = ply(encoding, "float");
            for length in 0..bytes.len() - after_vertices {
                assert!(read(&bytes[..length]).is_err(), "{encoding} {length}");
            }
        }
        let mut bytes = Vec::new();
        write(&mut bytes, &KEYPOINTS).unwrap();
        for length in 0..bytes.len() {
            read(&bytes[..length]).unwrap_err();
        }
    }

    #[test]
    fn bad_headers_and_lines_are_named() {
        let xyz = "property float x\nproperty float y\nproperty float z\n";
        for (body, expected) in [
            (format!("element vertex 1000000000000\n{xyz}end_header\n1 2 3\n"), "6 bytes follow"),
            (format!("element vertex 18446744073709551615\n{xyz}end_header\n1 2 3\n"), "6 bytes follow"),
            (format!("element vertex 99999999999999999999\n{xyz}end_header\n1 2 3\n"), "Invalid element"),
            (format!("element vertex 2\n{xyz}end_header\n1 2 3\n\n\n\n\n\n\n\n"), "ends before the last `vertex`"),
            (format!("element vertex 1\n{xyz}end_header\n1 2\n\n\n\n"), "line 8: `1 2` does not fit"),
            (format!("element vertex 1\n{xyz}end_header\n1 -nan 3\n"), "from binary files only"),
            (format!("element vertex 1\n{xyz}property float x\nend_header\n1 2 3 4\n"), "same name"),
            (format!("element vertex 1\n{xyz}element vertex 1\n{xyz}end_header\n1 2 3\n1 2 3\n"), "same name"),
            ("element vertex 0\nproperty float x\nproperty float y\nend_header\n".into(), "no scalar property `z`"),
            ("element vertex 0\nproperty list uchar float x\nend_header\n".into(), "no scalar property `x`"),
            ("element point 0\nproperty float x\nend_header\n".into(), "no element `vertex`"),
            ("element empty 1000000000000\nend_header\n".into(), "no element `vertex`"),
            ("element vertex 1\nproperty flaot x\nend_header\n".into(), "Line 4"),
            (xyz.into(), "no line `end_header`"),
        ] {
            let reason = read(format!("ply\nformat ascii 1.0\n{body}").as_bytes()).unwrap_err();
            assert!(reason.contains(expected), "{reason}");
        }
        assert!(read(b"solid cube").unwrap_err().starts_with("not a PLY file"));
        let none = format!("ply\nformat binary_big_endian 1.0\nelement vertex 0\n{xyz}end_header\n");
        assert!(read(none.as_bytes()).unwrap().is_empty());
    }

    #[test]
    fn hostile_headers_cost_little() {
        // The crate copies the element's name for each property.
        let long_name = "n".repeat(MAX_HEADER_BYTES / 2);
        let many = "property char a\n".repeat(MAX_HEADER_BYTES / 2 / 24);
        read(format!("ply\nformat ascii 1.0\nelement {long_name} 1\n{many}end_header\n").as_bytes()).unwrap_err();
        // A list that claims 4e9 items: the crate reserves some, and finds the end.
        let list = "ply\nformat binary_little_endian 1.0\nelement face 1\nproperty list uint double a\nend_header\n";
        read(&[list.as_bytes(), &[255; 64]].concat()).unwrap_err();
    }

    #[test]
    fn written_properties_read_back() {
        let mut bytes = Vec::new();
        write(&mut bytes, &KEYPOINTS).unwrap();
        let ply = Parser::<DefaultElement>::new().read_ply(&mut &bytes[..]).unwrap();
        for (vertex, keypoint) in ply.payload["vertex"].iter().zip(KEYPOINTS) {
            assert_eq!(AXES.map(|axis| vertex[axis].clone()), keypoint.position.map(Property::Float));
            assert_eq!(vertex["saliency"], Property::Float(keypoint.saliency));
            assert_eq!(vertex["occupancy"], Property::Float(keypoint.occupancy));
            assert_eq!(vertex["nearest_index"], Property::Int(keypoint.nearest_index as i32));
        }
    }
}

//! Reads PLY with `ply-rs`.
//!
//! `ply-rs` trusts a header. It would loop over any number of elements that take no bytes, keep only the last of two
//! properties with one name and thereby shift the others, and refuse the property names of some programs. This module
//! therefore rewrites and checks the header, and gives the crate one element at a time.

use std::borrow::Cow;

use ply_rs::parser::{Parser, Reader};
use ply_rs::ply::{ElementDef, Encoding, Header, Property, PropertyAccess, PropertyAccessResult, PropertyDef};
use ply_rs::ply::{PropertyType, ScalarType};

use super::shape::{Position, Shape, add_polygon};
use snake_core::excerpt;

const AXES: [&str; 3] = ["x", "y", "z"];

/// Names of the property with the corners of a face.
const CORNERS: [&str; 2] = ["vertex_indices", "vertex_index"];

/// A limit far above any real header. It bounds the work on a hostile header, which grows with the square of the
/// length.
const MAX_HEADER_BYTES: usize = 1 << 16;

/// Reads x, y, z of the element `vertex` and, if asked for, the polygons of the element `face`.
///
/// The file may be ascii or binary in either byte order, with any scalar type. Other properties are ignored, and so are
/// all elements after these two.
pub(super) fn read(bytes: &[u8], with_faces: bool) -> Result<Shape, String> {
    let (header_text, data) = split_header(bytes)?;
    let header = Parser::<Vertex>::new()
        .read_header(&mut Reader::new(header_text.as_bytes()))
        .map_err(|e| format!("header: {}", excerpt(&e.to_string(), 160)))?;
    check_header(&header_text, &header, data.len())?;
    let mut payload = Payload { data, encoding: header.encoding, line: header_text.lines().count() };
    let (mut points, mut triangles) = (None, Vec::new());
    // Elements without properties take no bytes, so the file's length does not limit their number.
    for element in header.elements.values().filter(|element| !element.properties.is_empty()) {
        match element.name.as_str() {
            "vertex" => {
                let point = |_| payload.next(element).map(|Vertex(point)| point);
                points = Some((0..element.count).map(point).collect::<Result<Vec<_>, _>>()?);
                if !with_faces {
                    break;
                }
            }
            "face" if with_faces => {
                for _ in 0..element.count {
                    let Face(corners) = payload.next(element)?;
                    add_polygon(&mut triangles, &corners);
                }
            }
            _ => (0..element.count).try_for_each(|_| payload.next::<Skipped>(element).map(drop))?,
        }
    }
    let faces = header.elements.get("face").filter(|_| !with_faces);
    let unread_faces = faces.map_or(0, |element| element.count);
    let shape = Shape { points: points.ok_or("no element `vertex`")?, triangles, unread_faces };
    shape.check_triangles()?;
    Ok(shape)
}

/// The header rewritten for `ply-rs`, line by line, and the data after it.
fn split_header(bytes: &[u8]) -> Result<(String, &[u8]), String> {
    if !bytes.starts_with(b"ply") {
        return Err("not a PLY file: it does not begin with `ply`".into());
    }
    let (mut header, mut length) = (String::new(), 0);
    let head = &bytes[..bytes.len().min(MAX_HEADER_BYTES)];
    let any_case = !names_axes(head);
    for (number, line) in head.split_inclusive(|&byte| byte == b'\n').enumerate() {
        length += line.len();
        let line = String::from_utf8_lossy(line);
        header += plain_property(&line, number, any_case).as_deref().unwrap_or(&line);
        if line.trim_end() == "end_header" {
            return Ok((header, &bytes[length..]));
        }
    }
    Err(format!("no line `end_header` within the first {length} bytes"))
}

/// Whether a header names an axis in lower case. If it does, names in upper case are other properties.
fn names_axes(head: &[u8]) -> bool {
    let is_axis = |line: &[u8]| {
        let line = line.trim_ascii_end();
        line.starts_with(b"property") && AXES.iter().any(|axis| line.ends_with(format!(" {axis}").as_bytes()))
    };
    let header = head.split(|&byte| byte == b'\n').take_while(|line| line.trim_ascii_end() != b"end_header");
    header.into_iter().any(is_axis)
}

/// Replaces the name of a property with a unique one, unless it names an axis or the corners. With `any_case` the axes may
/// be in upper case, as some scanners write them.
///
/// Other names are not used, and `ply-rs` accepts only letters and digits: CloudCompare writes
/// `scalar_Roughness_(0.1)`.
fn plain_property(line: &str, number: usize, any_case: bool) -> Option<String> {
    let mut words = line.split_whitespace();
    if words.next() != Some("property") {
        return None;
    }
    let data_type = match words.next()? {
        "list" => format!("list {} {}", words.next()?, words.next()?),
        scalar => scalar.into(),
    };
    let name = words.next()?;
    let lower = name.to_ascii_lowercase();
    if any_case && name != lower && AXES.contains(&lower.as_str()) {
        return Some(format!("property {data_type} {lower}\n"));
    }
    (!AXES.contains(&name) && !CORNERS.contains(&name)).then(|| format!("property {data_type} ignored_{number}\n"))
}

/// Refuses headers that would be misread, and counts that exceed the data.
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

/// The fewest bytes of a property: a digit and a separator in ascii; the value, or the length of an empty list, in
/// binary.
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

/// The data that is not yet read.
struct Payload<'a> {
    data: &'a [u8],
    encoding: Encoding,
    /// Number of the last line, for ascii only.
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
            return parser.read_ascii_element(&without_non_finite(&line), element).map_err(|_| {
                format!("line {}: `{}` does not fit the properties of `{name}`", self.line, excerpt(&line, 60))
            });
        }
        Err(format!("the file ends before the last `{name}`"))
    }
}

/// A placeholder for numbers that are not finite, which `ply-rs` refuses in ascii. No valid cloud contains it, because
/// it could not be normalised.
const NOT_FINITE: f32 = f32::MAX;

/// A line in which the placeholder replaces numbers that are not finite.
fn without_non_finite(line: &str) -> Cow<'_, str> {
    let is_not_finite = |word: &str| word.parse::<f64>().is_ok_and(|value| !value.is_finite());
    if !line.split_whitespace().any(is_not_finite) {
        return line.into();
    }
    let stand_in = NOT_FINITE.to_string();
    let words = line.split_whitespace().map(|word| if is_not_finite(word) { &stand_in } else { word });
    words.collect::<Vec<_>>().join(" ").into()
}

/// A vertex in 24 bytes; an element of `ply-rs` takes some hundreds.
struct Vertex(Position);

impl PropertyAccess for Vertex {
    fn new() -> Self {
        Self([0.0; 3])
    }

    fn set_property(&mut self, name: &str, value: Property) -> PropertyAccessResult {
        match (AXES.iter().position(|axis| *axis == name), number(&value)) {
            (Some(axis), Some(value)) => {
                self.0[axis] = if value as f32 == NOT_FINITE { f64::NAN } else { value };
                PropertyAccessResult::Set
            }
            _ => PropertyAccessResult::Ignored,
        }
    }
}

/// A scalar in f64, without loss; the conversion of `ply-rs` is to `f32`.
fn number(value: &Property) -> Option<f64> {
    match *value {
        Property::Double(value) => Some(value),
        Property::Int(value) => Some(value.into()),
        Property::UInt(value) => Some(value.into()),
        ref other => other.to_f32_lossy().map(f64::from),
    }
}

/// The corners of a polygon.
struct Face(Vec<u32>);

impl PropertyAccess for Face {
    fn new() -> Self {
        Self(Vec::new())
    }

    fn set_property(&mut self, name: &str, value: Property) -> PropertyAccessResult {
        if !CORNERS.contains(&name) {
            return PropertyAccessResult::Ignored;
        }
        // A value that is not an index is replaced by an index that no file has.
        fn indices<T: TryInto<u32>>(corners: Vec<T>) -> Vec<u32> {
            corners.into_iter().map(|corner| corner.try_into().unwrap_or(u32::MAX)).collect()
        }
        self.0 = match value {
            Property::ListChar(corners) => indices(corners),
            Property::ListUChar(corners) => indices(corners),
            Property::ListShort(corners) => indices(corners),
            Property::ListUShort(corners) => indices(corners),
            Property::ListInt(corners) => indices(corners),
            Property::ListUInt(corners) => corners,
            _ => return PropertyAccessResult::Ignored,
        };
        PropertyAccessResult::Set
    }
}

/// An element that is skipped.
struct Skipped;

impl PropertyAccess for Skipped {
    fn new() -> Self {
        Self
    }
}

#[cfg(test)]
mod tests {
    use ply_rs::ply::DefaultElement;

    use super::super::tests::{KEYPOINTS, points};
    use super::super::{KeypointFormat, KeypointSource};
    use super::*;
    use snake_core::Point;

    fn read(bytes: &[u8]) -> Result<Vec<Point>, String> {
        points(super::read(bytes, false))
    }

    const POINTS: [Point; 2] = [[1.0, 2.0, 3.0], [4.0, 50.0, 6.0]];

    /// A file with a list before and after the coordinates, and an element before and after the vertices.
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
    fn axes_may_be_in_upper_case_if_none_is_in_lower_case() {
        let text = |names: [&str; 4]| {
            let properties: String = names.iter().map(|name| format!("property float {name}\n")).collect();
            format!("ply\nformat ascii 1.0\nelement vertex 1\n{properties}end_header\n1 2 3 4\n")
        };
        let point = |names| read(text(names).as_bytes()).map(|points| points[0]);
        assert_eq!(point(["X", "Y", "Z", "Intensity"]).unwrap(), [1.0, 2.0, 3.0]);
        assert_eq!(point(["X", "x", "y", "z"]).unwrap(), [2.0, 3.0, 4.0]);
        assert!(point(["X", "X", "Y", "Z"]).unwrap_err().contains("same name"));
        assert!(point(["X", "y", "Z", "z"]).unwrap_err().contains("`x`"));
    }

    #[test]
    fn coordinates_that_are_not_finite_come_through() {
        for scalar in ["float", "double"] {
            let xyz = format!("property {scalar} x\nproperty {scalar} y\nproperty {scalar} z\n");
            let text = format!("ply\nformat ascii 1.0\nelement vertex 2\n{xyz}property {scalar} w\nend_header\n");
            let points = read(format!("{text}1 -nan inf nan\n4 5 6 nan\n").as_bytes()).unwrap();
            assert!(points[0][0] == 1.0 && !points[0][1].is_finite() && !points[0][2].is_finite(), "{points:?}");
            assert_eq!(points[1], [4.0, 5.0, 6.0]);
        }
    }

    #[test]
    fn faces_are_polygons_in_every_encoding_and_type() {
        let quads = "element vertex 4\nproperty float x\nproperty float y\nproperty float z\nelement face 2\n\
            property uchar quality\nproperty list uchar KIND vertex_index\nend_header\n";
        for kind in ["char", "uchar", "short", "ushort", "int", "uint"] {
            let header = |encoding| format!("ply\nformat {encoding} 1.0\n{}", quads.replace("KIND", kind));
            let ascii = header("ascii") + "0 0 0\n1 0 0\n1 1 0\n0 1 0\n9 4 0 1 2 3\n9 3 3 2 1\n";
            let size = match kind {
                "char" | "uchar" => 1,
                "short" | "ushort" => 2,
                _ => 4,
            };
            let mut binary = header("binary_little_endian").into_bytes();
            binary.extend(
                [0.0_f32, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.0, 0.0].map(f32::to_le_bytes).concat(),
            );
            for corners in [&[0_u32, 1, 2, 3][..], &[3, 2, 1]] {
                binary.extend([9, corners.len() as u8]);
                corners.iter().for_each(|corner| binary.extend(&corner.to_le_bytes()[..size]));
            }
            for bytes in [ascii.as_bytes(), &binary] {
                let shape = super::read(bytes, true).unwrap();
                assert_eq!((shape.points.len(), &shape.triangles[..]), (4, &[[0, 1, 2], [0, 2, 3], [3, 2, 1]][..]));
                assert!(super::read(bytes, false).unwrap().triangles.is_empty());
            }
            let beyond = super::read(ascii.replace("3 3 2 1", "3 3 2 4").as_bytes(), true).unwrap_err();
            assert!(beyond.contains("names vertex 4"), "{beyond}");
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
        KeypointFormat::Ply.write(&mut bytes, &KEYPOINTS, &KeypointSource::default()).unwrap();
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
        // `ply-rs` copies the element's name for each property.
        let long_name = "n".repeat(MAX_HEADER_BYTES / 2);
        let many = "property char a\n".repeat(MAX_HEADER_BYTES / 2 / 24);
        read(format!("ply\nformat ascii 1.0\nelement {long_name} 1\n{many}end_header\n").as_bytes()).unwrap_err();
        // The list claims 4e9 items: `ply-rs` reserves space for some and then finds the end of the data.
        let list = "ply\nformat binary_little_endian 1.0\nelement face 1\nproperty list uint double a\nend_header\n";
        read(&[list.as_bytes(), &[255; 64]].concat()).unwrap_err();
    }

    #[test]
    fn written_properties_read_back() {
        let mut bytes = Vec::new();
        KeypointFormat::Ply.write(&mut bytes, &KEYPOINTS, &KeypointSource::default()).unwrap();
        let ply = Parser::<DefaultElement>::new().read_ply(&mut &bytes[..]).unwrap();
        for (vertex, keypoint) in ply.payload["vertex"].iter().zip(KEYPOINTS) {
            assert_eq!(AXES.map(|axis| vertex[axis].clone()), keypoint.position.map(Property::Float));
            assert_eq!(vertex["saliency"], Property::Float(keypoint.saliency));
            assert_eq!(vertex["occupancy"], Property::Float(keypoint.occupancy));
            assert!(matches!(vertex["red"], Property::UChar(_)));
            assert_eq!(vertex["nearest_index"], Property::Int(keypoint.nearest_index as i32));
        }
    }
}

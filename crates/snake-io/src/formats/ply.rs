//! Reads PLY, ascii and binary.

use crate::formats::ply_header::{Element, Header};
use crate::table::Table;
use crate::table::scalar::Scalar;
use crate::table::shape::{Position, Shape, add_polygon, check_left_over};
use crate::text::lines::{Lines, advice, text};
use crate::text::number::number;
use snake_geometry::excerpt;

/// Reads x, y, z of the element `vertex` and, if requested, the polygons of the elements `face` and `tristrips`.
///
/// The file may be ascii or binary in either byte order, with any scalar type. Ascii coordinates keep all their digits.
/// Other properties and elements are ignored, whether or not their values fit their types. Faces that are not requested
/// may be damaged or cut short.
pub(crate) fn read(bytes: &[u8], with_faces: bool) -> Result<Shape, String> {
    let (elements, vertex, mut payload) = open(bytes)?;
    let (mut shape, mut num_read) = (Shape::default(), 0);
    for (index, element) in elements.iter().enumerate() {
        num_read = index + 1;
        match element.name.as_str() {
            "vertex" => shape.points = payload.points(element)?,
            "face" if with_faces => payload.faces(element, &mut shape.triangles)?,
            "tristrips" if with_faces => payload.strips(element, &mut shape.triangles)?,
            _ => payload.skip(element)?,
        }
        if index >= vertex && !with_faces {
            break;
        }
    }
    payload.check_rest(&elements[num_read..], &shape.points)?;
    if !with_faces {
        let faces = elements.iter().filter(|element| matches!(element.name.as_str(), "face" | "tristrips"));
        shape.unread_faces = faces.map(|element| element.count).sum();
    }
    shape.check_triangles()?;
    Ok(shape)
}

/// The vertices with all properties except lists.
pub(crate) fn table(bytes: &[u8]) -> Result<Table<'_>, String> {
    let (mut elements, vertex, mut payload) = open(bytes)?;
    elements[..vertex].iter().try_for_each(|element| payload.skip(element))?;
    let element = elements.swap_remove(vertex);
    if let Some(table) = payload.take_table(&element) {
        return table;
    }
    let names = element.scalars().map(|(_, property)| property.name.clone()).collect();
    Ok(Table::parsed(names, move |columns, found| payload.clone().rows(&element, columns, found)))
}

/// The elements with properties, the index of the vertices among them, and the data. Elements without properties take no
/// bytes, so the file's length does not limit their number.
fn open(bytes: &[u8]) -> Result<(Vec<Element>, usize, Payload<'_>), String> {
    let (header, lines) = Header::parse(bytes)?;
    let payload = if header.is_ascii { Payload::Ascii(lines) } else { Payload::Binary(lines.rest()) };
    let elements: Vec<_> = header.elements.into_iter().filter(|element| !element.properties.is_empty()).collect();
    let vertex = elements.iter().take_while(|element| element.name != "vertex").count();
    Ok((elements, vertex, payload))
}

/// The data that is not yet read.
#[derive(Clone)]
enum Payload<'a> {
    Ascii(Lines<'a>),
    Binary(&'a [u8]),
}

impl<'a> Payload<'a> {
    /// Reads a row and calls `found` with the index and the value of each property that `is_wanted`.
    fn next(
        &mut self,
        element: &Element,
        is_wanted: impl Fn(usize) -> bool,
        found: impl FnMut(usize, f64),
    ) -> Result<(), String> {
        match self {
            Self::Binary(data) => {
                let value = |scalar: Scalar, _| Some(scalar.decode(take(data, 1, scalar.size)?));
                read_row(element, value, is_wanted, found).ok_or_else(|| cut_short(element))
            }
            Self::Ascii(lines) => {
                let name = || excerpt(&element.name, 40);
                let (line_number, line) =
                    lines.next().ok_or_else(|| format!("the file ends before the last `{}`", name()))?;
                let line = text(line);
                let mut words = line.split_ascii_whitespace();
                let value = |_, is_wanted| {
                    let word = words.next()?;
                    if is_wanted { number(word) } else { Some(f64::NAN) }
                };
                read_row(element, value, is_wanted, found).ok_or_else(|| {
                    let (row, advice) = (excerpt(&line, 60), advice(&line));
                    format!("line {line_number}: `{row}` does not fit the properties of `{}`{advice}", name())
                })
            }
        }
    }

    /// Takes the rows of an element that has no lists from binary data.
    fn take_table(&mut self, element: &Element) -> Option<Result<Table<'a>, String>> {
        let (Self::Binary(data), Some(stride)) = (self, element.stride()) else { return None };
        let Element { count, properties, .. } = element;
        let table = |rows| {
            let names = properties.iter().map(|property| property.name.clone()).collect();
            Table::rows_of(names, rows, *count, properties.iter().map(|property| property.item))
        };
        Some(take(data, *count, stride).map(table).ok_or_else(|| cut_short(element)))
    }

    /// Reads the rows of an element and calls `found` with the values of its scalars in `columns`.
    fn rows(&mut self, element: &Element, columns: &[usize], found: &mut dyn FnMut(&[f64])) -> Result<(), String> {
        let mut places = vec![None; element.properties.len()];
        let scalars: Vec<usize> = element.scalars().map(|(index, _)| index).collect();
        (0..).zip(columns).for_each(|(place, &column)| places[scalars[column]] = Some(place));
        let mut row = vec![f64::NAN; columns.len()];
        (0..element.count).try_for_each(|_| {
            let set = |index: usize, value: f64| places[index].iter().for_each(|&place: &usize| row[place] = value);
            self.next(element, |index| places[index].is_some(), set)?;
            found(&row);
            Ok(())
        })
    }

    fn points(&mut self, element: &Element) -> Result<Vec<Position>, String> {
        let axes = element.axes()?;
        if let Some(table) = self.take_table(element) {
            return table?.read(axes);
        }
        let mut points = Vec::with_capacity(element.count);
        self.rows(element, &axes, &mut |row| points.push([row[0], row[1], row[2]]))?;
        Ok(points)
    }

    /// Calls `found` with the corners of each row.
    fn corners(&mut self, element: &Element, mut found: impl FnMut(&[f64])) -> Result<(), String> {
        let mut corners = Vec::new();
        (0..element.count).try_for_each(|_| {
            corners.clear();
            self.next(element, |index| element.properties[index].has_corners(), |_, corner| corners.push(corner))?;
            found(&corners);
            Ok(())
        })
    }

    fn faces(&mut self, element: &Element, triangles: &mut Vec<[u32; 3]>) -> Result<(), String> {
        let mut polygon = Vec::new();
        self.corners(element, |corners| {
            polygon.clear();
            polygon.extend(corners.iter().map(|&corner| index(corner)));
            add_polygon(triangles, &polygon);
        })
    }

    /// Reads triangle strips. Negative corners separate the strips of a list, and every second
    /// triangle of a strip has the opposite winding.
    fn strips(&mut self, element: &Element, triangles: &mut Vec<[u32; 3]>) -> Result<(), String> {
        self.corners(element, |corners| {
            for strip in corners.split(|&corner| corner < 0.0) {
                triangles.extend(strip.windows(3).enumerate().map(|(place, corners)| match place % 2 {
                    0 => [corners[0], corners[1], corners[2]].map(index),
                    _ => [corners[1], corners[0], corners[2]].map(index),
                }));
            }
        })
    }

    fn skip(&mut self, element: &Element) -> Result<(), String> {
        match self.take_table(element) {
            Some(table) => table.map(drop),
            None => (0..element.count).try_for_each(|_| self.next(element, |_| false, |_, _| ())),
        }
    }

    /// Refuses data after the last element if it shows that the header describes other data. The elements `unread` may be
    /// cut short, unless most faces have corners that are not vertices.
    fn check_rest(mut self, unread: &[Element], points: &[Position]) -> Result<(), String> {
        for element in unread {
            let (mut num_rows, mut num_bad, mut is_cut) = (0, 0, false);
            while num_rows < element.count && !is_cut {
                let mut fits = true;
                let is_last = matches!(&self, Self::Ascii(lines) if lines.clone().next().is_none());
                let is_corner = |corner: f64| corner >= 0.0 && corner < points.len() as f64;
                let has_corners = |index: usize| element.properties[index].has_corners();
                let row = self.next(element, has_corners, |_, corner| fits &= is_corner(corner));
                is_cut = row.is_err();
                num_bad += usize::from(!fits || is_cut && matches!(self, Self::Ascii(_)) && !is_last);
                num_rows += 1;
            }
            if element.name == "face" && 2 * num_bad > num_rows {
                return Err("no faces follow the vertices: what the header says does not fit the data".into());
            }
            if is_cut {
                return Ok(());
            }
        }
        match self {
            Self::Binary(rest) => check_left_over(rest, points.len()),
            Self::Ascii(mut lines) => {
                match lines.find(|(_, line)| text(line).split_ascii_whitespace().all(|word| number(word).is_some())) {
                    Some((number, line)) => Err(format!(
                        "line {number}: `{}` follows the last row that the header promises",
                        excerpt(&text(line), 60)
                    )),
                    None => Ok(()),
                }
            }
        }
    }
}

/// Reads the values of a row. Values that are not wanted need not be numbers.
#[inline]
fn read_row(
    element: &Element,
    mut value: impl FnMut(Scalar, bool) -> Option<f64>,
    is_wanted: impl Fn(usize) -> bool,
    mut found: impl FnMut(usize, f64),
) -> Option<()> {
    for (index, property) in element.properties.iter().enumerate() {
        let is_wanted = is_wanted(index);
        let count = match property.length {
            Some(length) => list_length(value(length, true)?)?,
            None => 1,
        };
        for _ in 0..count {
            let value = value(property.item, is_wanted)?;
            if is_wanted {
                found(index, value);
            }
        }
    }
    Some(())
}

fn cut_short(element: &Element) -> String {
    format!("cut short within the rows of `{}`", excerpt(&element.name, 40))
}

/// Takes `count` items of `size` bytes from the beginning of the data.
fn take<'a>(data: &mut &'a [u8], count: usize, size: usize) -> Option<&'a [u8]> {
    let (taken, rest) = data.split_at_checked(count.checked_mul(size)?)?;
    *data = rest;
    Some(taken)
}

fn list_length(value: f64) -> Option<usize> {
    (value >= 0.0 && value.fract() == 0.0).then_some(value as usize)
}

/// An index of a vertex. A value that is not an index becomes an index that no file has.
fn index(corner: f64) -> u32 {
    if corner >= 0.0 && corner.fract() == 0.0 { corner as u32 } else { u32::MAX }
}

#[cfg(test)]
mod tests {
    use ply_rs::parser::Parser;
    use ply_rs::ply::{DefaultElement, Encoding, Property as Read};

    use crate::tests::{KEYPOINTS, points};
    use crate::{KeypointFormat, KeypointSource};
    use snake_geometry::Point;

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
            (format!("element vertex 99999999999999999999\n{xyz}end_header\n1 2 3\n"), "line 3: no number of rows"),
            (format!("element vertex 2\n{xyz}end_header\n1 2 3\n\n\n\n\n\n\n\n"), "ends before the last `vertex`"),
            (format!("element vertex 1\n{xyz}end_header\n1 2\n\n\n\n"), "line 8: `1 2` does not fit"),
            (format!("element vertex 1\n{xyz}property float x\nend_header\n1 2 3 4\n"), "same name"),
            (format!("element vertex 1\n{xyz}element vertex 1\n{xyz}end_header\n1 2 3\n1 2 3\n"), "same name"),
            ("element vertex 0\nproperty float x\nproperty float y\nend_header\n".into(), "no scalar property `z`"),
            ("element vertex 0\nproperty list uchar float x\nend_header\n".into(), "no scalar property `x`"),
            ("element point 0\nproperty float x\nend_header\n".into(), "no element `vertex`"),
            ("element empty 1000000000000\nend_header\n".into(), "no element `vertex`"),
            (
                "element vertex 1\nproperty x\nend_header\n".into(),
                "header, line 4: no entry of a PLY header: `property x`",
            ),
            (xyz.into(), "no element above `property float x`"),
            ("element vertex 0\n".into(), "no line `end_header`"),
        ] {
            let reason = read(format!("ply\nformat ascii 1.0\n{body}").as_bytes()).unwrap_err();
            assert!(reason.contains(expected), "{reason}");
        }
        assert!(read(b"solid cube").unwrap_err().starts_with("not a PLY file"));
        let none = format!("ply\nformat binary_big_endian 1.0\nelement vertex 0\n{xyz}end_header\n");
        assert!(read(none.as_bytes()).unwrap().is_empty());
    }

    #[test]
    fn written_properties_read_back() {
        let mut bytes = Vec::new();
        KeypointFormat::Ply.write(&mut bytes, &KEYPOINTS, &KeypointSource::default()).unwrap();
        let ply = Parser::<DefaultElement>::new().read_ply(&mut &bytes[..]).unwrap();
        for (vertex, keypoint) in ply.payload["vertex"].iter().zip(KEYPOINTS) {
            assert_eq!(["x", "y", "z"].map(|axis| vertex[axis].clone()), keypoint.position.map(Read::Float));
            assert_eq!(vertex["saliency"], Read::Float(keypoint.saliency));
            assert_eq!(vertex["occupancy"], Read::Float(keypoint.occupancy));
            assert!(matches!(vertex["red"], Read::UChar(_)));
            assert_eq!(vertex["nearest_index"], Read::Int(keypoint.nearest_index as i32));
        }
    }
}

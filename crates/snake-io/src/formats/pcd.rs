//! Reads PCD, the format of the Point Cloud Library: ascii, binary and binary_compressed.

use crate::formats::lzf;
use crate::table::scalar::Scalar;
use crate::table::shape::{Shape, check_left_over};
use crate::table::{Place, Table};
use crate::text::lines::{Lines, advice, text};
use crate::text::number::number;
use snake_geometry::excerpt;

const AXES: [&str; 3] = ["x", "y", "z"];

/// The beginning of the comment that states the origin of the points.
const ORIGIN: &str = "# snake-rs origin ";

/// The comment that states the origin of the points.
pub(crate) fn origin_comment([x, y, z]: [f64; 3]) -> String {
    format!("{ORIGIN}{x} {y} {z}")
}

/// The origin in a comment.
fn parse_origin(comment: &[u8]) -> Option<[f64; 3]> {
    finite(str::from_utf8(comment).ok()?.strip_prefix(ORIGIN)?.split_whitespace())
}

/// Three finite numbers.
fn finite<'a>(words: impl Iterator<Item = &'a str>) -> Option<[f64; 3]> {
    let numbers = words.map(|word| word.parse().ok().filter(|v: &f64| v.is_finite()));
    numbers.collect::<Option<Vec<f64>>>()?.try_into().ok()
}

/// Reads the fields x, y, z of any scalar type, and adds the origin that a file of this crate states. `nan`, which
/// marks missing points in organised clouds, is kept.
pub(crate) fn read(bytes: &[u8]) -> Result<Shape, String> {
    let (header, lines) = Header::parse(bytes)?;
    let axes = header.axes()?;
    let (origin, viewpoint) = (header.origin, header.viewpoint());
    let mut points = header.table(lines)?.read(axes)?;
    if let Some(origin) = origin {
        points.iter_mut().for_each(|point| *point = std::array::from_fn(|axis| point[axis] + origin[axis]));
    }
    Ok(Shape { points, viewpoint, ..Shape::default() })
}

/// The position of the sensor in a header, if it is not zero, with the origin that a file of this crate states.
pub(crate) fn viewpoint(bytes: &[u8]) -> Option<[f64; 3]> {
    Header::parse(bytes).ok()?.0.viewpoint()
}

/// All fields with a single number, and the origin of the points. A packed colour is the number that its bits form.
pub(crate) fn table(bytes: &[u8]) -> Result<(Table<'_>, [f64; 3]), String> {
    let (header, lines) = Header::parse(bytes)?;
    let origin = header.origin.unwrap_or_default();
    Ok((header.table(lines)?, origin))
}

/// Fields that hold a colour in the bits of a number.
const PACKED: [&str; 2] = ["rgb", "rgba"];

#[derive(Clone, Copy)]
enum Encoding {
    Ascii,
    Binary,
    BinaryCompressed,
}

/// A field of a point, and its position within a point: in bytes, and in columns of text.
struct Field {
    name: String,
    /// The type of its number, or the reason why it cannot be read, such as several numbers.
    scalar: Result<Scalar, String>,
    /// Whether its number is a float that holds a colour in its bits.
    is_packed_float: bool,
    offset: usize,
    column: usize,
}

struct Header {
    fields: Vec<Field>,
    /// Bytes of a point in binary data; `columns` is the number of columns of a point in ascii data.
    size: usize,
    columns: usize,
    num_points: usize,
    encoding: Encoding,
    /// The origin of the points.
    origin: Option<[f64; 3]>,
    /// The position of the sensor, unless it is zero. The orientation after it is not read.
    viewpoint: Option<[f64; 3]>,
}

impl Header {
    /// Parses the header, up to its line DATA. The rest of the lines is the data.
    fn parse(bytes: &[u8]) -> Result<(Self, Lines<'_>), String> {
        let (mut fields, mut sizes, mut types, mut counts) = (Vec::new(), Vec::new(), Vec::new(), None);
        let (mut points, mut width, mut height) = (None, None, None);
        let (mut origin, mut viewpoint) = (None, None);
        let mut lines = Lines::from_header(bytes);
        while let Some((line_number, line)) = lines.next() {
            if line.starts_with(b"#") {
                origin = origin.or_else(|| parse_origin(line));
                continue;
            }
            let bad = |what: &str| format!("header, line {line_number}: {what}");
            let line = str::from_utf8(line).map_err(|_| bad("not text; is this a PCD file?"))?.trim();
            let mut words = line.split_whitespace();
            let Some(key) = words.next() else { continue };
            let values: Vec<&str> = words.collect();
            let number = || values.first().and_then(|value| value.parse::<usize>().ok());
            let number = || number().ok_or_else(|| bad(&format!("no number in `{}`", excerpt(line, 60))));
            match key {
                "FIELDS" | "COLUMNS" => fields = values,
                "SIZE" => sizes = values,
                "TYPE" => types = values,
                "COUNT" => counts = Some(values),
                "WIDTH" => width = Some(number()?),
                "HEIGHT" => height = Some(number()?),
                "POINTS" => points = Some(number()?),
                "VIEWPOINT" => viewpoint = finite(values.into_iter().take(3)).filter(|position| *position != [0.0; 3]),
                "DATA" => {
                    let encoding = match values[..] {
                        ["ascii"] => Encoding::Ascii,
                        ["binary"] => Encoding::Binary,
                        ["binary_compressed"] => Encoding::BinaryCompressed,
                        _ => {
                            let reason = "DATA is ascii, binary or binary_compressed";
                            return Err(bad(&format!("`{}`; {reason}", excerpt(line, 60))));
                        }
                    };
                    let area = width.zip(height).and_then(|(width, height)| width.checked_mul(height));
                    let num_points = points.or(area).ok_or("header: neither POINTS nor WIDTH and HEIGHT")?;
                    let counts = counts.unwrap_or_else(|| vec!["1"; fields.len()]);
                    let (fields, size, columns) = place(&fields, &sizes, &types, &counts)?;
                    return Ok((Self { fields, size, columns, num_points, encoding, origin, viewpoint }, lines));
                }
                "VERSION" => {}
                _ => return Err(bad(&format!("`{}` is no entry of a PCD header", excerpt(line, 60)))),
            }
        }
        Err("no line DATA: not a PCD file, or cut short within its header".into())
    }

    /// The position of the sensor, with the origin added: the file's position is relative to it, as the points are.
    fn viewpoint(&self) -> Option<[f64; 3]> {
        let origin = self.origin.unwrap_or_default();
        self.viewpoint.map(|position| std::array::from_fn(|axis| position[axis] + origin[axis]))
    }

    /// The indices of x, y and z among the fields with a single number.
    fn axes(&self) -> Result<[usize; 3], String> {
        let place = |axis: &str| {
            let mut fields = self.fields.iter().filter(|field| field.name == axis);
            let field = fields.next().ok_or("header: FIELDS lacks x, y or z")?;
            if fields.next().is_some() {
                return Err(format!("header: more than one `{axis}`"));
            }
            field.scalar.clone()?;
            Ok(self.scalars().take_while(|(field, _)| field.name != axis).count())
        };
        let [x, y, z] = AXES.map(place);
        Ok([x?, y?, z?])
    }

    /// The fields with a single number, and its type.
    fn scalars(&self) -> impl Iterator<Item = (&Field, Scalar)> + Clone {
        self.fields.iter().filter_map(|field| Some((field, *field.scalar.as_ref().ok()?)))
    }

    fn table(self, lines: Lines<'_>) -> Result<Table<'_>, String> {
        let names = self.scalars().map(|(field, _)| field.name.clone()).collect();
        let places = |first: usize, stride: &dyn Fn(Scalar) -> usize| {
            let place = |(field, scalar): (&Field, Scalar)| Place {
                scalar,
                offset: field.offset * first,
                stride: stride(scalar),
            };
            self.scalars().map(place).collect()
        };
        let num_points = self.num_points;
        match self.encoding {
            Encoding::Ascii => {
                Ok(Table::parsed(names, move |columns, found| self.ascii(lines.clone(), columns, found)))
            }
            Encoding::Binary => {
                let rows = self.binary(lines.rest())?;
                Ok(Table::binary(names, rows, num_points, places(1, &|_| self.size)))
            }
            // The first field of all points, then the second, ...
            Encoding::BinaryCompressed => {
                let columns = self.unpack(lines.rest())?;
                Ok(Table::binary(names, columns, num_points, places(num_points, &|scalar| scalar.size)))
            }
        }
    }

    /// The bytes of binary data, after a check that there are enough for the points.
    fn binary<'a>(&self, data: &'a [u8]) -> Result<&'a [u8], String> {
        // This check comes before any allocation, because a header can claim any number.
        let Self { num_points, size, .. } = self;
        if num_points.checked_mul(*size).is_none_or(|needed| needed > data.len()) {
            return Err(format!("{num_points} points of {size} bytes each, but {} bytes follow", data.len()));
        }
        let (rows, rest) = data.split_at(num_points * size);
        check_left_over(rest, *num_points)?;
        Ok(rows)
    }

    /// Unpacks data that consists of two lengths (compressed, uncompressed) and LZF data.
    fn unpack(&self, data: &[u8]) -> Result<Vec<u8>, String> {
        let Self { num_points, size, .. } = self;
        let lengths = data.split_first_chunk::<4>().zip(data.get(4..).and_then(|rest| rest.split_first_chunk::<4>()));
        let Some(((packed, _), (unpacked, packed_data))) = lengths else {
            return Err("cut short: no lengths of the compressed data".into());
        };
        let [packed, unpacked] = [packed, unpacked].map(|length| u32::from_le_bytes(*length) as usize);
        if num_points.checked_mul(*size) != Some(unpacked) {
            return Err(format!("{num_points} points of {size} bytes each, but {unpacked} bytes are compressed"));
        }
        let packed_data = packed_data
            .get(..packed)
            .ok_or_else(|| format!("{packed} bytes of compressed data are promised, {} follow", packed_data.len()))?;
        lzf::decompress(packed_data, unpacked)
    }

    /// Calls `found` once per line, with the line's numbers in the chosen columns.
    fn ascii(&self, lines: Lines, columns: &[usize], found: &mut dyn FnMut(&[f64])) -> Result<(), String> {
        let fields: Vec<&Field> = self.scalars().map(|(field, _)| field).collect();
        let wanted: Vec<&Field> = columns.iter().map(|&column| fields[column]).collect();
        let (mut row, mut num_rows) = (vec![0.0; columns.len()], 0);
        for (line_number, line) in lines {
            let line = text(line);
            let (mut num_words, mut num_found) = (0, 0);
            for word in line.split_ascii_whitespace() {
                if let Some(place) = wanted.iter().position(|field| field.column == num_words)
                    && let Some(number) = number(word)
                {
                    row[place] = wanted[place].in_text(number);
                    num_found += 1;
                }
                num_words += 1;
            }
            if num_words == self.columns && num_found == columns.len() {
                found(&row);
                num_rows += 1;
            } else if !line.trim_matches(['\0', '\x1a']).is_empty() {
                let (row, advice) = (excerpt(&line, 60), advice(&line));
                return Err(format!("line {line_number}: `{row}` does not fit FIELDS{advice}"));
            }
        }
        if num_rows == self.num_points {
            Ok(())
        } else {
            Err(format!("the header promises {} points, {num_rows} follow", self.num_points))
        }
    }
}

impl Field {
    /// The value of a number in ascii data. A packed colour is written as the float with its bits, or as the integer.
    fn in_text(&self, number: f64) -> f64 {
        if self.is_packed_float { f64::from((number as f32).to_bits()) } else { number }
    }
}

/// The fields of a point, and its bytes and columns.
fn place(
    names: &[&str],
    sizes: &[&str],
    types: &[&str],
    counts: &[&str],
) -> Result<(Vec<Field>, usize, usize), String> {
    if [sizes.len(), types.len(), counts.len()] != [names.len(); 3] {
        return Err("header: FIELDS, SIZE, TYPE and COUNT differ in length".into());
    }
    let (mut offset, mut column) = (0_usize, 0_usize);
    let mut fields = Vec::with_capacity(names.len());
    for (((&name, size), kind), count) in names.iter().zip(sizes).zip(types).zip(counts) {
        let unusable = || {
            let [name, count, kind, size] =
                [(name, 40), (*count, 20), (*kind, 20), (*size, 20)].map(|(word, length)| excerpt(word, length));
            format!("header: field `{name}` of {count} scalars of type {kind}{size}")
        };
        let (size, number) = size.parse().ok().zip(count.parse::<usize>().ok()).ok_or_else(unusable)?;
        let end = usize::checked_mul(size, number).and_then(|bytes| offset.checked_add(bytes)).ok_or_else(unusable)?;
        let is_packed_float = PACKED.contains(&name) && kind.eq_ignore_ascii_case("F");
        let kind = if is_packed_float { "u".into() } else { kind.to_ascii_lowercase() };
        let scalar = match number {
            1 => Scalar::parse(&format!("<{kind}{size}")).ok_or_else(unusable),
            _ => Err(format!("header: more than one `{}`", excerpt(name, 40))),
        };
        fields.push(Field { name: name.into(), scalar, is_packed_float, offset, column });
        (offset, column) = (end, column.saturating_add(number));
    }
    Ok((fields, offset, column))
}

#[cfg(test)]
mod tests {
    use crate::tests::points;
    use snake_geometry::Point;

    fn read(bytes: &[u8]) -> Result<Vec<Point>, String> {
        points(super::read(bytes))
    }

    const TWO: [Point; 2] = [[1.0, 2.0, 3.0], [4.0, -5.0, 6.0]];

    /// A file whose points have a label of two scalars between x and y.
    fn pcd(scalar: &str, data: &str, payload: &[u8]) -> Vec<u8> {
        let (kind, size) = scalar.split_at(1);
        let header = format!(
            "# .PCD v.7\nVERSION .7\r\nFIELDS x label y z\nSIZE {size} 2 {size} {size}\nTYPE {kind} U {kind} {kind}\n\
             COUNT 1 2 1 1\nWIDTH 2\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 2\nDATA {data}\n"
        );
        [header.as_bytes(), payload].concat()
    }

    fn payload(scalar: &str) -> Vec<u8> {
        let encode = |value: f32| match scalar {
            "F4" => value.to_le_bytes().to_vec(),
            "F8" => f64::from(value).to_le_bytes().to_vec(),
            _ => (value as i64).to_le_bytes()[..scalar[1..].parse().unwrap()].to_vec(),
        };
        TWO.iter().flat_map(|p| [encode(p[0]), vec![9; 4], encode(p[1]), encode(p[2])].concat()).collect()
    }

    #[test]
    fn ascii_and_binary_of_every_scalar_type() {
        for scalar in ["F4", "F8", "I1", "I2", "I4", "I8"] {
            assert_eq!(read(&pcd(scalar, "ascii", b"1 7 7 2 3\r\n\n 4\t7 7 -5e0 6")).unwrap(), TWO, "{scalar}");
            let binary = pcd(scalar, "binary", &payload(scalar));
            assert_eq!(read(&binary).unwrap(), TWO, "{scalar}");
            for length in 0..binary.len() {
                read(&binary[..length]).unwrap_err();
            }
        }
        let nan = read(&pcd("F4", "ascii", b"nan 7 7 2 3\n1 2 3 -inf 5\n")).unwrap();
        assert!(nan[0][0].is_nan() && nan[1][1] == f32::NEG_INFINITY);
    }

    #[test]
    fn compressed_columns_of_every_scalar_type() {
        for scalar in ["F4", "F8", "I1", "I2", "I4", "I8"] {
            let size: usize = scalar[1..].parse().unwrap();
            let rows = payload(scalar);
            // The columns are x, label (two scalars of two bytes), y and z. This LZF data has only literals.
            let starts = [(0, size), (size, 4), (size + 4, size), (2 * size + 4, size)];
            let column = |(start, width): (usize, usize)| {
                rows.chunks(3 * size + 4).flat_map(move |row| &row[start..start + width]).copied().collect::<Vec<u8>>()
            };
            let columns = starts.map(column).concat();
            let packed: Vec<u8> = columns.chunks(32).flat_map(|run| [&[run.len() as u8 - 1], run].concat()).collect();
            let lengths = [packed.len() as u32, columns.len() as u32].map(u32::to_le_bytes).concat();
            let file = pcd(scalar, "binary_compressed", &[lengths, packed].concat());
            assert_eq!(read(&file).unwrap(), TWO, "{scalar}");
            for length in 0..file.len() {
                read(&file[..length]).unwrap_err();
            }
        }
    }

    #[test]
    fn viewpoints_are_read_unless_they_are_zero() {
        let fields = "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F";
        let of = |line: &str| {
            super::read(format!("{fields}\n{line}\nPOINTS 1\nDATA ascii\n1 2 3\n").as_bytes()).unwrap().viewpoint
        };
        assert_eq!(of("VIEWPOINT 1 -2.5 3 1 0 0 0\r"), Some([1.0, -2.5, 3.0]));
        for line in ["VIEWPOINT 0 0 0 1 0 0 0", "VIEWPOINT 1 2", "VIEWPOINT 1 nan 0", "VIEWPOINT", ""] {
            assert_eq!(of(line), None, "{line}");
        }
    }

    #[test]
    fn origins_of_our_own_files_are_added() {
        let file = |comment: &str| {
            let header = "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nPOINTS 1\nDATA ascii\n1 2 3\n";
            super::read(format!("{comment}\n{header}").as_bytes()).unwrap().points
        };
        assert_eq!(file(&super::origin_comment([5e5, 5.4e6, -0.5])), [[500_001.0, 5_400_002.0, 2.5]]);
        for comment in
            ["# snake-rs origin 1 2", "# snake-rs origin 1 2 nan", "# origin 1 2 3", "# snake-rs origin \u{fc}"]
        {
            assert_eq!(file(comment), [[1.0, 2.0, 3.0]], "{comment}");
        }
    }

    #[test]
    fn short_headers_are_enough() {
        let text = b"FIELDS z y x\nSIZE 4 4 4\nTYPE F F F\nWIDTH 1\nHEIGHT 2\nDATA ascii\n3 2 1\n6 -5 4\n";
        assert_eq!(read(text).unwrap(), TWO);
        assert!(read(b"FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nPOINTS 0\nDATA binary\n").unwrap().is_empty());
    }

    #[test]
    fn bad_files_are_named() {
        let xyz = "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\n";
        for (text, expected) in [
            ("solid cube\n".to_owned(), "line 1: `solid cube` is no entry"),
            (String::new(), "no line DATA"),
            (format!("{xyz}POINTS 1\n"), "no line DATA"),
            (format!("{xyz}DATA ascii\n1 2 3\n"), "neither POINTS"),
            (format!("{xyz}WIDTH 99999999999\nHEIGHT 99999999999\nDATA ascii\n"), "neither POINTS"),
            (format!("{xyz}POINTS -1\nDATA ascii\n"), "line 4: no number"),
            (format!("{xyz}POINTS 1\nDATA binary_compressed\n1234567"), "cut short"),
            (format!("{xyz}POINTS 1\nDATA binary_compressed\n\x01\0\0\0\x0d\0\0\0"), "but 13 bytes are compressed"),
            (
                format!("{xyz}POINTS 1\nDATA binary_compressed\n\x03\0\0\0\x0c\0\0\0ab"),
                "3 bytes of compressed data are promised, 2",
            ),
            (
                format!("{xyz}POINTS 1\nDATA binary_compressed\n\x02\0\0\0\x0c\0\0\0\0a"),
                "1 bytes were unpacked, 12 promised",
            ),
            (format!("{xyz}POINTS 1\nDATA morse\n"), "line 5: `DATA morse`"),
            (format!("{xyz}POINTS 9999999999999\nDATA binary\n123"), "12 bytes each, but 3 bytes follow"),
            (format!("{xyz}POINTS 18446744073709551615\nDATA binary\n"), "bytes follow"),
            (format!("{xyz}POINTS 9999999999999\nDATA ascii\n1 2 3\n"), "promises 9999999999999 points, 1 follow"),
            (format!("{xyz}POINTS 1\nDATA ascii\n1 2 3\n1 2 3\n"), "promises 1 points, 2 follow"),
            (format!("{xyz}POINTS 1\nDATA ascii\n\n1 2\n"), "line 7: `1 2` does not fit"),
            (format!("{xyz}POINTS 1\nDATA ascii\n1 2 3 4\n"), "does not fit"),
            (format!("{xyz}POINTS 1\nDATA ascii\n1 2 potato\n"), "does not fit"),
            (format!("{xyz}COUNT 1 1\nPOINTS 1\nDATA ascii\n"), "differ in length"),
            (format!("{xyz}COUNT 1 1 18446744073709551615\nPOINTS 1\nDATA ascii\n"), "field `z`"),
            (format!("{xyz}COUNT 1 1 2\nPOINTS 1\nDATA ascii\n1 2 3 4\n"), "more than one `z`"),
            ("FIELDS x y z\nSIZE 4 4 3\nTYPE F F F\nPOINTS 0\nDATA ascii\n".into(), "of type F3"),
            ("FIELDS x y x\nSIZE 4 4 4\nTYPE F F F\nPOINTS 0\nDATA ascii\n".into(), "more than one `x`"),
            ("FIELDS x y\nSIZE 4 4\nTYPE F F\nPOINTS 0\nDATA ascii\n".into(), "lacks x, y or z"),
        ] {
            let reason = read(text.as_bytes()).unwrap_err();
            assert!(reason.contains(expected), "{expected}: {reason}");
        }
        let huge = format!("{xyz}POINTS 300000000\nDATA binary_compressed\n");
        let lengths = [9_u32, 3_600_000_000].map(u32::to_le_bytes).concat();
        let reason = read(&[huge.as_bytes(), &lengths, &[0; 9]].concat()).unwrap_err();
        assert_eq!(reason, "9 compressed bytes cannot hold 3600000000");
        assert!(read(b"\xff\xfe1\n").unwrap_err().contains("not text"));
    }
}

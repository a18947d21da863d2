//! NumPy's `.npy` format.

use std::io::{self, Write};

use crate::table::scalar::Scalar;
use crate::table::shape::{Position, Shape, check_left_over};
use crate::table::{Place, decode};
use crate::text::columns::Columns;
use snake_geometry::excerpt;

pub(crate) const MAGIC: &[u8] = b"\x93NUMPY";

/// An array with three or four rows and more columns than this has one row per axis.
const MAX_COLUMNS: usize = 16;

/// Reads x, y, z of an array `(N, C)`, `C >= 3`, from the chosen columns, or from the first three columns.
///
/// Items may be `f2`, `f4`, `f8` or integers of any width, in either byte order, in C or Fortran order.
pub(crate) fn positions<'a>(
    bytes: &'a [u8],
    columns: Option<&Columns>,
) -> Result<impl Iterator<Item = Position> + Clone + use<'a>, String> {
    let (array, data) = open_cloud(bytes)?;
    if columns.is_none() {
        array.check_shape(data)?;
    }
    let places = array.places(columns.map_or(Ok([0, 1, 2]), Columns::in_array)?)?;
    Ok(decode(data, array.rows, places))
}

/// [`positions`] as a shape without faces.
pub(crate) fn read(bytes: &[u8], columns: Option<&Columns>) -> Result<Shape, String> {
    Ok(positions(bytes, columns)?.collect::<Vec<_>>().into())
}

/// The header and the data of an array `(N, C)`.
fn open_cloud(bytes: &[u8]) -> Result<(ArrayHeader, &[u8]), String> {
    let (array, data) = open(bytes)?;
    let ArrayHeader { clouds, rows, columns, scalar, .. } = array;
    if let Some(clouds) = clouds {
        return Err(format!(
            "shape ({clouds}, {rows}, {columns}) is several clouds, or one with rows and columns of a sensor; save one \
             cloud: numpy.save(\"cloud.npy\", a[0]), or a.reshape(-1, {columns})"
        ));
    }
    check_left_over(&data[rows * columns * scalar.size..], rows)?;
    Ok((array, data))
}

/// Whether the first bytes of a file announce an array `(N, C)`, `C >= 3`, that is not a camera or transform matrix.
pub(crate) fn is_cloud(bytes: &[u8]) -> bool {
    let array = split_header(bytes).and_then(|(header, _)| ArrayHeader::parse(header).ok());
    let is_matrix = |array: &ArrayHeader| matches!((array.rows, array.columns), (3, 3) | (3 | 4, 4));
    array.is_some_and(|array| array.clouds.is_none() && !is_matrix(&array))
}

/// The header and the data. The data is checked to hold the whole array.
fn open(bytes: &[u8]) -> Result<(ArrayHeader, &[u8]), String> {
    let (header, data) = split_header(bytes).ok_or("not a .npy file, or cut short within its header")?;
    let array = ArrayHeader::parse(header)?;
    // This check comes before any allocation, because a header can claim any size.
    let lengths = [array.clouds.unwrap_or(1), array.rows, array.columns, array.scalar.size];
    let needed = lengths.into_iter().try_fold(1_usize, usize::checked_mul);
    if needed.is_none_or(|needed| needed > data.len()) {
        let ArrayHeader { clouds, rows, columns, scalar: Scalar { size, .. }, .. } = array;
        let clouds = clouds.map(|clouds| format!("{clouds}, ")).unwrap_or_default();
        return Err(format!("shape ({clouds}{rows}, {columns}) of {size} bytes each, but {} bytes follow", data.len()));
    }
    Ok((array, data))
}

/// Writes the magic bytes and the header of an array in C order.
pub(crate) fn write_header(out: &mut dyn Write, descr: &str, shape: &str) -> io::Result<()> {
    let header = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': ({shape}), }}");
    // NumPy pads the header to a multiple of 64 bytes, so that the data can be memory-mapped.
    let width = (MAGIC.len() + 4 + header.len() + 1).next_multiple_of(64) - MAGIC.len() - 5;
    out.write_all(MAGIC)?;
    out.write_all(&[1, 0])?;
    out.write_all(&(width as u16 + 1).to_le_bytes())?;
    writeln!(out, "{header:width$}")
}

/// Writes an array of `<f4` in C order.
pub(crate) fn write_volume(out: &mut dyn Write, shape: [usize; 3], values: &[f32]) -> io::Result<()> {
    let [depth, height, width] = shape;
    write_header(out, "<f4", &format!("{depth}, {height}, {width}"))?;
    values.iter().try_for_each(|value| out.write_all(&value.to_le_bytes()))
}

/// Splits a file into the header's text and the data. The header's length has 2 bytes in version 1, 4 in versions 2 and
/// 3.
fn split_header(bytes: &[u8]) -> Option<(&[u8], &[u8])> {
    let (version, rest) = bytes.strip_prefix(MAGIC)?.split_first_chunk::<2>()?;
    let (length, rest) = match version[0] {
        1 => rest.split_first_chunk().map(|(length, rest)| (u16::from_le_bytes(*length).into(), rest))?,
        2 | 3 => rest.split_first_chunk().map(|(length, rest)| (u32::from_le_bytes(*length), rest))?,
        _ => return None,
    };
    rest.split_at_checked(length.try_into().ok()?)
}

#[derive(Clone, Copy)]
struct ArrayHeader {
    scalar: Scalar,
    fortran_order: bool,
    /// The length of the axis before rows and columns, if there is one.
    clouds: Option<usize>,
    rows: usize,
    columns: usize,
}

/// The content of a header.
struct Described {
    descr: String,
    fortran_order: bool,
    /// The text within the parentheses.
    shape: String,
}

impl Described {
    /// Parses a Python dictionary such as `{'descr': '<f4', 'fortran_order': False, 'shape': (3, 3), }`.
    fn parse(header: &[u8]) -> Result<Self, String> {
        let header = String::from_utf8_lossy(header);
        let fields = || {
            let (descr, _) = value(&header, "descr")?.strip_prefix('\'')?.split_once('\'')?;
            let (shape, _) = value(&header, "shape")?.strip_prefix('(')?.split_once(')')?;
            let fortran_order = value(&header, "fortran_order")?.starts_with("True");
            Some(Self { descr: descr.into(), fortran_order, shape: shape.into() })
        };
        fields().ok_or_else(|| if value(&header, "descr").is_some_and(|descr| descr.starts_with('[')) { format!(
                "a structured array, {}; save its coordinates: numpy.save(\"cloud.npy\", numpy.stack([a[\"x\"], a[\"y\"], \
                 a[\"z\"]], axis=1))",
                excerpt(&header, 100)
            )} else { format!("no plain array is described by the header `{}`", excerpt(&header, 100))})
    }
}

impl ArrayHeader {
    /// The layout of an array of clouds, or of one cloud.
    fn parse(header: &[u8]) -> Result<Self, String> {
        let Described { descr, fortran_order, shape } = Described::parse(header)?;
        let scalar = Scalar::parse(&descr).ok_or_else(|| {
            let descr = excerpt(&descr, 20);
            format!(
                "items of type `{descr}`; floats and integers can be read: numpy.save(\"cloud.npy\", a.astype(float))"
            )
        })?;
        let (clouds, rows, columns) = parse_shape(&shape)
            .ok_or_else(|| format!("shape ({}); expected (N, 3) or more columns", excerpt(&shape, 40)))?;
        Ok(Self { scalar, fortran_order, clouds, rows, columns })
    }

    /// Refuses shapes that a cloud does not have: one row per axis, and the matrix of a transform.
    fn check_shape(&self, data: &[u8]) -> Result<(), String> {
        let Self { rows, columns, .. } = *self;
        if matches!(rows, 3 | 4) && columns > MAX_COLUMNS {
            return Err(format!(
                "shape ({rows}, {columns}) is {rows} points of {columns} values; if it is {columns} points, save it as \
                 ({columns}, {rows}): numpy.save(\"cloud.npy\", a.T); `columns` 1,2,3 reads it as it is"
            ));
        }
        let last_row = || std::array::from_fn(|column| self.item(data, 3, column));
        if (rows, columns) == (4, 4) && last_row() == [0.0, 0.0, 0.0, 1.0] {
            Err("the 4 x 4 matrix of a transform and no cloud".into())
        } else {
            Ok(())
        }
    }

    fn places<const N: usize>(&self, columns: [usize; N]) -> Result<[Place; N], String> {
        match columns.iter().find(|&&column| column >= self.columns) {
            Some(missing) => Err(format!("no column {}; the array has {}", missing.saturating_add(1), self.columns)),
            None => Ok(columns.map(|column| self.place(column))),
        }
    }

    /// The items of a column within a cloud's data.
    fn place(&self, column: usize) -> Place {
        let Self { scalar, rows, columns, .. } = *self;
        if self.fortran_order {
            Place { scalar, offset: column * rows * scalar.size, stride: scalar.size }
        } else {
            Place { scalar, offset: column * scalar.size, stride: columns * scalar.size }
        }
    }

    /// Decodes one item of a cloud's data.
    fn item(&self, data: &[u8], row: usize, column: usize) -> f64 {
        self.place(column).decode(data, row)
    }
}

/// The text after `'key':`.
fn value<'a>(header: &'a str, key: &str) -> Option<&'a str> {
    let (_, rest) = header.split_once(&format!("'{key}'"))?;
    rest.trim_start().strip_prefix(':').map(str::trim_start)
}

fn parse_shape(shape: &str) -> Option<(Option<usize>, usize, usize)> {
    let lengths = shape.trim_end().trim_end_matches(',').split(',').map(|length| length.trim().parse().ok());
    let (clouds, rows, columns) = match lengths.collect::<Option<Vec<usize>>>()?[..] {
        [rows, columns] => (None, rows, columns),
        [clouds, rows, columns] => (Some(clouds), rows, columns),
        _ => return None,
    };
    (columns >= 3).then_some((clouds, rows, columns))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::points;
    use snake_geometry::Point;

    fn read(bytes: &[u8]) -> Result<Vec<Point>, String> {
        points(super::read(bytes, None))
    }

    /// A file of the given version. The header is not padded, which NumPy also allows.
    fn npy(version: u8, descr: &str, fortran_order: &str, shape: &str, data: &[u8]) -> Vec<u8> {
        let header = format!("{{'descr': '{descr}', 'fortran_order': {fortran_order}, 'shape': {shape}, }}\n");
        let mut bytes = [MAGIC, &[version, 0]].concat();
        match version {
            1 => bytes.extend((header.len() as u16).to_le_bytes()),
            _ => bytes.extend((header.len() as u32).to_le_bytes()),
        }
        [&bytes, header.as_bytes(), data].concat()
    }

    /// The bytes of small integers in the given scalar.
    fn encode(values: &[i8], descr: &str) -> Vec<u8> {
        let encode_one = |&value: &i8| {
            let mut bytes = match &descr[1..] {
                "f4" => f32::from(value).to_le_bytes().to_vec(),
                "f8" => f64::from(value).to_le_bytes().to_vec(),
                // In two's complement the low bytes of an i64 are the same number in a narrower type.
                kind => i64::from(value).to_le_bytes()[..usize::from(kind.as_bytes()[1] - b'0')].to_vec(),
            };
            if descr.starts_with('>') {
                bytes.reverse();
            }
            bytes
        };
        values.iter().flat_map(encode_one).collect()
    }

    #[test]
    fn every_dtype_order_layout_and_version() {
        let (rows, columns) = ([1, 2, 3, 99, 4, 5, 6, 99], [1, 4, 2, 5, 3, 6, 99, 99]);
        for kind in ["f4", "f8", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8"] {
            for order in ["<", ">", "|"].into_iter().filter(|order| *order != "|" || kind.ends_with('1')) {
                let descr = format!("{order}{kind}");
                for (version, fortran, values) in [(1, "False", rows), (2, "True", columns), (3, "False", rows)] {
                    let bytes = npy(version, &descr, fortran, "(2, 4)", &encode(&values, &descr));
                    assert_eq!(read(&bytes).unwrap(), [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]], "{descr} {fortran}");
                    for length in 0..bytes.len() {
                        read(&bytes[..length]).unwrap_err();
                    }
                }
            }
        }
        let negative = npy(1, ">i2", "False", "(1, 3)", &encode(&[-1, -128, 0], ">i2"));
        assert_eq!(read(&negative).unwrap(), [[-1.0, -128.0, 0.0]]);
    }

    #[test]
    fn lying_and_unfit_headers_are_refused() {
        for shape in ["(1000000000000, 3)", "(6148914691236517206, 3)", "(1, 18446744073709551615)", "(3, 3)"] {
            let reason = read(&npy(1, "<f4", "False", shape, &[0; 35])).unwrap_err();
            assert!(reason.contains("35 bytes follow"), "{reason}");
        }
        for shape in ["(9,)", "()", "(3, 2)", "(1, 3, 1)", "(-1, 3)", "(99999999999999999999, 3)", "3"] {
            read(&npy(1, "<f4", "False", shape, &[0; 36])).unwrap_err();
        }
        for descr in ["|O", "<f16", "<c8", "|b1", "<U8", "=f4", "|f4", "", "<f44", "<f4\u{e9}"] {
            read(&npy(1, descr, "False", "(1, 3)", &[0; 36])).unwrap_err();
        }
        read(&npy(9, "<f4", "False", "(3, 3)", &[0; 36])).unwrap_err();
        read(&[MAGIC, &[2, 0, 255, 255, 255, 255], b"{}"].concat()).unwrap_err();
        assert!(read(&npy(1, "<f4", "False", "(0, 3)", &[])).unwrap().is_empty());
    }

    #[test]
    fn columns_can_be_chosen() {
        let bytes = npy(1, "<i2", "False", "(2, 5)", &encode(&[9, 9, 1, 2, 3, 9, 9, 4, 5, 6], "<i2"));
        let read = |columns: &str| points(super::read(&bytes, Some(&columns.parse().unwrap())));
        assert_eq!(read("3,4,5").unwrap(), [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]);
        assert_eq!(read("5,4,3").unwrap()[0], [3.0, 2.0, 1.0]);
        assert_eq!(read("4,5,6").unwrap_err(), "no column 6; the array has 5");
        assert!(read("x,y,z").unwrap_err().contains("by numbers"));
        assert!(read("1,2,18446744073709551615").unwrap_err().contains("no column"));
    }

    #[test]
    fn volumes_read_back() {
        let values: Vec<f32> = (0..24).map(|i| i as f32 / 7.0).collect();
        let mut bytes = Vec::new();
        write_volume(&mut bytes, [2, 4, 3], &values).unwrap();
        assert_eq!(bytes.len() % 64, 24 * 4 % 64, "the data begins at a multiple of 64 bytes");
        let data: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        assert!(bytes.ends_with(&data) && String::from_utf8_lossy(&bytes[..128]).contains("'shape': (2, 4, 3)"));
        let path = std::path::Path::new("nowhere/volume.npy");
        assert!(crate::write_volume(path, [2, 4, 4], &values).unwrap_err().to_string().contains("24 values"));
    }
}

//! Tables of numbers, as files hold points: named columns whose numbers are decoded on demand.

pub(crate) mod scalar;
pub(crate) mod shape;

use std::borrow::Cow;

use crate::table::scalar::Scalar;

/// A table whose header has been read.
pub(crate) struct Table<'a> {
    /// The names of the columns; empty for arrays and text without a header.
    pub(crate) names: Vec<String>,
    cells: Cells<'a>,
}

enum Cells<'a> {
    /// Numbers of known types at known places.
    Binary { bytes: Cow<'a, [u8]>, num_rows: usize, places: Vec<Place> },
    /// Numbers that can only be found by reading row after row.
    Parsed(Box<Parse<'a>>),
}

/// Calls the second argument with the numbers of each row, in the columns given by the first argument.
type Parse<'a> = dyn Fn(&[usize], &mut dyn FnMut(&[f64])) -> Result<(), String> + 'a;

/// The numbers of a column: their type, the offset of the first one and the bytes from one to the next.
#[derive(Clone, Copy)]
pub(crate) struct Place {
    pub(crate) scalar: Scalar,
    pub(crate) offset: usize,
    pub(crate) stride: usize,
}

impl Place {
    /// The number in a row of the table.
    #[inline]
    pub(crate) fn decode(self, bytes: &[u8], row: usize) -> f64 {
        let Self { scalar, offset, stride } = self;
        let rest = &bytes[offset + row * stride..];
        // For most numbers, this avoids a copy whose length is only known at run time.
        match (scalar, rest) {
            (Scalar::FLOAT, &[a, b, c, d, ..]) => f32::from_le_bytes([a, b, c, d]).into(),
            (Scalar::DOUBLE, &[a, b, c, d, e, f, g, h, ..]) => f64::from_le_bytes([a, b, c, d, e, f, g, h]),
            _ => scalar.decode(&rest[..scalar.size]),
        }
    }
}

impl<'a> Table<'a> {
    /// A table in bytes, which must hold all numbers of all places.
    pub(crate) fn binary(
        names: Vec<String>,
        bytes: impl Into<Cow<'a, [u8]>>,
        num_rows: usize,
        places: Vec<Place>,
    ) -> Self {
        Self { names, cells: Cells::Binary { bytes: bytes.into(), num_rows, places } }
    }

    /// A table in bytes, row by row, with columns of these types.
    pub(crate) fn rows_of(
        names: Vec<String>,
        bytes: &'a [u8],
        num_rows: usize,
        scalars: impl Iterator<Item = Scalar> + Clone,
    ) -> Self {
        let stride = scalars.clone().map(|scalar| scalar.size).sum();
        let place = |offset: &mut usize, scalar: Scalar| {
            *offset += scalar.size;
            Some(Place { scalar, offset: *offset - scalar.size, stride })
        };
        Self::binary(names, bytes, num_rows, scalars.scan(0, place).collect())
    }

    /// A table whose rows are read by a function.
    pub(crate) fn parsed(
        names: Vec<String>,
        parse: impl Fn(&[usize], &mut dyn FnMut(&[f64])) -> Result<(), String> + 'a,
    ) -> Self {
        Self { names, cells: Cells::Parsed(Box::new(parse)) }
    }

    /// The numbers of these columns, row by row.
    pub(crate) fn read<const N: usize>(&self, columns: [usize; N]) -> Result<Vec<[f64; N]>, String> {
        match &self.cells {
            Cells::Binary { bytes, num_rows, places } => {
                Ok(decode(bytes, *num_rows, columns.map(|column| places[column])).collect())
            }
            Cells::Parsed(parse) => {
                let mut rows = Vec::new();
                parse(&columns, &mut |row| rows.push(std::array::from_fn(|column| row[column])))?;
                Ok(rows)
            }
        }
    }

    /// The numbers of the columns with these names, if each name occurs once and the rows can be read.
    pub(crate) fn named<const N: usize>(&self, names: [&str; N]) -> Option<Vec<[f64; N]>> {
        self.read(find(&self.names, names).ok()?).ok()
    }
}

/// The rows of numbers at these places.
pub(crate) fn decode<const N: usize>(
    bytes: &[u8],
    num_rows: usize,
    places: [Place; N],
) -> impl Iterator<Item = [f64; N]> + Clone {
    (0..num_rows).map(move |row| places.map(|place| place.decode(bytes, row)))
}

/// The columns with these names. Upper and lower case are ignored if none of the names occurs as it is.
///
/// # Errors
/// The first name that does not occur exactly once, and how often it occurs.
pub(crate) fn find<'n, const N: usize>(
    columns: &[impl AsRef<str>],
    names: [&'n str; N],
) -> Result<[usize; N], (&'n str, usize)> {
    let any_case = !columns.iter().any(|column| names.contains(&column.as_ref()));
    let is_named = |column: &str, name: &str| column == name || any_case && column.eq_ignore_ascii_case(name);
    let mut indices = [0; N];
    for (index, name) in indices.iter_mut().zip(names) {
        let mut matching = columns.iter().enumerate().filter(|(_, column)| is_named(column.as_ref(), name));
        match (matching.next(), matching.count()) {
            (Some((column, _)), 0) => *index = column,
            (first, others) => return Err((name, usize::from(first.is_some()) + others)),
        }
    }
    Ok(indices)
}
